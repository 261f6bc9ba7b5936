"""What the camera has just seen beside its present view."""
from typing import Any

from box_room import box_memory, EXPANSION, planar, view
import cv2
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.compiled import ALL_THREADS
from neo_ros.memory.changes import Changes
from neo_ros.memory.guided_view import GuidedView
from neo_ros.memory.patch import Patch
from neo_ros.memory.recent_images import RecentImages, RecentThresholds, SeenBefore
from neo_ros.memory.recent_kernels import bring_differences
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.thresholds import GuideThresholds
import numpy as np
import pytest

BEFORE, NOW = planar(1.9, 1.7, 35), planar(1.95, 1.7, 60)
RING = EXPANSION.extrapolated_mask
ONE = np.ones(3, np.float32)
GREY = np.full((128, 128, 3), 100, np.float32)


def depth_at(pose: CameraPose, camera: Intrinsics = EXPANSION.target) -> np.ndarray:
    return view(pose, camera)[1].astype(np.float32)


def keep(recent: RecentImages, pose: CameraPose, difference: Any, gain: float = 1.0) -> None:
    """Keep an image that is brighter than the memory's grey by so much, a number or (h, w)."""
    image = EXPANSION.crop(GREY) + np.broadcast_to(difference, (64, 64))[..., None]
    recent.keep(image.astype(np.uint8), GREY, depth_at(pose), pose, gain * ONE)


def there(expansion: ViewExpansion, pose: CameraPose, seen_from: CameraPose) -> np.ndarray:
    """Return where another image shows the surfaces of a wide view, pixels (H, W, 2)."""
    points = expansion.target.pixel_rays() * depth_at(pose, expansion.target)[..., None]
    T = seen_from.inverse() @ pose.T_world_cam
    return np.nan_to_num(expansion.source.project(points @ T[:3, :3].T + T[:3, 3]), nan=-1e3)


def brought(recent: RecentImages, pose: CameraPose = NOW) -> SeenBefore:
    seen = recent.bring(depth_at(pose), pose, ONE)
    assert seen is not None
    return seen


def ramp_error(expansion: ViewExpansion, count: int) -> float:
    """
    Return by how much what is brought is wrong at most, of a ramp of a level a column.

    The image is `count` columns wide as it is kept; those at the right hold the ramp.
    """
    source, target = expansion.source, expansion.target
    step, middle = source.width / count, 0.8 * source.width
    ramp = (np.arange(source.width) + 0.5 - middle) / step
    recent = RecentImages(expansion)
    grey = np.full((target.height, target.width, 3), 100, np.float32)
    image = 100 + np.broadcast_to(np.clip(ramp, -11, 11)[:, None],
                                  (source.height, source.width, 3))
    shown = grey.copy()
    shown[expansion.observed] += np.rint(image) - image  # So that nothing is rounded.
    recent.keep(np.rint(image).astype(np.uint8), shown, depth_at(BEFORE, target), BEFORE, ONE)
    brought = recent.bring(depth_at(NOW, target), NOW, ONE)
    assert brought is not None
    seen = brought.at((target.height, target.width))
    where = there(expansion, NOW, BEFORE)
    expected = (where[..., 0] - middle) / step
    sure = (seen.weight > 0.55) & (np.abs(expected) < 9)
    assert sure.sum() > 300
    return float(np.abs(seen.difference[sure] / seen.weight[sure][:, None]
                        - expected[sure][:, None]).max())


def test_a_difference_is_shown_where_its_surface_is_now() -> None:
    assert RecentImages(EXPANSION).bring(depth_at(NOW), NOW, ONE) is None
    assert ramp_error(EXPANSION, 64) < 0.05


def test_a_large_camera_is_followed_at_less_resolution() -> None:
    large = ViewExpansion.to_size(Intrinsics.from_hfov(301, 203, np.pi / 2), 501, 363)
    assert ramp_error(large, 128) < 0.5  # The depth of a wide pixel is its nearest neighbour's.


def test_the_whole_of_what_was_seen_is_shown() -> None:
    recent = RecentImages(EXPANSION)
    keep(recent, BEFORE, 5)
    weight = brought(recent).weight
    where = there(EXPANSION, NOW, BEFORE)
    inside, around = (((where > border) & (where < 64 - border)).all(-1) & RING
                      for border in (6, -1))
    assert inside.sum() > 500 and not weight[EXPANSION.observed].any()
    assert (weight[inside] > 0.5).mean() > 0.97  # Depth is looked up to the pixel.
    assert np.all(weight[~around] == 0)


