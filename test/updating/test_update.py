"""`neo update` from bag to folder: what has changed is changed, and nothing else."""
from pathlib import Path
from typing import Any

import cv2
from neo_ros.bags import write_demo_bag
from neo_ros.baking.keyframes import Photos
from neo_ros.benchmark.killing import digests
from neo_ros.benchmark.kills import ROOM
from neo_ros.benchmark.small_room import (
    AFTER, BEFORE, cast_with_post, drive, HALF, HEIGHT, look, WIDE, write_drive, write_room)
from neo_ros.cli.main import app
from neo_ros.errors import BagError, ConfigError, NeoError, SceneError
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.pipeline import train
from neo_ros.runtime import FovExtrapolator, read_model_card
from neo_ros.scenes.scene import read_scene
from neo_ros.training.checkpoint import read_checkpoint
from neo_ros.updating import refit as refit_module, update as update_module
from neo_ros.updating.update import update, UpdateOptions
import numpy as np
import pytest
from typer.testing import CliRunner
from worker_killing import first_worker_killed

# Its one fit is dear, and runs beside others.
pytestmark = [pytest.mark.slow, pytest.mark.torch, pytest.mark.timeout(900)]


@pytest.fixture(scope='module')
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the run of a room, bags of it, and the run that one updated."""
    folder = tmp_path_factory.mktemp('updating')
    write_room(folder / 'room')
    train(folder / 'room', ROOM, folder / 'run')
    write_drive(folder / 'same', BEFORE)
    write_drive(folder / 'moved', AFTER)
    before = digests(folder / 'run')
    found, = update(folder / 'run', [folder / 'moved'], folder / 'new', experiment=ROOM)
    assert found in range(1, 5)
    assert digests(folder / 'run') == before
    return folder


def memory_of(folder: Path) -> SceneMemory:
    named = read_model_card(folder / 'room.onnx').memory
    assert named is not None
    return SceneMemory.read(folder / named.file, named.sha256)


def errors(memory: SceneMemory) -> tuple[float, float]:
    """Return the mean error where something has changed, and elsewhere, of wide views."""
    renderer = MemoryRenderer(memory)
    off: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for pose in drive(12):
        x, y, z = pose.position
        pose = CameraPose.from_planar(x + 0.1, y + 0.1, z, pose.yaw + 0.2)
        truth, _, after = look(pose, WIDE.target, AFTER)
        before = look(pose, WIDE.target, BEFORE)[2]
        apart = np.abs(renderer.render(pose, WIDE.target).image - truth).mean(-1)
        for kept, pixels in zip(off, (after | before, ~(after | before))):
            kept.append(apart[pixels])
    changed, rest = (float(np.concatenate(one).mean()) for one in off)
    return changed, rest


def test_the_memory_shows_what_is_there_now(base: Path) -> None:
    (changed, rest), (changed_now, rest_now) = (
        errors(memory_of(base / name)) for name in ('run', 'new'))
    assert changed_now < 0.5 * changed and rest_now < rest + 2


def test_the_field_is_the_same_elsewhere(base: Path) -> None:
    old, new = (VoxelField.load(base / name / 'field.npz') for name in ('run', 'new'))
    both = (old.row_of >= 0) & (new.row_of >= 0)
    assert both.sum() == (old.row_of >= 0).sum()
    same = (old.grid[old.row_of[both]] == new.grid[new.row_of[both]]).all(1)
    points = old.world_points().reshape(-1, 3)[both]
    away = np.min([np.abs(points[:, :2] - place).max(1) for place in (BEFORE, AFTER)], axis=0)
    assert same[away > HALF + 0.5].mean() > 0.99 and 0.9 < same.mean() < 1


def test_keyframes_are_the_same_elsewhere(base: Path) -> None:
    old, new = memory_of(base / 'run'), memory_of(base / 'new')
    np.testing.assert_array_equal(old.glances.pictures, new.glances.pictures)
    touched, elsewhere = [], []
    for before, after in zip(old.each(), new.each()):
        other = before.depth != after.depth
        touched.append(other.mean())
        rays = old.band.rays(*other.shape)
        changed = np.any([cast_with_post(before.position, rays, post)[2]
                          for post in (BEFORE, AFTER)], axis=0)
        around = cv2.dilate(changed.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
        elsewhere.append(other[~around].mean())
        texture = np.abs(before.texture.astype(int) - after.texture)
        if not other.any() and not texture.any():
            continue
        # Compressed once more, but not drawn anew.
        finer = len(before.texture) // len(before.depth)
        near = cv2.dilate(other.astype(np.uint8), np.ones((41, 41), np.uint8)) > 0
        assert texture[~near.repeat(finer, 0).repeat(finer, 1)].mean() < 1.5
    assert 0 < max(touched) < 0.3 and np.mean(elsewhere) < 0.01


def test_landmarks_of_what_left_are_gone_and_those_of_what_came_are_there(base: Path) -> None:
    old, new = (memory_of(base / name).landmarks for name in ('run', 'new'))
    assert old is not None and new is not None

    def at(points: np.ndarray, post: tuple[float, float]) -> np.ndarray:
        return np.abs(points[:, :2] - post).max(1) < HALF + 0.1

    few, many = 10, 40  # What is on the floor below them stays.
    assert at(old.points, BEFORE).sum() > many and at(old.points, AFTER).sum() < few
    assert at(new.points, BEFORE).sum() < few and at(new.points, AFTER).sum() > many
    there = {point.tobytes() for point in new.points}
    away = old.points[np.abs(old.points[:, :2, None] - np.transpose([BEFORE, AFTER])).max(
        1).min(1) > HALF + 0.7]
    assert all(point.tobytes() in there for point in away)


def test_the_card_tells_where_it_comes_from(base: Path) -> None:
    before, after = (read_model_card(base / name / 'room.onnx') for name in ('run', 'new'))
    assert before.updates == () and after.memory != before.memory
    entry, = after.updates
    assert before.memory is not None and entry.memory == before.memory.sha256
    assert entry.bag == 'moved' and 10 < entry.photos <= 60
    report = (base / 'new' / 'report.html').read_text()
    assert all(words in report for words in (
        'how many say so', '<td>left</td>', '<td>came</td>'))
    assert not list((base / 'new').glob('*.journal'))


def test_new_photos_are_those_that_show_the_change_without_who_walked_by(
        base: Path, tmp_path: Path) -> None:
    poses, walked = drive(), (slice(2, 18), slice(2, 14))  # Away from what changed.
    poses += [CameraPose.from_planar(pose.position[0], pose.position[1], HEIGHT, pose.yaw + np.pi)
              for pose in poses[::3]]
    rows, columns = (part.start for part in WIDE.observed)
    frames = []
    for number, pose in enumerate(poses):
        image = look(pose, WIDE.target, AFTER)[0]
        if number % 6 == 0:
            image[rows:, columns:][walked] = (255, 0, 255)
        frames.append((10 ** 9 + number * 10 ** 8, image, pose))
    write_demo_bag(tmp_path / 'walked', frames, WIDE)
    update(base / 'run', [tmp_path / 'walked'], tmp_path / 'new', experiment=ROOM)
    old, new = (read_scene(folder).train for folder in (base / 'room', tmp_path / 'new' / 'room'))
    added = range(len(old), len(new))
    # Those that look away add nothing.
    assert 10 < len(added) <= read_model_card(tmp_path / 'new/room.onnx').updates[0].photos - 10
    shown = [new.read_shown(index) for index in added]
    pink = np.array([(image[walked] == (255, 0, 255)).all() for image, _ in shown])
    there, all_of_it = (np.array([usable[part].mean() for _, usable in shown])
                        for part in (walked, slice(None)))
    assert pink.sum() > 3 and there[pink].mean() < 0.4 and all_of_it[~pink].mean() > 0.9


def test_an_updated_run_can_be_updated_again(base: Path, tmp_path: Path) -> None:
    found, = update(base / 'new', [base / 'same'], tmp_path / 'back', experiment=ROOM,
                    options=UpdateOptions(minutes=0.2, network_minutes=0.1))
    assert found  # The post stands where it was first.
    updates = read_model_card(tmp_path / 'back' / 'room.onnx').updates
    before = read_model_card(base / 'new' / 'room.onnx').memory
    assert [one.bag for one in updates] == ['moved', 'same']
    assert before is not None and updates[1].memory == before.sha256
    # Its network was trained on, and is guided by the memory of now.
    networks = [read_checkpoint(base / name / 'outpainter.ckpt') for name in ('run', 'new')]
    networks.append(read_checkpoint(tmp_path / 'back' / 'outpainter.ckpt'))
    run, new, back = (one['trainer']['averaged'] for one in networks)
    for name, weights in run.items():
        assert new[name].equal(weights)
    moved = sum(float((back[name] - weights).norm()) for name, weights in run.items())
    assert 0 < moved < 0.5 * sum(float(weights.norm()) for weights in run.values())
    assert networks[2]['trainer']['seconds'] < 30
    after = read_model_card(tmp_path / 'back' / 'room.onnx')
    assert not after.scores  # They were of another memory.
    assert after.trained_seconds > read_model_card(base / 'new' / 'room.onnx').trained_seconds
    assert 'as it was once' in (tmp_path / 'back' / 'report.html').read_text()
    assert 'as it was once' not in (base / 'new' / 'report.html').read_text()
    # Where the post stood in between, voxels are those of the training again, bit by bit.
    fields = [VoxelField.load(folder / 'field.npz').with_air() for folder in (
        base / 'run', base / 'new', tmp_path / 'back')]
    points = fields[0].world_points()[..., :2].reshape(-1, 2)
    run, new, back = (field.grid for field in fields)
    changed = (run != new).any(1) & (np.abs(points - AFTER) < 0.35).all(1)
    assert changed.sum() > 500 and (run == back)[changed].all(1).mean() > 0.9
    assert memory_of(tmp_path / 'back') and FovExtrapolator.load(tmp_path / 'back' / 'room.onnx')


def test_ray_makes_the_same_memory_also_where_a_worker_dies(
        base: Path, tmp_path: Path, ray: Any) -> None:
    with first_worker_killed('make_change') as killed:
        update(base / 'run', [base / 'moved'], tmp_path / 'new', experiment=ROOM,
               options=UpdateOptions(cluster=True))
    assert len(killed) == 1
    here, there = (read_model_card(folder / 'room.onnx').memory
                   for folder in (base / 'new', tmp_path / 'new'))
    assert here is not None and here == there
    assert {path.name for path in (tmp_path / 'new').iterdir()} == {
        path.name for path in (base / 'new').iterdir()}


def test_where_nothing_changed_nothing_is_written(base: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, [
        'update', str(base / 'run'), str(base / 'same'), '--out', str(tmp_path / 'new'),
        '--config', str(experiment_file(tmp_path))])
    assert done.exit_code == 0 and 'nothing has changed' in done.output, done.output
    assert {path.name for path in tmp_path.iterdir()} == {'room.yaml'}


def experiment_file(folder: Path) -> Path:
    from dataclasses import asdict

    import yaml
    path = folder / 'room.yaml'
    settings = asdict(ROOM)
    settings['view'] = {name: list(size) for name, size in settings['view'].items()}
    path.write_text(yaml.safe_dump(settings))
    return path


def test_what_was_broken_off_begins_anew(base: Path, tmp_path: Path,
                                         monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*arguments: object, **more: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(update_module, 'find_changed_space', killed)
        patch.setattr(update_module.shutil, 'rmtree', lambda *_, **__: None)  # Nobody tidies up.
        with pytest.raises(KeyboardInterrupt):
            update(base / 'run', [base / 'moved'], tmp_path / 'new', experiment=ROOM)
    assert [path.name for path in tmp_path.iterdir()] == ['new.partial']
    assert update(base / 'run', [base / 'same'], tmp_path / 'new', experiment=ROOM) == [0]
    assert not list(tmp_path.iterdir())


def test_what_has_changed_is_fitted_to_photos_as_fine_as_the_field_was(
        base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is compared is coarser where photos are large: here half as wide as what is read."""
    refit, shown = refit_module.refit, list[Photos]()

    def finer(photos: Photos) -> Photos:
        assert photos.usable is not None
        images, usable = (one.repeat(2, 1).repeat(2, 2) for one in (photos.images, photos.usable))
        usable[:, :10] = False  # A mask.
        return Photos(images, photos.intrinsics.scaled(2), photos.T_world_cam, usable)

    def stop(photos: Photos, gains: np.ndarray, *_: object, **__: object) -> None:
        shown.append(photos)
        assert len(gains) == len(photos.images)
        raise KeyboardInterrupt

    monkeypatch.setattr(update_module, 'refit', lambda field, space, compared, read, *rest: refit(
        field, space, compared, lambda chosen: finer(read(chosen)), *rest))
    monkeypatch.setattr(refit_module, 'trainer_of', stop)
    with pytest.raises(KeyboardInterrupt):
        update(base / 'run', [base / 'moved'], tmp_path / 'new', experiment=ROOM)
    usable = shown[0].usable
    assert usable is not None and usable.shape == shown[0].images.shape[:3]
    assert usable.shape[1:] == (128, 128) and not usable[:, :10].any()
    # Of each pixel that may change, all four.
    assert usable.any() and (usable[:, 10::2, ::2] == usable[:, 11::2, 1::2]).all()


