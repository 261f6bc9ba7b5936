"""Pictures of every kind come through every kind of folder as they are."""
from collections.abc import Callable
from pathlib import Path

from capture_files import (
    demo_photos, write_colmap_text, write_scannet, write_trajectory, write_transforms_capture)
import cv2
from neo_ros.captures.formats import CaptureFormat, FOLDER_READERS
from neo_ros.captures.photos import read_photos
from neo_ros.captures.scene_writing import write_capture, write_images
from neo_ros.pictures.photo import PHOTO_SUFFIXES, read_photo
from neo_ros.scenes.scene import read_scene
import numpy as np
from phone_files import (
    write_camera_info, write_euroc, write_polycam, write_record3d, write_tum)
import pytest


def by_opencv(path: Path, image: np.ndarray) -> None:
    assert cv2.imwrite(str(path), image[..., ::-1], [
        cv2.IMWRITE_JPEG_QUALITY, 100, cv2.IMWRITE_WEBP_QUALITY, 101])


def of_16_bits(path: Path, image: np.ndarray) -> None:
    assert cv2.imwrite(str(path), image[..., ::-1].astype(np.uint16) * 257)


def with_alpha(path: Path, image: np.ndarray) -> None:
    assert cv2.imwrite(str(path), np.dstack([image[..., ::-1], np.full(image.shape[:2], 9, 'u1')]))


def as_grey(path: Path, image: np.ndarray) -> None:
    assert cv2.imwrite(str(path), image[..., 1])


def as_heic(path: Path, image: np.ndarray) -> None:
    pillow_heif = pytest.importorskip('pillow_heif', reason='needs pillow-heif (the heic extra)')
    pillow_heif.from_bytes('RGB', image.shape[1::-1], image.tobytes()).save(
        path, quality=100, chroma=444)


# Ending, how it is written, and how far off its pixels are in the mean.
KINDS: dict[str, tuple[str, Callable[[Path, np.ndarray], None], float]] = {
    'jpeg': ('.jpg', by_opencv, 4.5), 'jpeg, long': ('.jpeg', by_opencv, 4.5),
    'jpeg, capitals': ('.JPG', by_opencv, 4.5), 'png': ('.png', by_opencv, 0),
    'png of 16 bits': ('.png', of_16_bits, 0), 'png with alpha': ('.png', with_alpha, 0),
    'grey png': ('.png', as_grey, 0), 'bmp': ('.bmp', by_opencv, 0),
    'tiff': ('.tiff', by_opencv, 0), 'tif of 16 bits': ('.tif', of_16_bits, 0),
    'webp': ('.webp', by_opencv, 0), 'ppm': ('.ppm', by_opencv, 0), 'pgm': ('.pgm', as_grey, 0),
    'heic': ('.heic', as_heic, 3), 'heif, capitals': ('.HEIF', as_heic, 3)}
# ScanNet's and 7-Scenes' own tools write JPEG and PNG alone, and so does Record3D into a .r3d.
FOLDERS: dict[CaptureFormat, Callable[..., Path]] = {
    CaptureFormat.TRANSFORMS: write_transforms_capture, CaptureFormat.COLMAP: write_colmap_text,
    CaptureFormat.TUM: write_tum, CaptureFormat.EUROC: write_euroc,
    CaptureFormat.RECORD3D: write_record3d, CaptureFormat.POLYCAM: write_polycam,
    CaptureFormat.TRAJECTORY: write_trajectory, CaptureFormat.SCANNET: write_scannet}


def in_kind(folder: Path, suffix: str, write: Callable[[Path, np.ndarray], None]) -> None:
    """Write all pictures of a folder as another kind, also where files name them."""
    for path in [*folder.rglob('*.png')]:
        image = read_photo(path)
        assert image is not None
        if path.parent.name in ('depth', 'confidence') or path.stem.startswith('depth'):
            continue
        path.unlink()
        write(path.with_suffix(suffix), image)
    for path in (*folder.rglob('*.json'), *folder.rglob('*.txt'), *folder.rglob('*.csv')):
        path.write_text(path.read_text().replace('.png', suffix))


@pytest.mark.parametrize('suffix, write, off', KINDS.values(), ids=KINDS.keys())
def test_every_folder_takes_every_picture(
        tmp_path: Path, suffix: str, write: Callable[[Path, np.ndarray], None], off: float
        ) -> None:
    photos = demo_photos(3)
    expected = photos.images.astype(float)
    if write is as_grey:
        expected = expected[..., 1:2].repeat(3, -1)
    for format_, make in FOLDERS.items():
        source = make(tmp_path / format_.value, photos)
        in_kind(source, suffix, write)
        options = ({'camera_info': write_camera_info(tmp_path / 'camera.yaml')}
                   if format_ == CaptureFormat.TUM else {})
        notes = write_capture(FOLDER_READERS[format_](source, **options), tmp_path / 'scene')
        found = read_scene(tmp_path / 'scene').train
        assert len(found) == 3, (format_, notes)
        assert np.abs(found.read_images() - expected).mean() <= off, format_


@pytest.mark.parametrize('suffix, write, off', KINDS.values(), ids=KINDS.keys())
def test_photos_without_poses_may_be_of_every_kind(
        tmp_path: Path, suffix: str, write: Callable[[Path, np.ndarray], None], off: float
        ) -> None:
    image = demo_photos(1).images[0]
    write(tmp_path / f'one{suffix}', image)
    capture = read_photos(tmp_path)
    names, _ = write_images(capture, tmp_path / 'scene')
    found = read_photo(tmp_path / 'scene' / str(names[0]))
    expected = image[..., 1:2].repeat(3, -1) if write is as_grey else image
    assert found is not None and np.abs(found - expected.astype(float)).mean() <= off


def test_every_ending_has_its_test() -> None:
    assert {suffix.lower() for suffix, _, _ in KINDS.values()} == set(PHOTO_SUFFIXES)
