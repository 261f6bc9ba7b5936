"""Photos without poses: a folder of image files of one size."""
from pathlib import Path
from typing import Iterator, Optional, Sequence

import cv2
from neo_ros.errors import SceneError
from neo_ros.scenes.capture import (
    Capture, CapturedFrame, list_photos, listed, origin_of, read_photo)
import numpy as np

PHOTO_FOLDERS = ('images', 'photos', 'rgb')


def find_photos(source: Path) -> list[Path]:
    """Return the image files of SOURCE, or of its folder images/, in natural order."""
    return next((found for folder in (source, *(source / name for name in PHOTO_FOLDERS))
                 if (found := list_photos(folder))), [])


def read_photos(source: Path) -> Capture:
    """
    List photos without poses and without calibration.

    Files that cannot be read are named in the notes and left out. Where a camera noted that it was
    turned (EXIF), the photos are shown upright: their up becomes the world's. Raises SceneError
    for a folder without a readable image, and for photos of several sizes.
    """
    files = find_photos(source)
    if not files:
        raise SceneError(f'{source}: expected photos, there are none')
    turned = sum(map(_is_turned, files))
    sizes: dict[Path, tuple[int, int]] = {}
    for file in files:
        photo = read_photo(file, upright=turned > 0)
        if photo is not None:
            sizes[file] = (photo.shape[1], photo.shape[0])
    readable = list(sizes)
    unreadable = [file.name for file in files if file not in sizes]
    if not readable:
        raise SceneError(f'{source}: none of the {len(files)} images can be read')
    by_size: dict[tuple[int, int], list[str]] = {}
    for file in readable:
        by_size.setdefault(sizes[file], []).append(file.name)
    if len(by_size) > 1:
        described = '; '.join(f'{size[0]}x{size[1]}: {listed(names, 3)}'
                              for size, names in by_size.items())
        raise SceneError(f'{source}: expected photos of one size, got {described}. '
                         'Photos are never resized: import the sizes as scenes of their own')
    notes = ((f'{len(unreadable)} images cannot be read and are left out: {listed(unreadable)}',)
             if unreadable else ())
    if not turned:
        return Capture(tuple(CapturedFrame(f'images/{file.name}', None, None, file=file)
                             for file in readable), notes)

    def upright(indices: Sequence[int]) -> Iterator[tuple[int, Optional[np.ndarray]]]:
        return ((index, read_photo(readable[index], upright=True)) for index in indices)

    return Capture(
        tuple(CapturedFrame(f'images/{file.name}', None, None) for file in readable),
        (*notes, f'{turned} photos are stored turned (EXIF); all are written upright, as PNG'),
        upright, origin_of(readable[0].parent))


def _is_turned(file: Path) -> bool:
    """Tell whether a viewer turns the photo; a small copy says so, too."""
    stored, shown = (cv2.imread(str(file), cv2.IMREAD_REDUCED_COLOR_8 | flag)
                     for flag in (cv2.IMREAD_IGNORE_ORIENTATION, 0))
    return stored is not None and shown is not None and not np.array_equal(stored, shown)