def test_what_the_memory_does_not_know_is_no_difference() -> None:
    recent = RecentImages(EXPANSION)
    image, depth, shown = GREY.astype(np.uint8), depth_at(BEFORE), GREY.copy()
    shown[:, 70:78], depth[:, 70:78] = 0, 0
    recent.keep(EXPANSION.crop(image), shown, depth, BEFORE, ONE)
    assert np.all(brought(recent).difference == 0)


def test_what_is_hidden_from_there_is_not_shown() -> None:
    recent = RecentImages(EXPANSION)
    recent.keep(EXPANSION.crop(GREY).astype(np.uint8), GREY, 0.5 * depth_at(BEFORE), BEFORE, ONE)
    assert recent.bring(depth_at(NOW), NOW, ONE) is None


@pytest.mark.parametrize('yaw, second, trusted', [
    (None, 0, False), (47, 60, True), (47, -60, False), (35, 60, False), (36, 60, False)],
    ids=['seen once', 'seen twice', 'contradicted', 'seen from one pose', 'from nearly one pose'])
def test_a_large_difference_has_to_be_seen_from_two_poses(yaw: float | None, second: int,
                                                          trusted: bool) -> None:
    recent = RecentImages(EXPANSION)
    keep(recent, BEFORE, 60)
    if yaw is not None:
        keep(recent, planar(1.9, 1.7, yaw), second)
    seen = recent.bring(depth_at(NOW), NOW, ONE)
    assert (seen is not None and bool((seen.weight > 0.3).any())) == trusted
    assert trusted or seen is None


@pytest.mark.parametrize('gain', [0.5, 2.0])
def test_a_difference_is_brought_to_the_present_exposure(gain: float) -> None:
    recent = RecentImages(EXPANSION)
    keep(recent, BEFORE, 4, gain)
    difference, weight = brought(recent)
    shown = difference[weight > 0] / weight[weight > 0][:, None]
    assert shown == pytest.approx(4 / gain, abs=1e-3)


def test_what_is_trusted_does_not_depend_on_the_light() -> None:
    recent = RecentImages(EXPANSION)
    keep(recent, BEFORE, 12, gain=0.25)  # 48 grey levels of the memory.
    assert recent.bring(depth_at(NOW), NOW, ONE) is None


def test_a_blurred_image_takes_no_detail_away() -> None:
    detailed = 10 + 0.8 * view(BEFORE, EXPANSION.target)[0].astype(np.float32)
    detailed[::2] += 8
    blurred = cv2.GaussianBlur(detailed, (0, 0), 1.5)
    brings = []
    for image, memory in ((detailed, blurred), (blurred, detailed)):
        recent = RecentImages(EXPANSION)
        recent.keep(EXPANSION.crop(image).astype(np.uint8), memory, depth_at(BEFORE), BEFORE, ONE)
        seen = brought(recent)
        assert seen.weight.any()
        brings.append(np.abs(seen.difference)[seen.weight > 0].mean())
    assert brings[1] < 0.7 * brings[0]  # The two differ by as much.


def test_a_standing_camera_keeps_its_first_and_its_last_image() -> None:
    recent = RecentImages(EXPANSION)
    for difference in (0, 2, 4, 6):
        keep(recent, BEFORE, difference)
    seen = brought(recent)
    sure = seen.weight > 0.8399
    assert seen.difference[sure] / seen.weight[sure][:, None] == pytest.approx(
        6 * 0.6 / 0.84, abs=1e-3)


def test_only_so_many_images_are_kept_and_none_for_long() -> None:
    recent = RecentImages(EXPANSION)
    for step in range(3 * RecentThresholds.kept):
        keep(recent, planar(1.9, 1.7, 35 + 15 * step), 5)
    assert len(recent._order) == RecentThresholds.kept
    recent.forget()
    assert recent.bring(depth_at(NOW), NOW, ONE) is None
    recent = RecentImages(EXPANSION, RecentThresholds(forgotten=3))
    keep(recent, BEFORE, 5)
    keep(recent, NOW, 5)
    assert brought(recent).weight.any()
    for _ in range(2):
        keep(recent, NOW, 5)
    assert recent.bring(depth_at(NOW), NOW, ONE) is None  # NOW alone, which is no ring.


def test_a_camera_that_stood_for_long_keeps_images_as_ever() -> None:
    recent = RecentImages(EXPANSION, RecentThresholds(forgotten=4))
    for step in range(20):
        yaw = 35 + 15 * max(0, step - 12) - 15 * max(0, 4 - step)  # Comes, stands, goes.
        pose = planar(1.9, 1.7, yaw)
        recent.bring(depth_at(pose), pose, ONE)
        keep(recent, pose, 5)
        assert len(set(recent._order)) == len(recent._order)
        assert np.allclose(recent._poses[recent._order[0]].T_world_cam, pose.T_world_cam)
    assert len(recent._order) == 5  # The last one and four before it.


