import math
from pathlib import Path
import subprocess
import sys
from unittest.mock import Mock

import cv2
from neo_ros.errors import NeoError, SceneError
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
from neo_ros.outpaint import panorama_pool
from neo_ros.outpaint.panorama_cache import PanoramaCache
from neo_ros.outpaint.panorama_pool import PanoramaPool
from neo_ros.pictures.sharpness import relative_sharpness
from neo_ros.reports.plan_view import FLOOR
from neo_ros.reports.report import Picture, Table
from neo_ros.scenes.pose_sampling import PoseSampler, SamplingConfig
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.walkable import WalkableMap
from neo_ros.training.pose_map import draw_poses, pose_sections, write_poses
import numpy as np
from plain_field import CENTRE, room_field, standing, WALLS
import pytest
from scene_files import write_picture

VIEW = Intrinsics.from_hfov(32, 32, 1.6)
LEVEL = ((0.0, 0.0), (0.0, 0.0))


@pytest.fixture(scope='module')
def field() -> VoxelField:
    """Make a room with fine stripes on the walls of its left half, and none in the right."""
    result = room_field(150_000)
    points = result.world_points().reshape(-1, 3) - CENTRE
    stripes = np.where(np.floor(points.sum(1) / 0.25) % 2 > 0, 4.0, -4.0)
    result.grid[:, 1:] = np.where(points[:, 1] > 0, stripes, 0.2 * points[:, 0])[:, None]
    result.update_occupancy()
    inside = np.abs(result.world_points() - CENTRE) < WALLS + 3 * result.voxel
    result.seen = inside.all(-1).astype(np.uint8).ravel()
    return result


def pool(field: VoxelField, *offsets: tuple[float, float], positions: int = 6,
         height: float = float(CENTRE[2]), cache: PanoramaCache | None = None) -> PanoramaPool:
    sampler = PoseSampler(CENTRE[:2] + np.array(offsets or [(0.0, 0.0), (0.5, 0.3)]),
                          (-math.pi, 2 * math.pi), LEVEL, (height, 0.0), 8)
    return PanoramaPool(field, sampler, VIEW, positions, seed=0, cache=cache)


def on_disk(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())


def photos(field: VoxelField, folder: Path) -> PosedImages:
    """Photograph the stripes, sharper than the field shows them."""
    poses = tuple(standing(0.1 * k, 0.0, 1.2 + 0.1 * k) for k in range(8))
    paths = tuple(folder / f'{k}.png' for k in range(8))
    for path, pose in zip(paths, poses):
        shown = to_uint8(render_view(field, VIEW, pose).image)
        write_picture(path, cv2.addWeighted(shown, 1.5, cv2.GaussianBlur(shown, (0, 0), 1),
                                            -0.5, 0))
    return PosedImages(VIEW, paths, poses, (0,) * 8)


def test_positions_are_refused_by_reason(field: VoxelField) -> None:
    mixed = pool(field, (0, 0), (float(WALLS[0]) + 0.25, 0.0))
    assert mixed.fill(6) == 6
    assert set(mixed.refused) == {'in matter'}
    assert len(mixed.refused_positions) == mixed.refused['in matter'] > 0
    assert mixed.fill(100) == 6 and len(mixed.panoramas) == 6


def test_who_waits_for_several_panoramas_is_told_how_many_are_there(
        field: VoxelField) -> None:
    watched, told = pool(field), Mock()
    watched.progress = told
    watched.fill(3)
    assert [call.args for call in told.call_args_list] == [(1, 3), (2, 3), (3, 3)]
    watched.fill(4)  # One at a time is part of a step.
    assert told.call_count == 3


def test_places_where_nothing_is_are_refused() -> None:
    air = VoxelField.empty(4000, CENTRE, WALLS, 0.2, 0)
    air.grid[:, 0] = -8
    air.grid[0, 0] = 40
    air.update_occupancy()
    nowhere = pool(air)
    with pytest.raises(SceneError, match='in a row show nothing to learn from .nothing there.'):
        nowhere.fill(1)


