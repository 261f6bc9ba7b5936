from pathlib import Path
import tracemalloc

from neo_ros.field import free_space
from neo_ros.field.free_space import find_free_floor
from neo_ros.field.rendering import render_rays, Rendering
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
from neo_ros.scenes.pose_sampling import PoseSampler, SamplingConfig
from neo_ros.scenes.posed_images import PosedImages
import numpy as np
from plain_field import CENTRE, room_field, standing, WALLS
import pytest

CAMERA = Intrinsics.from_hfov(32, 32, 1.6)


def photos(*places: tuple[float, float]) -> PosedImages:
    poses = tuple(standing(x, y, yaw) for x, y in places
                  for yaw in np.linspace(0, 2 * np.pi, 8, endpoint=False))
    return PosedImages(CAMERA, (Path('none.png'),) * len(poses), poses, (0,) * len(poses))


def furnished(low: tuple[float, float, float], high: tuple[float, float, float],
              voxels: int = 80_000) -> VoxelField:
    """Put a block between two corners, relative to the room's centre, into the room."""
    field = room_field(voxels)
    points = field.world_points().reshape(-1, 3) - CENTRE
    field.grid[((points > low) & (points < high)).all(1), 0] = 30
    field.update_occupancy()
    return field


def test_the_floor_of_an_empty_room_is_free_up_to_the_walls() -> None:
    field = room_field(80_000)
    field.update_occupancy()
    floor = find_free_floor(field, photos((0, 0), (1, 0.8), (-1, -0.8)), SamplingConfig())
    assert floor.camera_height == pytest.approx(CENTRE[2]) and floor.clearance == 0
    assert floor.area == pytest.approx(4 * WALLS[0] * WALLS[1], rel=0.15)
    offset = np.abs(floor.centres() - CENTRE[:2])
    assert (offset < WALLS[:2] + field.voxel).all()
    positions = PoseSampler.for_walkable(floor, SamplingConfig(robot_radius=0.4)).positions_xy
    assert (np.abs(positions - CENTRE[:2]) < WALLS[:2] - 0.2).all() and len(positions) > 300


def test_a_table_below_the_camera_is_in_the_way() -> None:
    # 0.6 m high on the floor; the camera is 1.1 m above it and looks over the table.
    field = furnished((0.2, -0.4, -1.2), (1.0, 0.4, -0.5))
    floor = find_free_floor(field, photos((-0.8, 0), (1.5, 0)), SamplingConfig())
    table = CENTRE[:2] + np.array([[0.6, 0.0], [0.4, 0.2], [0.8, -0.2]])
    assert not floor.contains(table).any()
    assert floor.contains(CENTRE[:2] + np.array([[-1.0, 1.0], [1.6, 0.0]])).all()


@pytest.mark.parametrize(('voxels', 'free'), [(12_000, True), (600_000, False)])
def test_what_lies_within_coarse_voxels_of_the_floor_is_the_floor(voxels: int, free: bool) -> None:
    # 0.25 m high, in voxels of 0.15 and 0.04 m.
    field = furnished((0.2, -0.4, -1.2), (1.0, 0.4, -0.85), voxels)
    floor = find_free_floor(field, photos((-0.8, 0), (1.5, 0)), SamplingConfig())
    assert floor.contains(CENTRE[:2] + np.array([[0.6, 0.0]])).all() == free


def test_what_no_photo_looked_into_is_not_free() -> None:
    # A wall from side to side; all photos are on its one side.
    field = furnished((0.4, -3, -3), (0.8, 3, 3))
    floor = find_free_floor(field, photos((-0.8, 0.5), (-1, -0.5)), SamplingConfig())
    assert (floor.centres()[:, 0] < CENTRE[0] + 0.5).all()
    both = find_free_floor(field, photos((-0.8, 0.5), (1.4, 0.0)), SamplingConfig())
    assert both.contains(CENTRE[:2] + np.array([[1.4, 0.8], [-1.0, 0.8]])).all()


@pytest.mark.slow
@pytest.mark.parametrize('robot_radius', [0.2, 0.5])
def test_photos_close_to_both_sides_of_a_wall_leave_it_standing(robot_radius: float) -> None:
    field = furnished((-0.06, -3, -3), (0.06, 3, 3), voxels=200_000)
    places = [(x, y) for x in (-0.15, 0.15) for y in np.arange(-1, 1.01, 0.1)]
    floor = find_free_floor(field, photos(*places), SamplingConfig(robot_radius=robot_radius))
    assert (np.abs(floor.centres()[:, 0] - CENTRE[0]) > 0.05).all()
    assert floor.contains(CENTRE[:2] + np.array(places)).all()


def test_around_a_photo_that_the_field_has_in_matter_it_does_not_count() -> None:
    field = furnished((0.3, -0.2, -0.2), (0.7, 0.2, 0.2))
    floor = find_free_floor(field, photos((0.5, 0), (-0.8, 0)), SamplingConfig())
    assert floor.contains(CENTRE[:2] + np.array([[0.5, 0], [0.5, 0.15], [-0.8, 0]])).all()


def test_rays_into_the_sky_take_no_memory_and_change_nothing(
        monkeypatch: pytest.MonkeyPatch) -> None:
    field = room_field(80_000)
    field.update_occupancy()
    places = photos((0, 0), (1, 0.8))
    floor = find_free_floor(field, places, SamplingConfig())

    def without_a_ceiling(of: VoxelField, origin: np.ndarray, rays: np.ndarray) -> Rendering:
        found = render_rays(of, origin, rays)
        return found._replace(depth=np.where(rays[..., 2] > 0.3, 300.0, found.depth))

    monkeypatch.setattr(free_space, 'render_rays', without_a_ceiling)
    tracemalloc.start()
    try:
        under_the_sky = find_free_floor(field, places, SamplingConfig())
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    np.testing.assert_array_equal(under_the_sky.cells, floor.cells)
    assert under_the_sky.origin == floor.origin
    # All steps of all rays took 300 MB.
    assert most < 60e6


def test_the_height_may_be_another() -> None:
    field = room_field(80_000)
    field.update_occupancy()
    config = SamplingConfig(camera_height=float(CENTRE[2]) + 0.3)
    assert find_free_floor(field, photos((0, 0)), config).camera_height == config.camera_height