def test_what_cannot_be_updated_is_refused(base: Path, tmp_path: Path) -> None:
    noise = np.random.default_rng(0)
    write_demo_bag(tmp_path / 'other', (
        (10 ** 9 + n, noise.integers(0, 256, (128, 128, 3), np.uint8), drive()[0])
        for n in range(6)), WIDE)
    bags = [base / 'same']
    with pytest.raises(BagError, match='of 6 images none shows the scene of room'):
        update(base / 'run', [tmp_path / 'other'], tmp_path / 'new', experiment=ROOM)
    # The others are used nevertheless.
    assert update(base / 'run', [*bags, tmp_path / 'other'], tmp_path / 'new',
                  experiment=ROOM) == [0, None]
    with pytest.raises(ConfigError, match='does not exist yet'):
        update(base / 'run', bags, base / 'new', experiment=ROOM)
    with pytest.raises(ConfigError, match='other field .*--config'):
        update(base / 'run', bags, tmp_path / 'new')
    with pytest.raises(NeoError, match='run.json'):
        update(base / 'room', bags, tmp_path / 'new', scene=base / 'room')
    unfinished = tmp_path / 'unfinished'
    unfinished.mkdir()
    (unfinished / 'run.json').write_bytes((base / 'run' / 'run.json').read_bytes())
    with pytest.raises(SceneError, match='field.npz'):
        update(unfinished, bags, tmp_path / 'new', experiment=ROOM)
