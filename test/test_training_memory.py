"""Landmarks of a training run's photos."""
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from box_room import apart
from corner_photos import CAMERA, EXPANSION, write_corner
from neo_ros.baking.landmarks import find_landmarks
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.experiment import Experiment
from neo_ros.memory.landmarks import Locator
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.training import memory as training_memory
import numpy as np
import pytest
from scene_files import write_picture


@pytest.fixture(scope='module')
def corner(tmp_path_factory: pytest.TempPathFactory) -> tuple[PosedImages, TruthFrames]:
    return write_corner(tmp_path_factory.mktemp('corner'))


def run_of(photos: PosedImages, out: Path) -> Any:
    """Return what `find_landmarks` reads of a run, and what it says in `said`."""
    said: list[str] = []
    return SimpleNamespace(
        fitted=photos, experiment=Experiment(), expansion=EXPANSION, out=out, said=said,
        progress=lambda stage, done, total, note: said.append(stage))


def test_the_photos_landmarks_find_the_camera(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    photos, frames = corner
    monkeypatch.setattr(training_memory, 'LANDMARK_PHOTOS', len(photos) - 1)
    run = run_of(photos, tmp_path)
    landmarks = find_landmarks(run)
    assert landmarks is not None and len(landmarks.points) > 30
    assert {'features', 'matches'} <= set(run.said)
    locator = Locator(landmarks, CAMERA)
    found = locator.locate(locator.features(frames.read(0)[0]))
    assert found is not None and apart(found.pose, frames.images.poses[0])[0] < 0.05


@pytest.mark.parametrize('patches', [True, False], ids=['patches', 'blank'])
def test_photos_without_texture_have_no_landmarks(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path, patches: bool) -> None:
    photos, _ = corner
    paths = tuple(tmp_path / f'{index}.png' for index in range(len(photos)))
    for index, path in enumerate(paths):
        image = np.full((96, 96, 3), 128, np.uint8)
        # A patch in each that is like no other photo's, or nothing at all.
        image[20:40, 20:40] = np.random.default_rng(index).integers(
            *((0, 256) if patches else (128, 129)), (20, 20, 3))
        write_picture(path, image)
    run = run_of(PosedImages(CAMERA, paths, photos.poses, photos.path_ids), tmp_path)
    assert find_landmarks(run) is None
    assert run.said[-1] == 'without landmarks'


def test_without_pycolmap_there_are_no_landmarks(
        corner: tuple[PosedImages, TruthFrames], tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_memory, 'find_spec', lambda name: None)
    run = run_of(corner[0], tmp_path)
    assert find_landmarks(run) is None
    assert run.said == ['without landmarks'] and not list(tmp_path.iterdir())
