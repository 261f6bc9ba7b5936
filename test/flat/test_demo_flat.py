import subprocess
import sys

from neo_ros.flat.demo_flat import build_demo_flat, DemoFlat, sample_training_poses
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
import numpy as np
import pytest

NARROW = Intrinsics.from_hfov(32, 32, np.pi / 2)
STANDING = CameraPose.from_planar(3.4, 1.7, 1.5, 2.6)


@pytest.fixture(scope='module')
def flat() -> DemoFlat:
    return build_demo_flat()


def test_image_and_depth_have_the_promised_form(flat):
    image, depth = flat.render(Intrinsics.from_hfov(40, 24, 1.2), STANDING)
    assert image.shape == (24, 40, 3) and image.dtype == np.uint8
    assert depth.shape == (24, 40) and depth.dtype == np.float32
    assert np.isfinite(depth).all() and (depth > 0).all()


def test_two_renders_are_identical(flat):
    first, second = flat.render(NARROW, STANDING), flat.render(NARROW, STANDING)
    assert np.array_equal(first[0], second[0]) and np.array_equal(first[1], second[1])


@pytest.mark.slow
def test_another_process_renders_the_same(flat):
    code = (
        'import sys, numpy as np\n'
        'from neo_ros.geometry import CameraPose, Intrinsics\n'
        'from neo_ros.flat.demo_flat import build_demo_flat\n'
        'image, depth = build_demo_flat().render(Intrinsics.from_hfov(32, 32, np.pi / 2),\n'
        '                                        CameraPose.from_planar(3.4, 1.7, 1.5, 2.6))\n'
        'sys.stdout.buffer.write(image.tobytes() + depth.tobytes())\n')
    answer = subprocess.run([sys.executable, '-c', code], capture_output=True, check=True)
    image, depth = flat.render(NARROW, STANDING)
    assert answer.stdout == image.tobytes() + depth.tobytes()


# What a level camera has straight ahead, in metres, from the plan of the flat.
@pytest.mark.parametrize('x, y, z, yaw_deg, metres', [
    (3.9, 2.6, 1.5, 90, 1.6),    # north wall of the living room, y = 4.2
    (3.0, 2.5, 2.5, 0, 3.0),     # east wall above the door, x = 6
    (1.0, 2.55, 1.5, 0, 9.0),    # through the doorway: east wall of the bedroom, x = 10
    (7.0, 1.3, 1.5, 180, 0.26),  # front of the wardrobe, x = 6.74
    (3.6, 2.3, 1.5, 180, 25.6),  # out of the window: the end of the world, x = -22
], ids=['wall', 'over the door', 'through the door', 'wardrobe', 'window'])
def test_depth_straight_ahead(flat, x, y, z, yaw_deg, metres):
    pose = CameraPose.from_planar(x, y, z, np.radians(yaw_deg))
    _, depth = flat.render(Intrinsics.from_hfov(9, 9, 0.5), pose)
    assert depth[4, 4] == pytest.approx(metres, rel=1e-5)


def test_depth_is_measured_along_the_optical_axis(flat):
    # The bare wall above the door is a plane across the view: one depth, whatever the angle.
    pose = CameraPose.from_planar(5.0, 2.55, 2.3, 0.0)
    _, depth = flat.render(Intrinsics.from_hfov(24, 6, 0.8), pose)
    np.testing.assert_allclose(depth[:, :], 1.0, atol=1e-5)


@pytest.mark.parametrize('target', [(64, 64), (48, 32), (62, 50)], ids=str)
def test_the_narrow_view_is_the_crop_of_the_wide_one(flat, target):
    expansion = ViewExpansion.to_size(NARROW, *target)
    for pose in (STANDING, CameraPose.from_planar(7.4, 3.0, 1.5, -0.9)):
        wide, wide_depth = flat.render(expansion.target, pose)
        narrow, depth = flat.render(NARROW, pose)
        assert np.array_equal(expansion.crop(wide), narrow)
        assert np.array_equal(expansion.crop(wide_depth), depth)


def test_depth_agrees_with_what_a_step_forward_sees(flat):
    # A point seen from one place projects to a point of the same depth seen from another.
    back = CameraPose.from_planar(3.0, 2.5, 1.5, 0.0)
    front = CameraPose.from_planar(3.5, 2.5, 1.5, 0.0)
    camera = Intrinsics.from_hfov(65, 65, np.pi / 2)
    _, far = flat.render(camera, back)
    _, near = flat.render(camera, front)
    points = camera.pixel_rays() * far[..., None] - np.array([0, 0, 0.5])
    pixels = np.floor(camera.project(points))
    inside = ((pixels >= 0) & (pixels < 65)).all(axis=-1)
    i, j = pixels[inside].astype(int).T
    error = np.abs(near[j, i] - points[inside][:, 2])
    assert inside.mean() > 0.5
    assert np.median(error) < 0.02


def test_views_are_neither_black_nor_blown_out_and_differ(flat):
    poses = sample_training_poses(flat, 12, seed=5)
    images = np.stack([flat.render(NARROW, pose)[0] for pose in poses]).astype(float)
    brightness = images.mean(axis=(1, 2, 3))
    assert (brightness > 60).all() and (brightness < 200).all()
    assert (images.max(axis=-1) < 12).mean() < 0.03
    assert (images.min(axis=-1) > 250).mean() < 0.06
    assert images.std(axis=(1, 2, 3)).mean() > 30
    # Colourful: a grey test card has no chroma.
    assert (images.max(axis=-1) - images.min(axis=-1)).mean() > 25
    assert np.abs(images - images[::-1]).mean() > 20


def test_anti_aliasing_agrees_with_many_more_rays(flat):
    coarse = flat.render(NARROW, STANDING)[0].astype(float)
    fine = flat.render(NARROW.scaled(8), STANDING)[0].astype(float)
    reference = fine.reshape(32, 8, 32, 8, 3).mean(axis=(1, 3))
    assert np.abs(coarse - reference).mean() < 3.5
