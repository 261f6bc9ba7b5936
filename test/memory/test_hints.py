"""Priors and odometry say where to look first; without the image they are dropped."""
import box_room
from box_room import apart, box_memory, box_walk, EXPANSION, planar, view
from neo_ros.geometry import CameraPose
from neo_ros.memory.panorama import draw_panorama, REMEMBERED, SEEN, SPHERE, UNKNOWN
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_guide import SceneGuide
import numpy as np
import pytest

MEMORY = box_memory()
WALK = box_walk(6)


@pytest.fixture
def guide():
    return SceneGuide(MEMORY, EXPANSION, threads=2)


def image(pose):
    return view(pose, EXPANSION.source)[0]


def test_a_click_on_a_map_finds_the_camera(guide):
    pose = planar(2.1, 1.6, 40)
    click = CameraPose.from_planar(2.5, 1.3, 0.0, np.radians(60))
    found = guide.guide(image(pose), prior=click)
    assert found.found == 'prior' and apart(found.pose, pose)[0] < 0.02


def test_a_wrong_prior_changes_nothing(guide):
    for pose in WALK[:2]:
        guide.guide(image(pose))
    found = guide.guide(image(WALK[2]), prior=planar(3.5, 3.0, 250))
    assert found.found == 'tracked' and apart(found.pose, WALK[2])[0] < 0.02


def test_a_prior_where_nothing_agrees_finds_no_camera(guide):
    noise = np.random.default_rng(0).integers(0, 256, image(WALK[0]).shape, np.uint8)
    assert guide.guide(noise, prior=WALK[0]) is None


def test_odometry_bridges_a_jump_that_tracking_does_not(guide):
    before, after = planar(1.6, 1.5, 20), planar(2.2, 1.9, 75)
    followed = {}
    for name, motion in (('none', None), ('odometry', before.inverse() @ after.T_world_cam)):
        guide.reset()
        guide.guide(image(before))
        found = guide.guide(image(after), motion=motion)
        followed[name] = found is not None and found.found == 'tracked' and apart(
            found.pose, after)[0] < 0.02
    assert followed == {'none': False, 'odometry': True}


def test_a_camera_goes_on_through_dropped_images(guide):
    walk = [planar(1.3 + 0.12 * step, 1.4, 14 * step) for step in range(6)]
    found = {}
    for name, pace in (('as before', 1.0), ('by the stamps', 3.0)):
        guide.reset()
        for pose in walk[:3]:
            guide.guide(image(pose))
        there = guide.guide(image(walk[5]), pace=pace)
        found[name] = there is not None and there.found == 'tracked' and apart(
            there.pose, walk[5])[0] < 0.02
    assert found == {'as before': False, 'by the stamps': True}


def test_odometry_that_is_wrong_is_not_believed(guide):
    slipped = np.eye(4)
    slipped[:3, 3] = 0.5, 0, 1.0
    for pose in WALK[:3]:
        guide.guide(image(pose))
    found = guide.guide(image(WALK[3]), motion=slipped)
    assert apart(found.pose, WALK[3])[0] < 0.02


def test_the_panorama_is_the_room_in_its_own_axes(guide):
    pose = WALK[0]
    found = guide.guide(image(pose))
    wide = view(pose, EXPANSION.target)[0]
    drawn = found.panorama(wide, 256)
    assert drawn.image.shape == (128, 256, 3) and drawn.kinds.shape == (128, 256)
    true = box_room.cast(found.pose.position, SPHERE.rays(128, 256))[0]
    for kind, most in ((SEEN, 4), (REMEMBERED, 6)):
        assert np.abs(drawn.image.astype(float) - true)[drawn.kinds == kind].mean() < most
    # A quarter of the circle and a little less of the height is in the camera's view.
    assert 0.08 < (drawn.kinds == SEEN).mean() < 0.16
    unknown = drawn.kinds == UNKNOWN
    assert unknown.any() and not drawn.image[unknown].any()
    azimuth = np.pi * (1 - 2 * (np.flatnonzero((drawn.kinds == SEEN).any(0)).mean() + 0.5) / 256)
    assert azimuth == pytest.approx(pose.yaw, abs=0.05)


def test_panoramas_have_the_exposure_of_the_image():
    renderer = MemoryRenderer(MEMORY)
    wide = view(WALK[0], EXPANSION.target)[0]
    one, half = (draw_panorama(renderer, WALK[0], np.full(3, gain), wide, EXPANSION, 64)
                 for gain in (1.0, 0.5))
    remembered = one.kinds == REMEMBERED
    ratio = half.image[remembered].mean() / one.image[remembered].mean()
    assert ratio == pytest.approx(0.5, abs=0.01)


def test_depth_is_not_told_where_somebody_stands(guide):
    frame = image(WALK[0]).copy()
    found = guide.guide(frame)
    wide = view(WALK[0], EXPANSION.target)[0].copy()
    rows, columns = EXPANSION.observed
    wide[rows, columns] = frame
    sure = np.full(wide.shape[:2], 255, np.uint8)
    assert np.isfinite(found.trusted_depth(wide, sure)[rows, columns]).mean() > 0.98
    wide[rows, columns][20:50, 20:40] = 255 - wide[rows, columns][20:50, 20:40]
    sure[:10] = 10
    depth = found.trusted_depth(wide, sure)
    assert np.isnan(depth[rows, columns][25:45, 25:35]).mean() > 0.8
    assert np.isnan(depth[:10]).all()
    assert np.isfinite(depth[rows, columns][:, 48:]).mean() > 0.95
