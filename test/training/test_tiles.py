"""A field is fitted tile by tile, goes on where it broke off, and is the same on a cluster."""
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
from neo_ros.errors import NeoError
from neo_ros.experiment import Experiment
from neo_ros.field.rendering import render_view
from neo_ros.field.tiles import cut_floor, joined
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.machine import ray_jobs
from neo_ros.machine.progress import no_stage_progress
from neo_ros.pictures.depth import to_millimetres, write_depth
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import read_scene, Scene
from neo_ros.training import checkpoint
from neo_ros.training.tiles import (
    below_floors, fit_tile, fit_tiles, tile_jobs, TileJob, tiles_of)
from neo_ros.training.time_plan import plan_training
import numpy as np
import pytest
from tiny_training import TINY
from worker_killing import first_worker_killed

pytestmark = pytest.mark.slow

# Three tiles of the small flat.
TILED = replace(TINY, field=replace(TINY.field, tile=3.5, steps=200))


@pytest.fixture(scope='module')
def scene(flat_scene: Path) -> Scene:
    return read_scene(flat_scene)


def jobs_in(out: Path, scene: Scene, experiment: Experiment = TILED) -> list[TileJob]:
    return tile_jobs(out, tiles_of(scene, experiment), scene.train, experiment,
                     experiment.field_config(True))


