"""A training within so many minutes: what is chosen for a camera and a machine, and kept."""
from dataclasses import replace
from functools import partial
from pathlib import Path

from neo_ros import pipeline
from neo_ros.errors import ConfigError
from neo_ros.experiment import Experiment
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.pipeline import train
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
from neo_ros.training import time_plan
from neo_ros.training.time_plan import (
    most_memory_seconds, PLAN_FILE, plan_training, PlanRules, read_plan, settings_of,
    share_network_minutes, TimeLeft, TimePlan)
import numpy as np
import pytest
from tiny_training import TINY

# Pixels that a fit takes a second in its first seconds: two cores of a robot's computer.
RATE = 150_000.0


def scene_of(width: int, height: int, photos: int,
             expansion: ViewExpansion | None = None) -> Scene:
    camera = Intrinsics.from_hfov(width, height, np.radians(69))
    images = PosedImages(camera, tuple(Path(f'{i}.png') for i in range(photos)),
                         (CameraPose(np.eye(4)),) * photos, (0,) * photos)
    return Scene('room', images, None, expansion, None)


def planned(tmp_path: Path, scene: Scene, minutes: float, rate: float,
            monkeypatch: pytest.MonkeyPatch, base: Experiment = Experiment()) -> Experiment:
    monkeypatch.setattr(time_plan, '_fitting_rate', lambda *of: rate)
    out = tmp_path / f'{minutes}_{rate}_{scene.train.intrinsics.width}'
    out.mkdir()
    return plan_training(out, scene, base, minutes, lambda text: None).experiment


