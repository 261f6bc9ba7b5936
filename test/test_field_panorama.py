import math

from neo_ros.evaluation.metrics import psnr
from neo_ros.field.panorama import Band, Panorama, render_panorama, view_band
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.field.voxel_field import RadianceField
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.scenes.pose_sampling import rotation_from_angles
import numpy as np
from plain_field import CENTRE, room_field, standing
import pytest

VIEW = Intrinsics.from_hfov(48, 40, 1.8)
ALL_ROUND = (-math.pi, 2 * math.pi)
ANGLES = [(0.0, 0.0, 0.0), (math.pi, 0.0, 0.0), (-3.0, 0.0, 0.0), (1.3, 0.4, 0.0),
          (-2.0, -0.3, 0.5), (0.5, 1.4, 0.2)]


@pytest.fixture(scope='module')
def field() -> RadianceField:
    result = room_field()
    result.update_occupancy()
    # What lies to the left of the room's centre, nobody saw.
    result.seen = (result.world_points()[..., 1] < CENTRE[1]).astype(np.uint8).ravel()
    return result


@pytest.fixture(scope='module')
def panorama(field: RadianceField) -> Panorama:
    rotations = np.stack([rotation_from_angles(*angles) for angles in ANGLES])
    band = view_band(VIEW, rotations, ALL_ROUND)
    return render_panorama(field, CENTRE, VIEW, band)


@pytest.mark.parametrize('angles', ANGLES, ids=[
    'ahead', 'back, at the seam', 'beside the seam', 'up', 'down and rolled', 'at the zenith'])
def test_views_cut_out_are_the_views_rendered(
        field: RadianceField, panorama: Panorama, angles: tuple[float, float, float]) -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_angles(*angles), CENTRE
    rendering = render_view(field, VIEW, CameraPose(T))
    cut = panorama.cut_view(VIEW, T[:3, :3])
    assert cut.shape == (40, 48, 4) and cut.dtype == np.uint8
    assert psnr(to_uint8(rendering.image), cut[..., :3]) > 35
    coverage = to_uint8(rendering.coverage)
    assert ((cut[..., 3] > 127) == (coverage > 127)).mean() > 0.97


def test_coverage_tells_what_a_photo_saw(panorama: Panorama) -> None:
    right = panorama.cut_view(VIEW, standing(yaw=-math.pi / 2).T_world_cam[:3, :3])
    left = panorama.cut_view(VIEW, standing(yaw=math.pi / 2).T_world_cam[:3, :3])
    assert right[..., 3].min() > 250 and left[..., 3].max() < 5


def test_nothing_is_covered_beyond_the_band(field: RadianceField) -> None:
    field = room_field(5000)
    field.update_occupancy()
    band = view_band(VIEW, rotation_from_angles(0, 0, 0)[None], ALL_ROUND)
    panorama = render_panorama(field, CENTRE, VIEW, band)
    level = panorama.cut_view(VIEW, rotation_from_angles(1.0, 0, 0))
    assert level[..., 3].min() > 250
    raised = panorama.cut_view(VIEW, rotation_from_angles(1.0, 0.5, 0))
    rise = np.arcsin((VIEW.pixel_rays() @ rotation_from_angles(1.0, 0.5, 0)[2])
                     / np.linalg.norm(VIEW.pixel_rays(), axis=-1))
    margin = 1.5 / VIEW.fy
    assert raised[rise > band.top + margin, 3].max() == 0
    assert raised[(rise < band.top - margin) & (rise > band.bottom), 3].min() > 250


def test_level_views_need_the_rise_of_their_middle_column() -> None:
    view = Intrinsics(48, 40, 20.0, 20.0, 24.0, 15.0)
    rotations = np.stack([rotation_from_angles(yaw, 0, 0) for yaw in (0.0, 1.0, 3.0)])
    rise = [math.atan(15 / 20), -math.atan(25 / 20)]
    band = view_band(view, rotations, ALL_ROUND)
    np.testing.assert_allclose((band.top, band.bottom), rise, atol=0.03)


@pytest.mark.parametrize('angles, top, bottom', [
    ((0.3, math.radians(80), 0.1), True, False),
    ((0.3, math.radians(-80), 0.1), False, True),
    # Rolled upright: the pole shows far off the axis, along the image's long side.
    ((0.0, math.radians(50), math.pi / 2), True, False),
    ((0.0, math.radians(20), math.pi / 2), False, False),
], ids=['zenith', 'nadir', 'zenith beside the axis', 'none'])
def test_a_pole_in_the_image_needs_the_band_up_to_it(
        angles: tuple[float, float, float], top: bool, bottom: bool) -> None:
    view = Intrinsics(160, 40, 50.0, 50.0, 80.0, 20.0)  # 116 x 44 deg
    band = view_band(view, rotation_from_angles(*angles)[None], ALL_ROUND)
    assert (band.top == math.pi / 2, band.bottom == -math.pi / 2) == (top, bottom)


@pytest.mark.parametrize('low', [0.5, 2.8], ids=['plain', 'across the seam'])
def test_a_narrow_range_of_yaws_needs_part_of_the_circle(field: RadianceField, low: float) -> None:
    yaws = (low, low + 0.4, low + 0.8)
    rotations = np.stack([rotation_from_angles(yaw, 0.1, 0.05) for yaw in yaws])
    band = view_band(VIEW, rotations, (low, 0.8))
    assert 0.8 + VIEW.hfov < band.width < 4
    panorama = render_panorama(field, CENTRE, VIEW, band)
    whole = render_panorama(field, CENTRE, VIEW, Band(band.top, band.bottom))
    for rotation in rotations:
        assert psnr(whole.cut_view(VIEW, rotation)[..., :3],
                    panorama.cut_view(VIEW, rotation)[..., :3]) > 40