def test_a_cache_gives_the_same_panoramas_without_rendering_them_again(
        field: VoxelField, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    places = (0, 0), (float(WALLS[0]) + 0.25, 0.0)
    plain, kept = pool(field, *places), pool(field, *places, cache=PanoramaCache(tmp_path, 1e9))
    for filled in (plain, kept):
        filled.fill(6)
    # A kill leaves a partial file, and a damaged one may be there: both are made again.
    (tmp_path / '000006.npy.partial').write_bytes(b'half')
    (tmp_path / '000002.npy').unlink()  # the panorama that is in use stays whole
    (tmp_path / '000002.npy').write_bytes(b'damaged')
    (tmp_path / '000003.npy').unlink()
    (tmp_path / '000003.npy').write_bytes(b'')  # as a power cut leaves it
    (tmp_path / '000004.json').write_text('{}')
    rendered = Mock(side_effect=panorama_pool.render_panorama)
    monkeypatch.setattr(panorama_pool, 'render_panorama', rendered)
    again = pool(field, *places, cache=PanoramaCache(tmp_path, 1e9))
    again.fill(6)
    assert 1 <= rendered.call_count < 6 + kept.refused.total()
    assert not list(tmp_path.glob('*.partial'))
    for others in (kept, again):
        assert others.refused == plain.refused and plain.refused.total() > 0
        assert np.array_equal(others.refused_positions, plain.refused_positions)
        for one, other in zip(plain.panoramas, others.panoramas, strict=True):
            assert np.array_equal(one.image, other.image)
            assert np.array_equal(one.position, other.position)
            assert (one.opacity, one.blocked) == (other.opacity, other.blocked)
        assert np.array_equal(plain.draw_view(3, np.random.default_rng(1)),
                              others.draw_view(3, np.random.default_rng(1)))


def test_a_cache_keeps_to_its_limit_and_the_rest_stays_in_memory(
        field: VoxelField, tmp_path: Path) -> None:
    one = pool(field)
    one.fill(1)
    limit = 2.5 * one.panoramas[0].image.nbytes
    kept = pool(field, cache=PanoramaCache(tmp_path, limit))
    assert kept.fill(6) == 6
    assert len(list(tmp_path.glob('*.npy'))) == 2
    assert on_disk(tmp_path) < limit
    # Also what an earlier run left counts, and what is above a smaller limit goes.
    assert PanoramaCache(tmp_path, limit).used == on_disk(tmp_path) > 0.7 * limit
    assert PanoramaCache(tmp_path, limit / 2).used == on_disk(tmp_path) < limit / 2
    assert [path.name for path in tmp_path.glob('*.npy')] == ['000000.npy']


def test_a_cache_counts_headers_and_notes_and_each_file_once(
        field: VoxelField, tmp_path: Path) -> None:
    pool(field, cache=PanoramaCache(tmp_path, 1e9)).fill(3)
    whole = on_disk(tmp_path)
    (tmp_path / '000001.npy').write_bytes(b'damaged')
    for limit, kept in ((whole, 3), (whole - 1, 2)):
        cache = PanoramaCache(tmp_path, limit)
        pool(field, cache=cache).fill(3)
        assert cache.used == on_disk(tmp_path) <= limit
        assert len(list(tmp_path.glob('*.npy'))) == kept


MANY = """
import resource, sys
from pathlib import Path
from neo_ros.errors import NeoError
from neo_ros.field.panorama import Panorama
from neo_ros.geometry import Band
from neo_ros.outpaint.panorama_cache import DrawnPanorama, PanoramaCache
import numpy as np

resource.setrlimit(resource.RLIMIT_NOFILE, (64, int(sys.argv[2])))
cache, band = PanoramaCache(Path(sys.argv[1]), 1e9), Band(0.5, -0.5)
drawn = DrawnPanorama(Panorama(np.zeros(3), np.zeros((4, 8, 4), np.uint8), band), [])
try:
    kept = [cache.write(index, drawn) for index in range(100)]
    assert all(isinstance(one.panorama.image, np.memmap) for one in kept)
    kept += [cache.read(index, band, (4, 8)) for index in range(100)]
    assert None not in kept
except NeoError as error:
    print(error)
"""


@pytest.mark.parametrize('most, told', [(400, ''), (64, 'Too many open files; raise the limit')],
                         ids=['soft limit', 'hard limit'])
def test_a_cache_holds_more_panoramas_than_files_may_be_open(
        tmp_path: Path, most: int, told: str) -> None:
    done = subprocess.run([sys.executable, '-c', MANY, str(tmp_path), str(most)],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert told in done.stdout and bool(told) == bool(done.stdout)


def test_a_cache_of_other_views_is_made_anew(field: VoxelField, tmp_path: Path) -> None:
    one = pool(field, cache=PanoramaCache(tmp_path, 1e9))
    one.fill(1)
    larger = PanoramaPool(field, one.sampler, Intrinsics.from_hfov(48, 48, 1.6), 6, seed=0,
                          cache=PanoramaCache(tmp_path, 1e9))
    larger.fill(1)
    assert larger.panoramas[0].image.shape[0] > one.panoramas[0].image.shape[0]


def test_a_full_disk_is_named(field: VoxelField, tmp_path: Path,
                              monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: object) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(np, 'save', full)
    with pytest.raises(NeoError, match='No space left on device; make room'):
        pool(field, cache=PanoramaCache(tmp_path, 1e9)).fill(1)


@pytest.mark.slow
def test_photos_of_one_wall_tell_that_nothing_is_behind_them(tmp_path: Path) -> None:
    wall = room_field(150_000)
    points = wall.world_points().reshape(-1, 3) - CENTRE
    wall.grid[points[:, 1] < 0.6 * WALLS[1], 0] = -12.0
    wall.update_occupancy()
    drawn = pool(wall)
    with pytest.raises(SceneError, match='nothing there'):
        drawn.fill(1)
    drawn = pool(wall)
    drawn.measure_photos(photos(wall, tmp_path), 1.0, sharp_only=False)
    assert drawn.least_sharpness == 0
    assert drawn.fill(3) == 3 and not drawn.refused


@pytest.mark.slow
def test_blurred_views_are_drawn_again(field: VoxelField, tmp_path: Path) -> None:
    sharp, plain = pool(field), pool(field)
    sharp.measure_photos(photos(field, tmp_path), 1.0)
    assert sharp.least_sharpness > 0
    random = np.random.default_rng(0)
    for drawn in (sharp, plain):
        drawn.fill(6)
    views = [sharp.draw_view(0, random) for _ in range(30)]
    assert min(relative_sharpness(view[..., :3].numpy())
               for view in views) >= sharp.least_sharpness
    assert sharp.summary()['refused_views']['blurred'] > 30
    assert plain.summary()['refused_views'] == {}


def test_a_place_where_every_view_is_blurred_is_drawn_again(
        field: VoxelField, tmp_path: Path) -> None:
    """Who looks towards the smooth half sees stripes from the striped half alone."""
    smooth, striped = CENTRE[:2] - [0, 1], CENTRE[:2] + [0, 1]
    sampler = PoseSampler(np.array([smooth, striped]), (-2.5, 1.6), LEVEL,
                          (float(CENTRE[2]), 0.0), 8)
    anywhere = pool(field)
    anywhere.measure_photos(photos(field, tmp_path), 1.0)
    drawn = PanoramaPool(field, sampler, VIEW, 6, seed=0)
    drawn.least_sharpness = anywhere.least_sharpness
    drawn.fill(6)
    assert {tuple(panorama.position[:2]) for panorama in drawn.panoramas} == {tuple(striped)}
    assert set(drawn.refused) == {'blurred'}


def test_the_threshold_allows_for_a_soft_field(field: VoxelField, tmp_path: Path) -> None:
    """Photos that are sharper than what the field shows do not make all its views blurred."""
    room = pool(field)
    room.measure_photos(photos(field, tmp_path), 1.0)
    room.fill(6)
    views = [room.panoramas[0].cut_view(VIEW, standing(yaw=yaw).T_world_cam[:3, :3])
             for yaw in np.arange(0, 4.5, 0.5)]
    sharp = [relative_sharpness(view[..., :3]) > room.least_sharpness for view in views]
    assert np.mean(sharp) > 0.8


def test_counts_and_map_come_back_from_the_folder(
        field: VoxelField, tmp_path: Path) -> None:
    assert pose_sections(tmp_path) == []
    room = pool(field, (0, 0), (float(WALLS[0]) + 0.25, 0.0))
    room.fill(6)
    summary = room.summary()
    assert summary == room.summary()
    assert summary['positions'] + sum(summary['refused_positions'].values()) == (
        summary['drawn_positions'])
    used = np.stack([panorama.position for panorama in room.panoramas])
    refused = np.stack(room.refused_positions)
    picture = draw_poses(room.sampler, used, refused, photos(field, tmp_path))
    write_poses(tmp_path, summary, picture)
    table, shown = pose_sections(tmp_path)
    assert isinstance(table, Table) and isinstance(shown, Picture)
    rows = {str(name): value for name, value in table.rows}
    assert rows['Positions used'] == '6' and rows['Headings at each'] == '8'
    assert rows['- refused: in matter'] == str(len(refused))
    np.testing.assert_array_equal(shown.image, picture)
    # Used positions are green, refused ones red.
    colours = {tuple(colour) for colour in picture.reshape(-1, 3)}
    assert (20, 130, 80) in colours and (200, 40, 40) in colours


def test_the_map_shows_the_floor_that_the_positions_lie_on(
        field: VoxelField, tmp_path: Path) -> None:
    floor = WalkableMap(0.1, (CENTRE[0] - 1, CENTRE[1] - 1), np.ones((20, 20), bool), 1.2,
                        clearance=0.0)
    sampler = PoseSampler.for_walkable(floor, SamplingConfig(robot_radius=0.5))
    picture = draw_poses(sampler, np.empty((0, 3)), np.empty((0, 3)), photos(field, tmp_path))
    shaded, grid = ((picture == colour).all(-1).sum() for colour in (FLOOR, (221, 230, 240)))
    # A metre of two is as far from the floor's edge as the robot's radius.
    assert shaded > 2 * grid > 0


def test_a_broken_note_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / 'poses.json').write_text('[]')
    with pytest.raises(SceneError, match='poses.json: expected the counts .* delete it'):
        pose_sections(tmp_path)
