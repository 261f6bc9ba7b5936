"""Poses for photos without poses; skipped where pycolmap is not installed."""
from collections.abc import Callable
from dataclasses import replace
import math
from pathlib import Path
import shutil
from types import SimpleNamespace
from typing import Any

from capture_files import write_image
from neo_ros.captures.capture import Capture
from neo_ros.captures.masks import find_masks
from neo_ros.captures.photos import read_photos
from neo_ros.captures.scene_writing import write_capture
from neo_ros.captures.sfm_stages import is_plausible, photo_pairs
from neo_ros.captures.structure_from_motion import reconstruct
from neo_ros.errors import SceneError
from neo_ros.flat.scene_writing import render_demo_views
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_vector
from neo_ros.geometry.lens import Lens
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest

pytestmark = pytest.mark.slow

CAMERA = Intrinsics.from_hfov(240, 180, math.radians(75))
COUNT = 15


def needs_pycolmap() -> None:
    pytest.importorskip('pycolmap', reason='needs pycolmap (the train extra)')


def arc(count: int) -> list[CameraPose]:
    """Walk sideways through the living room and turn a little."""
    return [CameraPose.from_planar(2.2 + 0.09 * i, 1.1 + 0.01 * i * i / 2, 1.5, 1.2 + 0.03 * i)
            for i in range(count)]


