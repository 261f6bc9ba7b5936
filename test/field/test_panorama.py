import math

from neo_ros.evaluation.metrics import psnr
from neo_ros.field.panorama import MARGIN, Panorama, render_panorama, view_band
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.field.view_cutting import ViewCutter
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.scenes.pose_sampling import rotation_from_angles
import numpy as np
from plain_field import CENTRE, room_field, standing
import pytest
import torch

VIEW = Intrinsics.from_hfov(48, 40, 1.8)
ALL_ROUND = (-math.pi, 2 * math.pi)
ANGLES = [(0.0, 0.0, 0.0), (math.pi, 0.0, 0.0), (-3.0, 0.0, 0.0), (1.3, 0.4, 0.0),
          (-2.0, -0.3, 0.5), (0.5, 1.4, 0.2)]


@pytest.fixture(scope='module')
def field() -> VoxelField:
    result = room_field()
    result.update_occupancy()
    # What lies to the left of the room's centre, nobody saw.
    result.seen = (result.world_points()[..., 1] < CENTRE[1]).astype(np.uint8).ravel()
    return result


@pytest.fixture(scope='module')
def panorama(field: VoxelField) -> Panorama:
    rotations = np.stack([rotation_from_angles(*angles) for angles in ANGLES])
    band = view_band(VIEW, rotations, ALL_ROUND)
    return render_panorama(field, CENTRE, VIEW, band)


@pytest.mark.parametrize('angles', ANGLES, ids=[
    'ahead', 'back, at the seam', 'beside the seam', 'up', 'down and rolled', 'at the zenith'])
def test_views_cut_out_are_the_views_rendered(
        field: VoxelField, panorama: Panorama, angles: tuple[float, float, float]) -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_angles(*angles), CENTRE
    rendering = render_view(field, VIEW, CameraPose(T))
    cut = panorama.cut_view(VIEW, T[:3, :3])
    assert cut.shape == (40, 48, 4) and cut.dtype == np.uint8
    assert psnr(to_uint8(rendering.image), cut[..., :3]) > 40
    coverage = to_uint8(rendering.coverage)
    assert ((cut[..., 3] > 127) == (coverage > 127)).mean() > 0.97


def test_coverage_tells_what_a_photo_saw(panorama: Panorama) -> None:
    right = panorama.cut_view(VIEW, standing(yaw=-math.pi / 2).T_world_cam[:3, :3])
    left = panorama.cut_view(VIEW, standing(yaw=math.pi / 2).T_world_cam[:3, :3])
    assert right[..., 3].min() > 250 and left[..., 3].max() < 5


@pytest.mark.parametrize('middle', [0.4, 3.0], ids=['ahead', 'across the seam'])
def test_a_hand_held_camera_needs_a_part_of_the_sphere(
        field: VoxelField, middle: float) -> None:
    angles = [(middle + 0.5 * k, 0.2 * k, 0.1 * k) for k in (-1, 0, 1)]
    rotations = np.stack([rotation_from_angles(*triple) for triple in angles])
    band = view_band(VIEW, rotations, (middle - 0.5, 1.0))
    assert 1.0 + VIEW.hfov <= band.width < 4.0 < 2 * math.pi
    panorama = render_panorama(field, CENTRE, VIEW, band)
    for R in rotations:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, CENTRE
        cut = panorama.cut_view(VIEW, R)
        assert psnr(to_uint8(render_view(field, VIEW, CameraPose(T)).image), cut[..., :3]) > 40


@pytest.fixture(scope='module')
def level_panorama() -> Panorama:
    field = room_field(5000)
    field.update_occupancy()
    rotations = np.stack([rotation_from_angles(yaw, 0, 0) for yaw in (0.0, 0.5)])
    return render_panorama(field, CENTRE, VIEW, view_band(VIEW, rotations, (0.0, 0.5)))


