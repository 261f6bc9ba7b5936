"""The out-of-scene score against other scenes and spoilt images, on the tiny model."""
import json
from pathlib import Path
import sys
from typing import Any

from box_room import box_walk, EXPANSION, view, write_box_model
import cv2
from neo_ros.benchmark import changed_scene, out_of_scene
from neo_ros.benchmark.out_of_scene import markdown, score_scenes, spoils
from neo_ros.errors import ModelError, SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.transforms_json import read_transforms, write_transforms
import numpy as np
import pytest
from scene_files import write_picture
from tiny_model import TINY_EXPANSION, write_tiny_model

pytestmark = pytest.mark.slow

# Wider than the tiny model's view in one direction, narrower in the other.
OTHER_CAMERA = Intrinsics.from_hfov(80, 48, 1.8)


def write_one_photo(folder: Path) -> None:
    """Write what makes a folder a scene: a training list, here of one black photo."""
    path = folder / 'photo.png'
    write_picture(path, np.zeros((48, 80, 3), np.uint8))
    write_transforms(folder / 'transforms_train.json', PosedImages(
        OTHER_CAMERA, (path,), (CameraPose(np.eye(4)),), (0,)))


@pytest.fixture(scope='module')
def noise_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a scene that has test frames of coloured noise, on two walks."""
    folder = tmp_path_factory.mktemp('scenes') / 'noise'
    paths = [folder / f'{index}.png' for index in range(4)]
    for index, path in enumerate(paths):
        write_picture(path, np.random.default_rng(index).integers(0, 256, (48, 80, 3), np.uint8))
    images = PosedImages(OTHER_CAMERA, tuple(paths), (CameraPose(np.eye(4)),) * 4, (0, 0, 1, 1))
    write_transforms(folder / 'transforms_test.json', images)
    write_one_photo(folder)
    return folder


def test_what_is_not_the_scene_scores_higher(
        tiny_run: Any, noise_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    scene = tiny_run.out.parent / 'scene'
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'argv', ['', str(tiny_run.model_path), str(scene),
                                      str(noise_scene)])
    out_of_scene.main()
    found = json.loads((tmp_path / 'results/out_of_scene.json').read_text())
    assert found['scene'] == 'scene' and {'commit', 'host', 'model'} < found.keys()
    rows = {row['frames']: row for row in found['rows']}
    assert list(rows) == ['scene, its test frames', 'noise', *spoils()]
    own = rows.pop('scene, its test frames')
    assert own['count'] == 6 and own['auroc'] == own['network_auroc'] == 0.5
    for name in ('noise', 'lens cap', 'a tenth of the light'):
        assert rows[name]['known'] == 0
        assert rows[name]['network_auroc'] > 0.9 and rows[name]['auroc'] > 0.9
        # Nothing is known, so the memory changes nothing.
        assert rows[name]['score'] == rows[name]['network_score'] > own['network_score']
    assert rows['noise']['count'] == 4
    assert rows['harmless: JPEG at quality 80']['network_auroc'] < 0.8
    table = capsys.readouterr().out.splitlines()
    assert len(table) == 2 + len(found['rows'])
    assert table[3].startswith('| noise | 4 | 0.0% | ')


def test_a_guided_frame_scores_nothing_and_a_walk_begins_anew(
        tiny_run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room, poses = tmp_path / 'room', tuple(box_walk(6))
    paths = tuple(room / f'{step}.png' for step in range(len(poses)))
    for path, pose in zip(paths, poses):
        write_picture(path, view(pose, EXPANSION.target)[0])
    write_transforms(room / 'transforms_test.json', PosedImages(
        EXPANSION.target, paths, poses, (0,) * 3 + (1,) * 3))
    write_one_photo(room)
    # The reference is of another scene, so the network alone finds the room unusual.
    path = write_box_model(tmp_path, scene_reference=FovExtrapolator.load(
        tiny_run.model_path).card.scene_reference)
    resets = []
    reset = FovExtrapolator.reset

    def noted(extrapolator: FovExtrapolator) -> None:
        resets.append(extrapolator)
        reset(extrapolator)

    monkeypatch.setattr(out_of_scene, 'spoils', dict)
    models = [FovExtrapolator.load(path, guided=guided) for guided in (False, True)]
    monkeypatch.setattr(FovExtrapolator, 'load', lambda path, guided=True: models[guided])
    monkeypatch.setattr(FovExtrapolator, 'reset', noted)
    row, = score_scenes(path, room, [])
    assert [resets.count(model) for model in models] == [2, 2]  # Two walks.
    assert row.known == 1 and row.score == 0 < row.network_score


def test_a_model_without_a_memory_has_the_networks_scores_alone(
        tiny_run: Any, noise_scene: Path, tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(out_of_scene, 'spoils', dict)
    card = FovExtrapolator.load(tiny_run.model_path).card
    path = write_tiny_model(tmp_path / 'plain.onnx', card.expansion,
                            scene_reference=card.scene_reference)
    rows = score_scenes(path, tiny_run.out.parent / 'scene', [noise_scene])
    assert [row.known for row in rows] == [None, None]
    assert markdown(rows).splitlines()[2].startswith('| scene, its test frames | 6 |  |  |  | 0.')


def test_what_is_missing_is_said(tiny_run: Any, noise_scene: Path, tmp_path: Path) -> None:
    plain = write_tiny_model(tmp_path / 'plain.onnx', TINY_EXPANSION)
    with pytest.raises(ModelError, match='nothing of how the scene looks'):
        score_scenes(plain, noise_scene, [])
    untested = tmp_path / 'untested'
    write_one_photo(untested)
    with pytest.raises(SceneError, match='expected test frames'):
        score_scenes(tiny_run.model_path, tiny_run.out.parent / 'scene', [untested])


@pytest.mark.parametrize('module, arguments', [
    (out_of_scene, 'MODEL.onnx SCENE [OTHER...]'), (changed_scene, 'MODEL.onnx')])
def test_the_programs_say_what_they_want(
        module: Any, arguments: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('sys.argv', ['program'])
    with pytest.raises(SystemExit, match='usage') as ended:
        module.main()
    assert ended.value.code == f'usage: python -m {module.__name__} {arguments}'


@pytest.mark.parametrize('camera, window', [
    (Intrinsics(32, 32, 16, 16, 16, 16), (slice(0, 48), slice(16, 64))),
    (Intrinsics(40, 20, 64, 64, 20, 10), (slice(14, 34), slice(20, 60))),
], ids=['as large as it gets', 'the same field of view'])
def test_other_photos_are_cut_to_the_cameras_view(
        noise_scene: Path, camera: Intrinsics, window: tuple[slice, slice]) -> None:
    images = read_transforms(noise_scene / 'transforms_test.json')
    images = PosedImages(Intrinsics(80, 48, 64, 64, 40, 24), *(
        getattr(images, name) for name in ('image_paths', 'poses', 'path_ids')))
    walks = out_of_scene.seen_by(camera, images)
    assert [len(walk) for walk in walks] == [2, 2]
    expected = cv2.resize(images.read_image(2)[window], (camera.width, camera.height),
                          interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(walks[1][0], expected)


def test_images_are_spoilt_as_their_names_say() -> None:
    image = np.random.default_rng(0).integers(60, 160, (32, 48, 3), np.uint8)
    spoilt = {name: spoil(image) for name, spoil in spoils().items()}
    for name, changed in spoilt.items():
        assert changed.shape == image.shape and changed.dtype == np.uint8, name
        assert (changed != image).any(), name
    assert not spoilt['lens cap'].any()
    np.testing.assert_array_equal(spoilt['a tenth of the light'], np.rint(image * 0.1))
    np.testing.assert_array_equal(spoilt['harmless: a fifth more light'], np.rint(image * 1.2))
    half = spoilt['half of the lens covered']
    assert not half[:, :24].any()
    np.testing.assert_array_equal(half[:, 24:], image[:, 24:])
    finger = spoilt['finger over the lens']
    assert (finger[..., 0] > 2 * finger[..., 1]).all() and finger.max() < 100
    noise = spoilt['harmless: noise of 3 grey levels'].astype(float) - image
    assert noise.std() == pytest.approx(3, abs=0.3)
    assert spoilt['motion blur of 7 pixels'].std() < 0.6 * image.std()