def test_photos_get_the_poses_they_were_taken_from(tmp_path: Path) -> None:
    needs_pycolmap()
    poses = arc(COUNT)
    for index, image in enumerate(render_demo_views(CAMERA, poses, workers=1)):
        write_image(tmp_path / f'photos/{index}.png', image)

    def interrupt(stage: str, done: int, total: int, note: str = '') -> None:
        if stage == 'matches':
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(read_photos(tmp_path / 'photos'), tmp_path / 'sfm', interrupt)
    assert (tmp_path / 'sfm/database.db').is_file()
    stages: dict[str, tuple[int, int]] = {}
    capture, verdict = reconstruct(  # goes on
        read_photos(tmp_path / 'photos'), tmp_path / 'sfm',
        lambda stage, done, total, note='': stages.__setitem__(stage, (done, total)))
    assert stages == {'images': (COUNT, COUNT), 'features': (COUNT, COUNT),
                      'matches': (COUNT * (COUNT - 1) // 2,) * 2, 'poses': (COUNT, COUNT)}
    assert (verdict.registered, verdict.photos) == (COUNT, COUNT)
    assert 0 < verdict.reprojection_error < 1
    assert 'arbitrary, not metres' in str(verdict)
    check_poses(capture.frames, poses)
    write_capture(capture, tmp_path / 'scene')
    found = read_scene(tmp_path / 'scene').train
    assert found.intrinsics.hfov == pytest.approx(CAMERA.hfov, rel=0.1)  # self-calibrated
    # Again: the model is there, nothing is computed.
    stages.clear()
    again, verdict_again = reconstruct(
        read_photos(tmp_path / 'photos'), tmp_path / 'sfm',
        lambda stage, done, total, note='': stages.__setitem__(stage, (done, total)))
    assert stages.keys() == {'images'} and verdict_again == verdict
    np.testing.assert_array_equal(
        [frame.pose.T_world_cam for frame in again.frames if frame.pose is not None],
        [frame.pose.T_world_cam for frame in capture.frames if frame.pose is not None])


def test_a_disk_that_is_nearly_full_is_told_before_colmap_aborts(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs_pycolmap()
    photos = walk(tmp_path / 'photos', 6)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, 'disk_usage', lambda _: usage._replace(free=35_000_000))
    with pytest.raises(SceneError, match='sfm: expected 36 MB free on its disk, for the features '
                       'of 6 photos and their matches, got 35 MB; make room, and give the same'):
        reconstruct(photos, tmp_path / 'sfm')
    assert not (tmp_path / 'sfm/database.db').exists()
    monkeypatch.setattr(shutil, 'disk_usage', lambda _: usage._replace(free=36_000_000))
    assert reconstruct(photos, tmp_path / 'sfm')[1].photos == 6
    # What an interrupted run has written needs no room any more.
    shutil.rmtree(tmp_path / 'sfm/model')
    there = (tmp_path / 'sfm/database.db').stat().st_size
    monkeypatch.setattr(shutil, 'disk_usage', lambda _: usage._replace(free=36_000_000 - there))
    assert reconstruct(photos, tmp_path / 'sfm')[1].photos == 6


def test_a_calibration_is_held_fixed(tmp_path: Path) -> None:
    needs_pycolmap()
    poses = arc(6)
    for index, image in enumerate(render_demo_views(CAMERA, poses, workers=1)):
        # Blanks in names end them in COLMAP's list of pairs.
        write_image(tmp_path / f'photos/IMG 1 ({index}).png', image)
    photos = read_photos(tmp_path / 'photos')
    capture, verdict = reconstruct(replace(photos, frames=tuple(
        replace(frame, lens=Lens(CAMERA)) for frame in photos.frames)), tmp_path / 'sfm')
    assert verdict.registered == 6
    assert {frame.lens for frame in capture.frames} == {Lens(CAMERA)}
    check_poses(capture.frames, poses)


def check_poses(frames: object, poses: list[CameraPose]) -> None:
    """Compare up to a turn about z, a scale and a shift: nobody can know more than that."""
    assert isinstance(frames, tuple)
    found = [frame.pose for frame in frames]
    first, last = found[0], found[-1]
    for a, b, true_a, true_b in zip(found, found[1:], poses, poses[1:]):
        turn = rotation_vector(a.T_world_cam[:3, :3].T @ b.T_world_cam[:3, :3])
        truth = rotation_vector(true_a.T_world_cam[:3, :3].T @ true_b.T_world_cam[:3, :3])
        np.testing.assert_allclose(turn, truth, atol=math.radians(0.5))
    scale = np.linalg.norm(last.position - first.position) / np.linalg.norm(
        poses[-1].position - poses[0].position)
    steps = [np.linalg.norm(b.position - a.position) / scale for a, b in zip(found, found[1:])]
    truth_steps = [np.linalg.norm(b.position - a.position) for a, b in zip(poses, poses[1:])]
    np.testing.assert_allclose(steps, truth_steps, rtol=0.25)
    assert all(abs(pose.forward[2]) < math.sin(math.radians(3)) for pose in found)  # level


def walk(folder: Path, count: int) -> Capture:
    for index, image in enumerate(render_demo_views(CAMERA, arc(count), workers=1)):
        write_image(folder / f'{index}.png', image)
    return read_photos(folder)


def change_mapping(monkeypatch: pytest.MonkeyPatch,
                   *changes: Callable[[dict[int, Any]], object]) -> list[int]:
    """Change what each mapping in turn finds; returns a list with an entry for each mapping."""
    import pycolmap
    real = pycolmap.incremental_mapping
    done: list[int] = []

    def mapping(*arguments: Any, **options: Any) -> dict[int, Any]:
        models: dict[int, Any] = real(*arguments, **options)
        changes[len(done)](models)
        done.append(len(models))
        return models

    monkeypatch.setattr(pycolmap, 'incremental_mapping', mapping)
    return done


def camera_of(focal_length: float, k1: float) -> Callable[[dict[int, Any]], object]:
    def change(models: dict[int, Any]) -> None:
        for model in models.values():
            camera, = model.cameras.values()
            camera.params = [focal_length, 120, 90, k1]
    return change


def keep(models: dict[int, Any]) -> None:
    """Change nothing."""


@pytest.mark.parametrize('placed, focal_length, k1, usable', [
    (3, 262, -0.05, True), (3, 262, 0.0, True), (2, 262, -0.05, False), (9, 5002.8, 0.01, False),
    (9, 50, 0.01, False), (9, 1017.8, -3.92, False), (9, 262, -0.9, False), (9, 262, 1.1, False)],
    ids=['estimated', 'held', 'two photos', 'tele', 'wide', 'bent', 'no pinhole view', 'cushion'])
def test_what_counts_as_a_camera(placed: int, focal_length: float, k1: float,
                                 usable: bool) -> None:
    camera = SimpleNamespace(model=SimpleNamespace(name='SIMPLE_RADIAL'), width=320, height=240,
                             params=[focal_length, 160, 120, k1])
    assert usable == is_plausible(SimpleNamespace(
        num_reg_images=lambda: placed, cameras={1: camera}))


def test_a_camera_that_cannot_be_is_not_taken(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs_pycolmap()
    mappings = change_mapping(monkeypatch, camera_of(3800, 0.01), keep)
    capture, verdict = reconstruct(walk(tmp_path / 'photos', 6), tmp_path / 'sfm')
    assert verdict.registered == 6 and len(mappings) == 2
    lens, = {frame.lens for frame in capture.frames}
    assert lens is not None and lens.is_pinhole
    assert lens.intrinsics.fx == pytest.approx(1.2 * 240)  # held where COLMAP begins
    note = 'focal length could not be estimated and is taken to be 288 px (45 degrees across)'
    assert note in capture.notes[0]
    again, _ = reconstruct(read_photos(tmp_path / 'photos'), tmp_path / 'sfm')  # the kept model
    assert again.notes == capture.notes and len(mappings) == 2


def test_a_bad_model_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs_pycolmap()
    photos = walk(tmp_path / 'photos', 6)
    with monkeypatch.context() as broken:
        change_mapping(broken, camera_of(3800, 0.01), dict.clear)
        with pytest.raises(SceneError, match='camera and poses could not be estimated.* placed '
                           'none of the 6 photos.*moves sideways'):
            reconstruct(photos, tmp_path / 'sfm')
    assert not (tmp_path / 'sfm/model').exists()
    reconstruct(photos, tmp_path / 'sfm')
    # Nor is one that an earlier version kept.
    import pycolmap
    model = pycolmap.Reconstruction(tmp_path / 'sfm/model')
    camera_of(3800, 0.01)({0: model})
    model.write(tmp_path / 'sfm/model')
    capture, _ = reconstruct(photos, tmp_path / 'sfm')
    assert all(frame.lens is not None and frame.lens.intrinsics.fx < 400
               for frame in capture.frames)


@pytest.mark.parametrize('lost', [1, 2])
def test_photos_that_cannot_be_placed_are_named(tmp_path: Path, lost: int) -> None:
    needs_pycolmap()
    walk(tmp_path / 'photos', 6)
    for index in range(lost):
        write_image(tmp_path / f'photos/wall {index}.png', np.full((180, 240, 3), 128, np.uint8))
    capture, verdict = reconstruct(read_photos(tmp_path / 'photos'), tmp_path / 'sfm')
    assert (verdict.registered, verdict.photos) == (6, 6 + lost)
    names = ', '.join(f'wall {index}.png' for index in range(lost))
    assert f'{lost} photos could not be placed and are left out: {names}' in capture.notes[0]
    assert ('Record more' in capture.notes[0]) == (lost == 2)  # of fewer than 80 %


def test_a_mapping_that_begins_anew_is_shown_once(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs_pycolmap()
    import pycolmap

    def mapping(*arguments: Any, initial_image_pair_callback: Callable[[], None],
                next_image_callback: Callable[[], None], **options: Any) -> dict[int, Any]:
        for more in (2, 2, 1, 3):
            initial_image_pair_callback()
            for _ in range(more):
                next_image_callback()
        return {}

    monkeypatch.setattr(pycolmap, 'incremental_mapping', mapping)
    photos = walk(tmp_path / 'photos', 5)
    shown: list[int] = []
    with pytest.raises(SceneError, match='/sfm: the poses could not be estimated'):
        reconstruct(replace(photos, frames=tuple(
            replace(frame, lens=Lens(CAMERA)) for frame in photos.frames)), tmp_path / 'sfm',
            lambda stage, done, total, note='': shown.append(done) if stage == 'poses' else None)
    assert shown == [2, 3, 4, 5]


def test_photos_of_nothing_are_refused(
        tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    needs_pycolmap()
    for index in range(3):
        write_image(tmp_path / f'photos/{index}.png', np.full((60, 80, 3), 128, np.uint8))
    with pytest.raises(SceneError, match='placed none of the 3 photos.*texture'):
        reconstruct(read_photos(tmp_path / 'photos'), tmp_path / 'sfm')
    assert capfd.readouterr().err == ''  # pycolmap's own log says nothing more


@pytest.mark.parametrize('count', [2, 100, 101, 1000])
def test_photos_are_compared_with_their_neighbours_and_no_pair_twice(count: int) -> None:
    names = [f'{i:04d}' for i in range(count)]
    pairs = photo_pairs(names)
    assert len(pairs) == len(set(pairs)) == len({frozenset(pair) for pair in pairs})
    assert set(zip(names, names[1:])) <= set(pairs)
    assert len(pairs) <= max(count * (count - 1) // 2 if count <= 100 else 20 * count, 1) + 1770
    if count > 100:
        assert (names[0], names[-1]) in pairs  # a loop can close


def test_what_a_mask_leaves_out_has_no_features(tmp_path: Path) -> None:
    """A sticker on the lens is the same in every photo: it alone would say that nothing moves."""
    needs_pycolmap()
    import pycolmap
    poses = arc(9)
    sticker = np.random.default_rng(0).integers(0, 256, (60, 240, 3)).astype(np.uint8)
    usable = np.full((180, 240), 255, np.uint8)
    usable[120:] = 0
    for index, image in enumerate(render_demo_views(CAMERA, poses, workers=1)):
        image[120:] = sticker
        write_image(tmp_path / f'photos/images/{index}.png', image)
        if index != 2:
            write_image(tmp_path / f'photos/masks/{index}.png', usable)
    photos = find_masks(read_photos(tmp_path / 'photos'), tmp_path / 'photos')
    lens = Lens(CAMERA)
    photos = replace(photos, frames=tuple(replace(frame, lens=lens) for frame in photos.frames))
    _, verdict = reconstruct(photos, tmp_path / 'sfm')
    with pycolmap.Database.open(tmp_path / 'sfm/database.db') as database:
        lowest = {image.name: database.read_keypoints(image.image_id)[:, 1].max()
                  for image in database.read_all_images()}
    assert lowest.pop('images/2.png') > 170  # It has no mask.
    assert len(lowest) == 8 and max(lowest.values()) < 121
    assert verdict.registered >= 8
    # Another mask: features are looked for anew.
    write_image(tmp_path / 'photos/masks/0.png', np.full((180, 240), 255, np.uint8))
    reconstruct(photos, tmp_path / 'sfm')
    with pycolmap.Database.open(tmp_path / 'sfm/database.db') as database:
        first = next(image for image in database.read_all_images() if image.name == 'images/0.png')
        assert database.read_keypoints(first.image_id)[:, 1].max() > 170
