"""Warping error and flicker, on the demo flat whose depth is known."""
from dataclasses import replace

from neo_ros.benchmark.true_depth import demo_depth, field_depth, is_demo_flat
from neo_ros.evaluation.evaluate import score_frames, TruthFrames
from neo_ros.evaluation.stability import (
    flicker, follow_points, StabilityRules, stored_depths, warping_error, WarpingError)
from neo_ros.flat.scene_writing import write_demo_scene
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.pictures.usable import write_usable
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import read_scene
import numpy as np
from plain_field import CENTRE, room_field, standing, WALLS
import pytest


@pytest.fixture(scope='module')
def frames(tmp_path_factory):
    folder = tmp_path_factory.mktemp('flat')
    write_demo_scene(folder, image_size=48, n_train=1, n_paths=2, frames_per_path=3, workers=1)
    assert is_demo_flat(folder)
    assert not is_demo_flat(folder / 'train')
    scene = read_scene(folder)
    assert scene.test is not None and scene.expansion is not None
    return TruthFrames(scene.test, scene.expansion)


class Painted:
    """Show given wide images one after the other, the camera's pixels pasted."""

    name = 'painted'
    observed_pasted = True
    train_minutes: float | None = None
    model_mb: float | None = None

    def __init__(self, frames, wide_images):
        self.frames, self.wide_images, self.calls = frames, wide_images, -1

    def expand(self, narrow_image):
        wide_image = self.wide_images[max(self.calls, 0) % len(self.wide_images)]
        self.calls += 1
        return self.frames.expansion.paste(narrow_image, wide_image)


def errors_of(frames, wide_images):
    watcher = WarpingError(frames, demo_depth(frames))
    scored = score_frames(frames, Painted(frames, wide_images), watchers=[watcher])
    return [(frame.get('warping_error'), frame.get('truth_warping_error')) for frame in scored]


@pytest.mark.slow
def test_the_truth_is_steady_and_noise_is_not(frames):
    truth = [wide for _, wide in frames]
    random = np.random.default_rng(0)
    noisy = [np.clip(wide + random.normal(0, 40, wide.shape), 0, 255).astype(np.uint8)
             for wide in truth]
    steady, of_truth = zip(*errors_of(frames, truth))
    shaking, of_same_truth = zip(*errors_of(frames, noisy))
    assert steady == of_truth == of_same_truth
    # The first frame of a walk has none before it.
    assert [error is None for error in steady] == [True, False, False] * 2
    assert all(error < 0.01 for error in steady if error is not None)
    assert all(s > 2 * t for s, t in zip(shaking, steady) if s is not None)


@pytest.mark.slow
def test_what_masks_leave_out_of_two_frames_is_not_compared(frames, tmp_path):
    truth = [wide for _, wide in frames]
    size = truth[0].shape[:2]
    for name, rows in (('now', np.s_[:size[0] // 4]), ('before', np.s_[-size[0] // 4:])):
        usable = np.ones(size, bool)
        usable[rows] = False
        write_usable(tmp_path / f'{name}.png', usable)
    masks = (tmp_path / 'before.png', tmp_path / 'now.png', None) * 2
    masked = TruthFrames(replace(frames.images, mask_paths=masks), frames.expansion)
    # Painted over: above in the second frame, below in the first and so under where it was seen.
    spoilt = [truth[0].copy(), truth[1].copy(), truth[2]]
    spoilt[0][-size[0] // 4:] = spoilt[1][:size[0] // 4] = 255
    spoilt += truth[3:]
    clean, seen = errors_of(masked, truth)[1][0], errors_of(masked, spoilt)[1][0]
    assert seen == pytest.approx(clean, rel=1e-6) and errors_of(frames, spoilt)[1][0] > 3 * clean


def test_without_motion_the_error_is_the_plain_difference():
    camera = Intrinsics.from_hfov(20, 20, 1.5)
    where, visible = follow_points(camera, np.full((20, 20), 2.0), np.full((20, 20), 2.0),
                                   np.eye(4))
    assert visible[1:-1, 1:-1].all()
    first = np.full((20, 20, 3), 100, np.uint8)
    assert warping_error(first + np.uint8(51), first, where, visible) == pytest.approx(0.04)
    assert warping_error(first, first, where, np.zeros((20, 20), bool)) is None


def test_points_move_as_the_camera_does_and_hidden_ones_do_not_count():
    camera = Intrinsics.from_hfov(20, 20, np.pi / 2)
    T_last_now = np.eye(4)
    T_last_now[0, 3] = 0.4
    far = np.full((20, 20), 2.0)
    where, visible = follow_points(camera, far, far, T_last_now)
    np.testing.assert_allclose(where[5, 5], [5.5 + 2, 5.5], atol=1e-4)
    assert visible[5, 5]
    assert not visible[5, 19]
    near = far.copy()
    near[:, 7] = 1.0
    hidden = follow_points(camera, far, near, T_last_now)[1]
    assert not hidden[5, 5]
    assert hidden[5, 10]
    near[:, 7] = np.nan  # fog: nobody knows
    unknown = follow_points(camera, far, near, T_last_now)[1]
    assert not unknown[5, 5] and unknown[5, 10]


def test_flicker_is_the_deviation_of_the_ring(frames):
    wide = [image for _, image in frames]
    assert flicker(Painted(frames, [wide[0]]), frames) == 0
    between = [np.full_like(wide[0], 100), np.full_like(wide[0], 110)]
    assert flicker(Painted(frames, between), frames) == pytest.approx(5.0, abs=0.2)


def test_the_standing_camera_is_noisy(frames):
    seen = []

    class Watching(Painted):

        def expand(self, narrow_image):
            seen.append(narrow_image.astype(float))
            return super().expand(narrow_image)

    flicker(Watching(frames, [frames.read(0)[1]]), frames)
    expected = StabilityRules().noise * np.sqrt(2)
    assert np.std(seen[0] - seen[1]) == pytest.approx(expected, rel=0.25)


def test_depths_are_rendered_once(frames, tmp_path):
    calls = []

    def render(index):
        calls.append(index)
        return np.full((96, 96), index + 0.5)

    depth_of = stored_depths(frames, render, tmp_path / 'depths.npz')
    again = stored_depths(frames, render, tmp_path / 'depths.npz')
    assert calls == list(range(6))
    assert again(4).mean() == depth_of(4).mean() == 4.5


def test_the_fields_depth_is_along_the_optical_axis(tmp_path):
    camera = Intrinsics.from_hfov(24, 24, np.pi / 2)
    pose = CameraPose(standing().T_world_cam)
    images = PosedImages(camera.grown(12, 12, 12, 12), (tmp_path / 'none.png',), (pose,), (0,))
    frames = TruthFrames(images, ViewExpansion.to_size(camera, 48, 48))
    depth = field_depth(frames, room_field(400_000))(0)
    wall = WALLS[0] + CENTRE[0] - pose.position[0]
    ahead = depth[20:28, 16:32]
    np.testing.assert_allclose(ahead, wall, rtol=0.05)