@pytest.mark.parametrize('size', [(128, 128), (256, 256), (640, 480), (1280, 720), (1920, 1080)])
def test_any_camera_gets_a_field_and_a_network_that_the_minutes_allow(
        size: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(*size, 1000)
    experiment = planned(tmp_path, scene, 30, RATE, monkeypatch)
    assert experiment.memory is not None
    minutes = [part.minutes or 0 for part in (
        experiment.field, experiment.memory, experiment.outpaint)]
    fitted = RATE / PlanRules().slower * 60 * minutes[0]
    shown = 1000 * size[0] * size[1] / experiment.field.shrink ** 2
    assert shown < 2.5 * fitted or experiment.field.shrink == 8
    view = experiment.expansion(scene.train.intrinsics, None)
    assert max(view.source.width, view.source.height) <= 160 * experiment.network.shrink
    assert view.source.width > 0.9 * size[0]
    assert min(minutes) > 0 and sum(minutes) < 30


@pytest.mark.parametrize('spent_minutes, left_minutes', [(4.5, 3.5), (6.4, 1.6), (9.0, 1.0)])
def test_what_came_before_the_field_is_the_memorys_too(
        spent_minutes: float, left_minutes: float) -> None:
    plan = TimePlan(10, TINY)
    assert most_memory_seconds(plan, 60 * spent_minutes) == pytest.approx(60 * left_minutes)


def test_steps_that_compile_do_not_count_in_how_fast_the_machine_is(
        monkeypatch: pytest.MonkeyPatch) -> None:
    class Trainer:
        seconds, step = 0.0, 0

        def train_step(self) -> None:
            self.step += 1
            self.seconds += 1.5 if self.step in (1, 5) else 0.1

    photos = scene_of(64, 64, 3).train
    monkeypatch.setattr(PosedImages, 'read_images', lambda *of: np.zeros((3, 64, 64, 3), np.uint8))
    monkeypatch.setattr(time_plan, 'field_trainer', lambda *of: Trainer())
    rate = time_plan._fitting_rate(photos, Experiment(), PlanRules())
    assert rate == pytest.approx(Experiment().field.rays_per_step / 0.1)


def test_more_minutes_and_faster_machines_see_finer(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(640, 480, 1000)
    short, usual, fast = (planned(tmp_path, scene, minutes, rate, monkeypatch).field
                          for minutes, rate in ((5, RATE), (30, RATE), (30, 20 * RATE)))
    assert short.shrink > usual.shrink > fast.shrink == 1
    assert short.voxels < usual.voxels <= fast.voxels


def test_what_a_user_has_set_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = Experiment()
    base = replace(base, seed=7, memory=None, field=replace(
        base.field, shrink=2, sh_degree=1, voxels=7_000_000),
        network=replace(base.network, shrink=8))
    found = planned(tmp_path, scene_of(640, 480, 1000), 30, RATE, monkeypatch, base)
    assert (found.seed, found.memory, found.field.shrink, found.field.sh_degree,
            found.field.voxels, found.network.shrink) == (7, None, 2, 1, 7_000_000, 8)


def test_a_stated_view_is_shrunk_by_what_divides_it(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(640, 480, 100)
    view = ViewExpansion.to_size(scene.train.intrinsics, 960, 480)
    found = planned(tmp_path, replace(scene, expansion=view), 30, RATE, monkeypatch)
    assert found.network.shrink == 4
    odd = ViewExpansion.to_size(scene.train.intrinsics.middle(630, 470), 950, 470)
    found = planned(tmp_path, replace(scene_of(641, 480, 100), expansion=odd), 30, RATE,
                    monkeypatch)
    assert found.network.shrink == 5


def test_a_plan_is_kept_and_others_are_refused(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(640, 480, 100)
    told: list[str] = []
    monkeypatch.setattr(time_plan, '_fitting_rate', lambda *of: RATE)
    first = plan_training(tmp_path, scene, Experiment(), 30, told.append)
    assert '30 minutes: a field of' in told[0] and 'minutes' in told[0].split('. ')[1]
    monkeypatch.setattr(time_plan, '_fitting_rate', lambda *of: 10 * RATE)
    assert plan_training(tmp_path, scene, Experiment(), 30, told.append) == first
    assert len(told) == 1
    with pytest.raises(ConfigError, match='a run of these settings, got one of others'):
        plan_training(tmp_path, scene, Experiment(seed=1), 30, told.append)
    for given in (None, Experiment()):
        assert settings_of(tmp_path, given) == first.experiment
    with pytest.raises(ConfigError, match='--config: .* run of 30 minutes, .*; leave it out'):
        settings_of(tmp_path, Experiment(seed=1))
    with pytest.raises(ConfigError, match='holds a run of 30 minutes, got 20'):
        plan_training(tmp_path, scene, Experiment(), 20, told.append)
    # What is left for the network is what it was when it came to it.
    assert share_network_minutes(tmp_path, 600) == pytest.approx(17)
    assert share_network_minutes(tmp_path, 900) == pytest.approx(17)
    (tmp_path / PLAN_FILE).write_text('{')
    with pytest.raises(ConfigError, match='expected the plan of an earlier run'):
        read_plan(tmp_path)


def test_a_late_network_still_gets_some_minutes(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_plan, '_fitting_rate', lambda *of: RATE)
    plan_training(tmp_path, scene_of(64, 48, 100), Experiment(), 10, lambda text: None)
    assert share_network_minutes(tmp_path, 3600) == pytest.approx(1)


def test_what_comes_last_does_not_grow_with_the_training(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_plan, '_fitting_rate', lambda *of: RATE)
    plan_training(tmp_path, scene_of(64, 48, 100), Experiment(), 90, lambda text: None)
    assert share_network_minutes(tmp_path, 2700) == pytest.approx(42)
    assert minutes_left(90, (0, 'outpainter', 0, 600), (600, 'outpainter', 600, 600)) == [13, 3]


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'run.json').write_text('{}')
    with pytest.raises(ConfigError, match='or a run without --minutes'):
        plan_training(tmp_path, scene_of(64, 48, 10), Experiment(), 30, lambda text: None)
    with pytest.raises(ConfigError, match='--minutes: expected a number > 0, got 0'):
        plan_training(tmp_path, scene_of(64, 48, 10), Experiment(), 0, lambda text: None)


def minutes_left(minutes: float, *reports: tuple[float, str, int, int]) -> list[int]:
    """Return what is told of a plan's minutes by reports: second, stage, done, total."""
    now, shown = [0.0], list[int]()

    def show(stage: str, done: int, total: int, note: str = '') -> None:
        assert note.startswith('note; ') and note.endswith(f' of {minutes} min left in all')
        shown.append(int(note.split()[1]))

    tell = TimeLeft(TimePlan(minutes, Experiment()), show, clock=lambda: now[0])
    for now[0], stage, done, total in reports:
        tell(stage, done, total, 'note')
    return shown


def test_the_minutes_left_in_all_are_told_at_every_stage() -> None:
    assert minutes_left(
        30, (0, 'photos', 1, 9), (0, 'field', 405, 810), (0, 'features', 1, 400),
        (300, 'keyframes', 10, 20), (300, 'outpainter', 0, 600), (300, 'outpainter', 600, 600),
        (300, 'scoring', 0, 10)) == [30, 23, 16, 12, 13, 3, 3]


def test_scores_and_report_take_as_long_as_they_do_and_not_what_the_plan_leaves_them() -> None:
    assert minutes_left(
        30, (0, 'scoring', 0, 10), (300, 'scoring', 5, 10), (300, 'scoring', 10, 10),
        (300, 'report', 1, 10), (420, 'report', 7, 10))[1:] == [11, 3, 3, 1]


def test_points_before_the_field_take_the_networks_time_and_nothing_of_the_memorys() -> None:
    assert minutes_left(
        30, (0, 'features', 1, 9), (240, 'stereo', 9, 9), (240, 'photos', 0, 9),
        (240, 'field', 0, 810), (1080, 'field', 810, 810), (1080, 'keyframes', 1, 9),
        (1170, 'keyframes', 9, 9)) == [30, 26, 26, 26, 12, 12, 11]
    assert minutes_left(30, (0, 'field', 0, 810), (900, 'features', 9, 9)) == [30, 16]


def test_points_that_take_longer_than_the_network_has_leave_it_its_least() -> None:
    assert minutes_left(10, (0, 'stereo', 0, 9), (3600, 'stereo', 9, 9),
                        (3600, 'field', 81, 81)) == [10, 6, 2]


def test_tiles_are_the_field_and_where_a_geometry_is_given_none_is_fitted() -> None:
    assert minutes_left(30, (0, 'tiles', 2, 4), (0, 'joining tiles', 0, 1),
                        (0, 'keyframes', 0, 9)) == [23, 16, 16]
    assert minutes_left(30, (0, 'geometry', 0, 1), (0, 'features', 1, 9),
                        (0, 'keyframes', 0, 9)) == [30, 30, 30]


def test_keyframes_that_take_longer_than_planned_are_told_of() -> None:
    # One takes 27 s, which leaves 45 minutes for 100; then no more are made, for want of time.
    assert minutes_left(6, (0, 'keyframes', 1, 111), (270, 'keyframes', 11, 111),
                        (270, 'keyframes', 11, 12)) == [3, 46, 2]


@pytest.mark.slow
def test_a_training_by_the_minute_leaves_a_whole_model_and_is_not_done_twice(
        flat_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, 'plan_training', partial(plan_training, rules=PlanRules(
        measured_seconds=0.5, measured_voxels=20_000, voxels=((0, 20_000),))))
    seen: list[str] = []

    def note(stage: str, done: int, total: int, note: str = '') -> None:
        seen.append(stage)

    run = train(flat_scene, TINY, tmp_path / 'out', note, minutes=0.08)
    assert run.plan is not None and run.plan.experiment.field.minutes == pytest.approx(0.036)
    model = FovExtrapolator.load(run.model_path)
    assert model.card.memory is not None
    content = run.model_path.read_bytes(), run.memory_path.read_bytes()
    order = list(dict.fromkeys(seen))
    assert order.index('plan') < order.index('field') < order.index('keyframes') \
        < order.index('outpainter')
    again = train(flat_scene, TINY, tmp_path / 'out', note, minutes=0.08)
    assert again.samples == run.samples
    assert again.memory_path.read_bytes() == content[1]