def test_nothing_is_covered_above_the_band(level_panorama: Panorama) -> None:
    assert level_panorama.cut_view(VIEW, rotation_from_angles(0.3, 0, 0))[..., 3].min() > 250
    R = rotation_from_angles(0.3, 0.4, 0)
    raised = level_panorama.cut_view(VIEW, R)[:, 12:36, 3]
    rays = VIEW.pixel_rays()[:, 12:36]
    rise = np.arcsin(rays @ R[2] / np.linalg.norm(rays, axis=-1))
    top, margin = level_panorama.band.top, 1.5 / VIEW.fy
    assert raised[rise > top + margin].max() == 0
    assert raised[rise < top - margin].min() > 250


def test_nothing_is_covered_beside_the_band(level_panorama: Panorama) -> None:
    band, margin = level_panorama.band, 2 / VIEW.fx
    for yaw in (0.5 + 0.8, -0.8):
        turned = level_panorama.cut_view(VIEW, rotation_from_angles(yaw, 0, 0))[20, :, 3]
        azimuth = yaw - np.arctan(VIEW.pixel_rays()[20, :, 0])
        outside = np.maximum(band.low - azimuth, azimuth - band.low - band.width)
        assert (outside > margin).any() and turned[outside > margin].max() == 0
        assert turned[outside < -margin].min() > 250


def test_level_views_need_the_rise_of_their_middle_column() -> None:
    view = Intrinsics(48, 40, 20.0, 20.0, 24.0, 15.0)
    rotations = np.stack([rotation_from_angles(yaw, 0, 0) for yaw in (0.0, 1.0, 3.0)])
    band = view_band(view, rotations, (0.0, 3.0))
    np.testing.assert_allclose(
        [band.top, band.bottom], [math.atan(15 / 20), -math.atan(25 / 20)], atol=0.03)
    reach = math.atan(24 / 20) + MARGIN
    np.testing.assert_allclose([band.low, band.width], [-reach, 3 + 2 * reach], atol=0.03)


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
    band = view_band(view, rotation_from_angles(*angles)[None], (angles[0], 0.0))
    assert (band.top == math.pi / 2, band.bottom == -math.pi / 2) == (top, bottom)
    assert (band.width == 2 * math.pi) == (top or bottom)


DEVICES = ['cpu', pytest.param('cuda', marks=pytest.mark.skipif(
    not torch.cuda.is_available(), reason='no GPU that torch can use'))]


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('angles', [*ANGLES, (0.3, 0.4, 0.0), (1.3, 0.0, 0.0)])
def test_torch_cuts_the_views_that_opencv_cuts(
        panorama: Panorama, level_panorama: Panorama, angles: tuple[float, float, float],
        device: str) -> None:
    cutter, R = ViewCutter(VIEW, torch.device(device)), rotation_from_angles(*angles)
    for shown in (panorama, level_panorama):
        cut = cutter.cut(shown, R)
        assert cut.dtype == torch.uint8 and cut.device.type == device
        expected = shown.cut_view(VIEW, R)
        found = cut.cpu().numpy()
        # OpenCV counts in 32nds of a pixel.
        assert np.abs(found[..., :3].astype(int) - expected[..., :3]).mean() < 0.5
        assert ((found[..., 3] > 127) == (expected[..., 3] > 127)).mean() > 0.995


def test_panoramas_beyond_what_a_device_holds_come_again(panorama: Panorama) -> None:
    cutter, R = ViewCutter(VIEW, torch.device('cpu')), np.eye(3)
    cutter.kept_bytes = 2.5 * panorama.image.nbytes
    shown = [Panorama(panorama.position, np.roll(panorama.image, 9 * k, 1), panorama.band)
             for k in range(4)]
    first = [cutter.cut(one, R) for one in shown]
    assert list(cutter._images) == shown[2:]
    assert torch.equal(cutter.cut(shown[0], R), first[0])
    assert not torch.equal(first[0], first[1])
    assert list(cutter._images) == [shown[3], shown[0]]
