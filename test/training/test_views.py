"""The views that a run trains on: as wide as the model's, or in the ablation as the photos."""
from dataclasses import replace
from pathlib import Path

from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.machine.progress import no_stage_progress
from neo_ros.pictures.usable import write_usable
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.training.run import TrainingRun
from neo_ros.training.views import (
    make_sampler, make_stream, real_frames, real_usable, RealFrames)
import numpy as np
import pytest
from tiny_training import TINY


@pytest.mark.parametrize('training_view, hfov_deg', [('wide', 126.87), ('source', 90.0)])
def test_training_views_are_as_wide_as_asked_and_as_large_as_the_models(
        tiny_run: TrainingRun, training_view: str, hfov_deg: float) -> None:
    run = replace(tiny_run, experiment=replace(TINY, outpaint=replace(
        TINY.outpaint, training_view=training_view, real_centre=0.0)))
    stream = make_stream(run, VoxelField.load(run.out / 'field.npz'), seed=0)
    view = stream.pool.view
    assert np.degrees(view.hfov) == pytest.approx(hfov_deg, abs=0.01)
    assert (view.width, view.height) == (64, 64) and stream.real is None
    assert stream.batch(0, 2).shape == (2, 64, 64, 4)


def test_frames_are_read_one_by_one_and_keep_no_photo(tiny_run: TrainingRun) -> None:
    photos = tiny_run.scene.train
    frames = RealFrames.of(tiny_run, 5, photos)
    np.testing.assert_array_equal(np.stack(frames), real_frames(tiny_run, 5, photos))
    np.testing.assert_array_equal(frames[4], photos.read_image(len(photos) - 1))
    assert len(frames) == 5 and len(frames[1:3]) == 2
    assert all(frame.base is None for frame in frames)


def test_masks_are_read_one_by_one_too(tiny_run: TrainingRun, tmp_path: Path) -> None:
    photos = tiny_run.scene.train
    mask = np.ones((photos.intrinsics.height, photos.intrinsics.width), bool)
    mask[:5] = False
    write_usable(tmp_path / 'mask.png', mask)
    usable = real_usable(tiny_run, 5, replace(photos, mask_paths=(
        tmp_path / 'mask.png', *[None] * (len(photos) - 1))))
    assert usable is not None and len(usable) == 5
    np.testing.assert_array_equal(usable[0], mask)
    assert all(one.all() for one in usable[1:])
    assert real_usable(tiny_run, 5, photos) is None


@pytest.mark.parametrize('down_deg', [0.0, 25.0], ids=['level', 'tilted'])
def test_on_a_floor_map_views_are_tilted_as_the_photos(
        flat_scene: Path, tmp_path: Path, down_deg: float) -> None:
    scene, down = read_upright_scene(flat_scene), np.eye(4)
    down[:3, :3] = rotation_from_vector(np.array([-np.radians(down_deg), 0, 0]))
    train = replace(scene.train, poses=tuple(
        CameraPose(pose.T_world_cam @ down) for pose in scene.train.poses))
    run = TrainingRun(replace(scene, train=train), TINY, tmp_path, no_stage_progress)
    assert run.sampling_area == 'walkable'
    means, deviations = make_sampler(run, None).pitch_roll
    assert means == pytest.approx((-np.radians(down_deg), 0), abs=1e-6)
    assert deviations == pytest.approx((0, 0), abs=1e-6)
    assert down_deg or (means, deviations) == ((0.0, 0.0), (0.0, 0.0))
