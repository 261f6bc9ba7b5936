"""Keyframes by Ray: the same bytes as here, also where a worker is killed or time is short."""
from dataclasses import replace
from pathlib import Path
from typing import Any

from neo_ros.baking.keyframes import BakingRules, MemoryConfig, Photos
from neo_ros.baking.memory_baking import bake_memory
from neo_ros.baking.worker_files import SharedScene
from neo_ros.errors import NeoError
from neo_ros.field.radiance_field import RadianceField
from neo_ros.machine import ray_jobs
from neo_ros.machine.progress import no_stage_progress, StageProgress
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.pictures.usable import write_usable
from neo_ros.pipeline import fit_field_step
from neo_ros.scenes.scene import read_scene
from neo_ros.training.memory import memory_step
from neo_ros.training.run import TrainingRun
from neo_ros.training.views import make_sampler
import numpy as np
import pytest
from tiny_training import TINY
from worker_killing import first_worker_killed

pytestmark = pytest.mark.slow

CONFIG = MemoryConfig(distance=2.0)
RULES = BakingRules(least_keyframes=2)


@pytest.fixture(scope='module')
def run(flat_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> TrainingRun:
    """Return a run of which the field alone is there."""
    run = TrainingRun(read_scene(flat_scene), TINY, tmp_path_factory.mktemp('run'),
                      no_stage_progress)
    fit_field_step(run)
    return run


def bake(run: TrainingRun, work: Path, on_ray: bool, seconds: float = float('inf'),
         progress: StageProgress = no_stage_progress) -> SceneMemory:
    field: RadianceField = fit_field_step(run)
    photos = Photos(run.fitted.read_images(), run.fitted.intrinsics, run.fitted.T_world_cam)
    scene = SharedScene.unpack(run.out / 'field.npz', run.fitted, 1.0, work) if on_ray else None
    return bake_memory(field, photos, run.expansion, make_sampler(run, field), CONFIG, 0, work,
                       progress, RULES, seconds, scene)


@pytest.fixture(scope='module')
def here(run: TrainingRun, tmp_path_factory: pytest.TempPathFactory) -> SceneMemory:
    return bake(run, tmp_path_factory.mktemp('here'), False)


def test_ray_makes_the_same_memory_also_where_a_worker_dies(
        run: TrainingRun, here: SceneMemory, tmp_path: Path, ray: Any) -> None:
    count = len(here.positions)
    assert count > 2
    said: list[tuple[int, int]] = []
    with first_worker_killed('make_keyframe') as killed:
        there = bake(run, tmp_path / 'work', True, progress=lambda stage, done, total, note='':
                     said.append((done, total)) if stage == 'keyframes' else None)
    assert len(killed) == 1
    assert said == [(done, count) for done in range(1, count + 1)]
    assert there.write(tmp_path / 'there') == here.write(tmp_path / 'here')


def test_parts_of_before_a_break_are_not_made_again(
        run: TrainingRun, here: SceneMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
        ) -> None:
    asked = list[tuple[str, int]]()
    dies = {'make_depth', 'make_keyframe'}  # each the first time

    def in_turn(function, jobs):  # type: ignore[no-untyped-def]
        """Stand in for Ray: one after the other, and the third cannot be made."""
        name = function.__name__
        asked.append((name, len(jobs)))
        for place, job in enumerate(jobs):
            if name in dies and place == 2:
                dies.remove(name)
                yield place, NeoError('its worker died')
            yield place, function(job)

    monkeypatch.setattr(ray_jobs, 'map_on_ray', in_turn)
    for what in ('depth_000032.npz: depth of photos was', '000002.npz: the keyframe was'):
        with pytest.raises(NeoError, match=f'{what} not made: its worker died'):
            bake(run, tmp_path / 'work', True)
    there = bake(run, tmp_path / 'work', True)
    photos = [(name, count) for name, count in asked if name != 'make_keyframe']
    assert photos == [('make_depth', 4), ('make_depth', 2), ('make_planes', 4)]
    count = len(here.positions)
    assert asked[len(photos):] == [('make_keyframe', count), ('make_keyframe', count - 2)]
    assert there.write(tmp_path / 'there') == here.write(tmp_path / 'here')


def test_what_workers_need_and_cannot_be_kept_says_why(run: TrainingRun, tmp_path: Path) -> None:
    (tmp_path / 'work').write_text('')
    with pytest.raises(NeoError, match='images.npy: cannot keep the work: .* make room'):
        bake(run, tmp_path / 'work', True)


@pytest.mark.parametrize('masked', [False, True])
def test_photos_in_files_are_those_in_memory_and_are_not_read_at_once(
        masked: bool, run: TrainingRun, tmp_path: Path) -> None:
    photos = run.fitted.subset(range(5))
    if masked:
        usable = np.ones((photos.intrinsics.height, photos.intrinsics.width), bool)
        usable[:9] = False
        write_usable(tmp_path / 'mask.png', usable)
        photos = replace(photos, mask_paths=(None, None, tmp_path / 'mask.png', None, None))
    scene = SharedScene.unpack(Path('field.npz'), photos, 0.5, tmp_path / 'work')
    found = scene.read_photos()
    assert isinstance(found.images.base, np.memmap) and found.images.flags.writeable
    np.testing.assert_array_equal(found.images, photos.read_images(0.5))
    wanted = photos.read_all_usable(0.5)
    assert (found.usable is None) == (wanted is None) == (not masked)
    if masked:
        np.testing.assert_array_equal(found.usable, wanted)
    assert found.intrinsics == photos.intrinsics.scaled(0.5)
    found.images[:] = 0  # It changes no file.
    assert scene.read_photos().images.any()
    # A run that goes on takes them as they are; of another size they are written anew.
    written = scene.images.stat().st_mtime_ns
    SharedScene.unpack(Path('field.npz'), photos, 0.5, tmp_path / 'work')
    assert scene.images.stat().st_mtime_ns == written
    SharedScene.unpack(Path('field.npz'), photos, 0.25, tmp_path / 'work')
    assert scene.images.stat().st_mtime_ns != written


def test_a_run_on_a_cluster_hands_its_keyframes_over(
        run: TrainingRun, monkeypatch: pytest.MonkeyPatch) -> None:
    field, asked = fit_field_step(run), []
    memory_step(run, field)
    here = run.memory_path.read_bytes()

    def in_turn(function, jobs):  # type: ignore[no-untyped-def]
        asked.extend(jobs)
        return ((place, function(job)) for place, job in enumerate(jobs))

    monkeypatch.setattr(ray_jobs, 'map_on_ray', in_turn)
    run.memory_path.unlink()
    monkeypatch.setattr(run, 'cluster', True)
    memory_step(run, field)
    assert run.memory_path.read_bytes() == here and len(asked) > 2
    assert not asked[0].out.parent.exists()  # What was made on the way is deleted.


def test_in_short_time_fewer_are_made(
        run: TrainingRun, here: SceneMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
        ) -> None:
    monkeypatch.setattr(ray_jobs, 'map_on_ray', lambda function, jobs: (
        (place, function(job)) for place, job in enumerate(jobs)))
    few = bake(run, tmp_path / 'work', True, seconds=0.001)
    assert len(few.positions) == 2
    assert (few.keyframe(1).texture == here.keyframe(1).texture).all()
    assert len(bake(run, tmp_path / 'work', True, seconds=600).positions) == len(here.positions)