@pytest.fixture(scope='module')
def whole(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of tiles that were fitted one after the other."""
    out = tmp_path_factory.mktemp('tiles')
    fit_tiles(jobs_in(out, scene), False, no_stage_progress)
    return out


def test_only_large_floors_are_cut(scene: Scene) -> None:
    assert len(tiles_of(scene, TINY)) == 1
    assert len(tiles_of(scene, TILED)) == 3
    hand_held = replace(scene, walkable=None)
    assert len(tiles_of(hand_held, TINY)) == 1 and len(tiles_of(hand_held, TILED)) == 3


def test_a_hand_that_holds_the_camera_at_two_heights_makes_no_tiles(scene: Scene) -> None:
    poses = tuple(CameraPose.from_planar(np.cos(angle), np.sin(angle), z, angle + np.pi)
                  for z in (1.0, 2.6) for angle in np.linspace(0, 2 * np.pi, 60, endpoint=False))
    orbits = replace(scene, walkable=None, train=PosedImages(
        scene.train.intrinsics, (Path('none.png'),) * 120, poses, (0,) * 120))
    assert len(tiles_of(orbits, TINY)) == 1
    # With a floor map they are two storeys.
    assert len(tiles_of(replace(orbits, walkable=scene.walkable), TINY)) == 2


def test_a_storey_begins_below_its_floor_wherever_the_camera_is(tmp_path: Path) -> None:
    camera = Intrinsics.from_hfov(32, 32, np.pi / 2)
    down = camera.pixel_rays()[..., 1]  # The camera is level.
    for height in (0.4, 1.5):
        poses, paths = list[CameraPose](), list[Path | None]()
        for floor in (0.0, 3.2):
            depth = np.where(down > 0, height / np.maximum(down, 1e-6), 2.0)
            depth[:, :8] = np.minimum(depth[:, :8], 1.5)  # A wall.
            path = tmp_path / f'{height}_{floor}.png'
            write_depth(path, to_millimetres(np.where(depth < 9, depth, 0)))
            poses += [CameraPose.from_planar(x, y, floor + height, x + y)
                      for x in range(16) for y in range(3)]
            paths += [path] * 48
        photos = PosedImages(camera, (Path('none.png'),) * 96, tuple(poses), (0,) * 96,
                             depth_paths=tuple(paths))
        tiles = cut_floor(photos.T_world_cam[:, :3, 3], 6.0)
        moved = below_floors(tiles, photos, 1.0)
        assert len(moved) == len(tiles) > 4
        upper = np.array([tile.low[2] > 0 for tile in tiles])
        assert [tile.low[2] if up else tile.high[2] for tile, up in zip(moved, upper)] == (
            pytest.approx([3.05] * len(tiles), abs=0.02))
        assert [(tile.low[:2], tile.high[:2]) for tile in moved] == [
            (tile.low[:2], tile.high[:2]) for tile in tiles]
        # Where nothing tells, the border stays.
        assert below_floors(tiles, replace(photos, depth_paths=()), 1.0) == tiles


def test_tiles_make_one_field(scene: Scene, whole: Path) -> None:
    said: list[tuple[str, int, int]] = []
    field, seconds, log = fit_tiles(
        jobs_in(whole, scene), False, lambda stage, done, total, note='': said.append(
            (stage, done, total)))
    assert field is not None and seconds > 0
    # A tile's log begins where the one before it ended.
    times = [row[1] for row in log]
    assert times == sorted(times) and times[-1] <= seconds
    assert [stage for stage, _, _ in said] == ['joining tiles']  # All had been fitted.
    assert {round(VoxelField.load(job.out).voxel, 9) for job in jobs_in(whole, scene)} == {
        round(field.voxel, 9)}
    # From each photo all of the room is there, on whichever side of the border.
    photos = scene.train
    camera = photos.intrinsics
    errors = [np.abs(render_view(field, camera, photos.poses[index]).image
                     - photos.read_image(index) / 255).mean() for index in range(0, 60, 6)]
    assert np.mean(errors) < 0.12


def test_a_tile_that_was_broken_off_goes_on_to_the_same_bits(
        scene: Scene, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, 'CHECKPOINT_SECONDS', 0.0)
    job = jobs_in(tmp_path, scene)[1]
    job.out.parent.mkdir()

    def interrupt(stage: str, done: int, total: int, note: str = '') -> None:
        if done == 100:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_tile(job, interrupt)
    assert job.out.with_suffix('.ckpt').exists() and not job.out.exists()
    seen: list[int] = []
    fit_tile(job, lambda stage, done, total, note='': seen.append(done))
    assert seen[0] > 80
    assert job.out.read_bytes() == jobs_in(whole, scene)[1].out.read_bytes()
    assert not job.out.with_suffix('.ckpt').exists()


def test_a_cluster_fits_the_same_bits(scene: Scene, whole: Path, tmp_path: Path, ray: Any) -> None:
    said: list[tuple[str, int, int]] = []
    fit_tiles(jobs_in(tmp_path, scene), True,
              lambda stage, done, total, note='': said.append((stage, done, total)))
    assert said == [*(('tiles', done, 3) for done in range(4)), ('joining tiles', 0, 1)]
    for one, other in zip(jobs_in(tmp_path, scene), jobs_in(whole, scene)):
        assert one.out.read_bytes() == other.out.read_bytes()


def test_a_killed_workers_tile_is_done_again(
        scene: Scene, whole: Path, tmp_path: Path, ray: Any) -> None:
    said: list[tuple[str, int]] = []
    with first_worker_killed('fit_tile') as killed:
        fit_tiles(jobs_in(tmp_path, scene), True,
                  lambda stage, done, total, note='': said.append((stage, done)))
    assert len(killed) == 1
    assert said == [*(('tiles', done) for done in range(4)), ('joining tiles', 0)]
    for one, other in zip(jobs_in(tmp_path, scene), jobs_in(whole, scene)):
        assert one.out.read_bytes() == other.out.read_bytes()


def test_a_tile_that_cannot_be_fitted_is_named(
        scene: Scene, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = jobs_in(tmp_path, scene)
    jobs[0].out.parent.mkdir(parents=True)
    found = [(0, None), (1, NeoError('its worker died'))]

    def first_alone(function, left):  # type: ignore[no-untyped-def]
        jobs[0].out.touch()
        return iter(found)

    monkeypatch.setattr(ray_jobs, 'map_on_ray', first_alone)
    with pytest.raises(NeoError, match=r'0001.npz: the tile was not fitted: its worker died'):
        fit_tiles(jobs, True, no_stage_progress)


def test_minutes_are_shared_by_tiles(scene: Scene, tmp_path: Path) -> None:
    said: list[str] = []
    plan = plan_training(tmp_path, scene, TILED, 10.0, said.append)
    assert plan.experiment.field.minutes == pytest.approx(10 * 0.45 / 3)
    assert '3 tiles' in said[0]


def test_a_room_that_was_exposed_less_is_not_as_much_darker(
        scene: Scene, tmp_path: Path) -> None:
    experiment = replace(TILED, field=replace(TILED.field, exposure=True))
    tiles, photos = tiles_of(scene, experiment), scene.train
    last = tiles[-1].holds(photos.T_world_cam[:, :3, 3])
    paths = []
    for index, path in enumerate(photos.image_paths):
        image = photos.read_image(index) * (0.6 if last[index] else 1.0)
        paths.append(tmp_path / path.name)
        cv2.imwrite(str(paths[-1]), image.astype(np.uint8)[..., ::-1])
    dark = replace(scene, train=replace(photos, image_paths=tuple(paths)))
    jobs = jobs_in(tmp_path / 'out', dark, experiment)
    field, *_ = fit_tiles(jobs, False, no_stage_progress)
    assert field is not None

    def brightness_of_last(one: VoxelField) -> float:
        shown = [render_view(one, photos.intrinsics, pose).image.mean() for pose in photos.poses]
        shares = shown / photos.read_images().mean((1, 2, 3)) * 255
        return float(np.median(shares[last]) / np.median(shares[~last]))

    # The few photos that tiles share here tell half of it.
    as_fitted = brightness_of_last(joined(tiles, [job.out for job in jobs]))
    assert as_fitted < 0.72 and brightness_of_last(field) > 0.5 * (1 + as_fitted) - 0.06
