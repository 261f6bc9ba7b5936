"""Options of an import change the scene that comes of it."""
from dataclasses import replace
import math
from pathlib import Path

from camera_bags import CameraBag
from capture_files import (
    demo_photos, write_image, write_transforms_capture, write_turned_jpeg)
from neo_ros.captures import importing
from neo_ros.captures.capture import Capture
from neo_ros.captures.formats import CaptureFormat
from neo_ros.captures.importing import import_capture, ImportOptions
from neo_ros.captures.scene_writing import write_images
from neo_ros.errors import ConfigError, SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.progress import no_stage_progress
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest

STEP = 100_000_000
# 200 degrees from side to side.
CAMERA = Intrinsics(96, 72, 27.5, 27.5, 48.0, 36.0)


def write_drive(path: Path, **info: object) -> Path:
    images = np.random.default_rng(0).integers(0, 256, (4, 72, 96, 3), np.uint8)
    with CameraBag(path) as bag:
        for index, image in enumerate(images):
            stamp_ns = (index + 1) * STEP
            bag.tf('/tf', stamp_ns, 'map', 'optical', CameraPose.from_planar(
                0.2 * index, 0.1, 1.0, 0.2 * index).T_world_cam)
            bag.info('/camera_info', stamp_ns, CAMERA, **info)
            bag.image('/image_raw', stamp_ns, image)
    return path


def imported(bag: Path, scene: Path, options: ImportOptions) -> Intrinsics:
    import_capture(bag, scene, CaptureFormat.BAG, options, no_stage_progress)
    return read_scene(scene).train.intrinsics


# The second as drivers of tracking cameras send it.
@pytest.mark.parametrize('d', [[0.01, 0.0, 0.0, 0.0], [0.01, 0.0, 0.0, 0.0, 0.0]])
@pytest.mark.parametrize('asked', [None, 80.0, 150.0])
def test_a_fisheye_becomes_a_pinhole_view_as_wide_as_asked(
        tmp_path: Path, d: list[float], asked: float | None) -> None:
    bag = write_drive(tmp_path / 'bag', distortion_model='equidistant', d=np.array(d))
    view = imported(bag, tmp_path / 'scene', ImportOptions(fisheye_view=asked))
    assert math.degrees(view.hfov) == pytest.approx(asked or 120, abs=0.1)


def test_a_fisheye_view_of_another_camera_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match='fisheye-view: expected a fisheye'):
        imported(write_drive(tmp_path / 'bag'), tmp_path / 'scene', ImportOptions(
            fisheye_view=90))


@pytest.mark.parametrize('degrees', [0.0, 180.0, math.nan])
def test_a_fisheye_view_that_cannot_be_is_refused(degrees: float) -> None:
    with pytest.raises(ConfigError, match='fisheye-view: expected 3 to 170 degrees'):
        ImportOptions(fisheye_view=degrees)


def write_walk(folder: Path, orientation: int = 1) -> dict[Path, bytes]:
    for index, image in enumerate(demo_photos(3).images):
        write_turned_jpeg(folder / f'{index}.jpg', image, orientation)
    return {path: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize('source, orientation', [
    ('scene/images', 1), ('link', 1), ('linked', 1), ('linked', 6)],
    ids=['images', 'a link to it', 'links to its photos', 'turned ones'])
@pytest.mark.parametrize('own', ['transforms_train.json', 'import.json'])
def test_the_photos_of_a_data_set_are_never_replaced_by_its_scene(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, orientation: int, own: str
        ) -> None:
    scene = tmp_path / 'scene'
    before = write_walk(scene / 'images', orientation)
    (scene / own).write_text('{}')
    (tmp_path / 'link').symlink_to(scene / 'images')
    (tmp_path / 'linked').mkdir()
    for path in before:
        (tmp_path / 'linked' / path.name).symlink_to(path)

    def placed(capture: Capture, work: Path, *_: object) -> tuple[Capture, str]:
        names, pinhole = write_images(capture, work)  # As structure from motion copies them.
        return replace(capture, stream=None, frames=tuple(
            replace(frame, pose=pose, lens=Lens(pinhole), file=work / str(name))
            for frame, pose, name in zip(capture.frames, demo_photos(3).poses, names))), ''

    monkeypatch.setattr(importing, 'reconstruct', placed)
    with pytest.raises(SceneError, match='expected another folder than the source: the import '
                       'writes to .*scene/images and would replace .*; choose another scene'):
        import_capture(tmp_path / source, scene, CaptureFormat.PHOTOS, ImportOptions(),
                       no_stage_progress)
    assert {path: path.read_bytes() for path in (scene / 'images').iterdir()} == before
    assert not (scene / 'sfm').exists()


def test_listed_photos_among_those_of_the_scene_are_refused(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 'hall/poses', demo_photos(3))
    (source / 'images').rename(tmp_path / 'hall/images')
    (source / 'images').symlink_to(tmp_path / 'hall/images')
    with pytest.raises(SceneError, match='hall: expected another folder .*images/0.png; choose'):
        import_capture(source, tmp_path / 'hall', CaptureFormat.TRANSFORMS, ImportOptions(),
                       no_stage_progress)
    import_capture(source, tmp_path / 'scene', CaptureFormat.TRANSFORMS, ImportOptions(),
                   no_stage_progress)
    assert len(read_scene(tmp_path / 'scene').train) == 3


def test_an_import_shows_how_many_photos_it_has_read(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for index, image in enumerate(demo_photos(3).images):
        write_image(tmp_path / f'photos/{index}.png', image)

    def refused(capture: Capture, *arguments: object) -> None:
        raise SceneError('no poses')

    monkeypatch.setattr(importing, 'reconstruct', refused)
    shown: list[tuple[str, int, int]] = []
    with pytest.raises(SceneError, match='no poses'):
        import_capture(tmp_path, tmp_path / 'scene', CaptureFormat.PHOTOS, ImportOptions(),
                       lambda stage, done, total, note='': shown.append((stage, done, total)))
    assert shown == [('photo files', done, 3) for done in (1, 2, 3)]