def painted(pose: CameraPose) -> np.ndarray:
    """Return the wide view of the room after a part of its walls was painted lighter."""
    image, depth = view(pose, EXPANSION.target)
    rays = EXPANSION.target.pixel_rays() @ pose.T_world_cam[:3, :3].T
    x, y, _ = np.moveaxis(pose.position + rays * depth[..., None], -1, 0)
    paint = np.exp(-((x - 5) ** 2 + (y - 2.6) ** 2) / 0.3) * 90
    return np.clip(image + paint[..., None], 0, 255).astype(np.uint8)


def test_what_has_changed_is_shown_where_the_camera_has_just_seen_it() -> None:
    guided = GuidedView(SceneGuide(box_memory(), EXPANSION))
    for step in range(10):  # It turns away from the new paint.
        pose = planar(1.9 + 0.01 * step, 1.7, 20 - 7 * step)
        truth = painted(pose)
        image = np.ascontiguousarray(EXPANSION.crop(truth))
        guide = guided.guide(image)
    assert guide is not None
    wide, _ = guided.fuse(image, guide)
    before = view(pose, EXPANSION.target)[0].astype(int)
    changed = RING & (np.abs(truth - before).max(-1) > 25)
    assert changed.sum() > 50
    error = np.abs(wide.astype(int) - truth)[changed].mean()
    assert error < 0.4 * np.abs(before - truth)[changed].mean()
    assert np.array_equal(EXPANSION.crop(wide), image)
    guided.reset()
    fresh = guided.guide(image)
    assert fresh is not None and fresh.seen_before is None


def test_nothing_is_compiled_while_a_camera_is_followed() -> None:
    guide = SceneGuide(box_memory(), EXPANSION)
    guide.warm_up()
    compiled = len(bring_differences.signatures)
    for step in range(3):
        image = EXPANSION.crop(painted(planar(1.9, 1.7, 20 - 7 * step)))
        found = guide.guide(np.ascontiguousarray(image))
    assert found is not None and found.seen_before is not None
    assert len(bring_differences.signatures) == compiled > 0


@pytest.mark.parametrize('lost_for', [1, GuideThresholds.search_every + 1])
def test_a_camera_that_was_lost_for_long_begins_anew(lost_for: int) -> None:
    guide = SceneGuide(box_memory(), EXPANSION)
    images = [np.ascontiguousarray(EXPANSION.crop(painted(planar(1.9, 1.7, 20 - 7 * step))))
              for step in range(3)]
    seen = [guide.guide(image) for image in images]
    assert seen[2] is not None and seen[2].seen_before is not None
    noise = np.random.default_rng(0).integers(0, 256, images[0].shape).astype(np.uint8)
    for _ in range(lost_for):
        assert guide.guide(noise) is None
    found = [guide.guide(images[2]) for _ in range(GuideThresholds.search_every)]
    first = next(one for one in found if one is not None)
    assert (first.seen_before is None) == (lost_for > 1)


@pytest.mark.slow
@pytest.mark.skipif(ALL_THREADS < 2, reason='one processor')
def test_the_number_of_threads_changes_no_bit() -> None:
    seen = []
    for threads in (1, 2):
        guide = SceneGuide(box_memory(), EXPANSION, threads)
        for step in range(5):
            found = guide.guide(np.ascontiguousarray(
                EXPANSION.crop(painted(planar(1.9, 1.7, 20 - 7 * step)))))
        assert found is not None and found.seen_before is not None
        seen.append(found.seen_before)
    assert seen[0].weight.any()
    assert all(np.array_equal(one, other) for one, other in zip(*seen))


def test_where_the_memory_has_changed_no_image_of_before_corrects_it() -> None:
    recent = RecentImages(EXPANSION)
    keep(recent, BEFORE, 20)
    whole = brought(recent)
    # What has changed lies before the camera of now, above its middle.
    fine = EXPANSION.target.scaled(4)
    depth = depth_at(NOW, fine)
    image = np.full((*depth.shape, 3), 120, np.uint8)
    depth[256:] = 0
    changes = Changes((Patch.of(NOW, fine, image, depth, 0, 0, (image, depth)),))
    recent.distrust(changes)
    less = brought(recent)
    assert (less.weight[:60] == 0).all() and (whole.weight[:60] > 0).any()
    np.testing.assert_array_equal(less.weight[74:], whole.weight[74:])
    assert (less.weight[74:] > 0).any()
