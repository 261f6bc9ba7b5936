"""Photos without poses: a folder of image files of one size."""
from pathlib import Path

from neo_ros.errors import SceneError
from neo_ros.scenes.capture import Capture, CapturedFrame, list_photos, listed, photo_size

PHOTO_FOLDERS = ('images', 'photos', 'rgb')


def find_photos(source: Path) -> list[Path]:
    """Return the image files of SOURCE, or of its folder images/, in natural order."""
    return next((found for folder in (source, *(source / name for name in PHOTO_FOLDERS))
                 if (found := list_photos(folder))), [])


def read_photos(source: Path) -> Capture:
    """
    List photos without poses and without calibration.

    Files that cannot be read are named in the notes and left out. Raises SceneError for a folder
    without a readable image, and for photos of several sizes.
    """
    files = find_photos(source)
    if not files:
        raise SceneError(f'{source}: expected photos, there are none')
    sizes = {file: photo_size(file) for file in files}
    unreadable = [file.name for file, size in sizes.items() if size is None]
    readable = [file for file, size in sizes.items() if size is not None]
    if not readable:
        raise SceneError(f'{source}: none of the {len(files)} images can be read')
    by_size: dict[object, list[str]] = {}
    for file in readable:
        by_size.setdefault(sizes[file], []).append(file.name)
    if len(by_size) > 1:
        described = '; '.join(f'{size[0]}x{size[1]}: {listed(names, 3)}'  # type: ignore[index]
                              for size, names in by_size.items())
        raise SceneError(f'{source}: expected photos of one size, got {described}. '
                         'Photos are never resized: import the sizes as scenes of their own')
    notes = ((f'{len(unreadable)} images cannot be read and are left out: {listed(unreadable)}',)
             if unreadable else ())
    return Capture(tuple(CapturedFrame(f'images/{file.name}', None, None, file=file)
                         for file in readable), notes)
