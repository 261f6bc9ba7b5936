"""Photos without poses: a folder of image files of one size."""
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from neo_ros.captures.camera_file import read_camera_file
from neo_ros.captures.capture import Capture, CapturedFrame, origin_of
from neo_ros.captures.turned_lens import (
    REMEDY, shown_lens, shown_pixels, shown_size, TURNS, UPRIGHT)
from neo_ros.errors import SceneError
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.header import JPEG_START, stored_orientation, TIFF_STARTS
from neo_ros.pictures.photo import decode_photo, heic_advice, list_photos, read_photo
import numpy as np

PHOTO_FOLDERS = ('images', 'photos', 'rgb')
# Pictures that are not read: raw ones, and newer or moving ones.
UNREAD_SUFFIXES = ('.dng', '.cr2', '.cr3', '.nef', '.arw', '.raf', '.orf', '.rw2', '.avif', '.jxl',
                   '.gif', '.exr', '.jp2')
# Cameras write into these how they were held.
EXIF_SUFFIXES = ('.jpg', '.jpeg', '.tif', '.tiff', '.webp')


def find_photos(source: Path) -> list[Path]:
    """Return the image files of SOURCE or its folder images/, where most are, in natural order."""
    # Of as many the first; a preview may lie beside the folder.
    return max(_photo_lists(source), key=len)


def _photo_lists(source: Path) -> list[list[Path]]:
    return [list_photos(folder) for folder in (
        source, *(source / name for name in PHOTO_FOLDERS))]


def read_photos(source: Path, camera_info: Path | None = None,
                progress: Progress = no_progress) -> Capture:
    """
    List photos without poses; camera_info is their calibration, else they have none.

    Files that cannot be read are named in the notes and left out. Where a camera noted that it was
    turned (EXIF), the photos are shown upright: their up becomes the world's; but not where only
    some were, and would be of another size then. Raises SceneError for a folder without a readable
    image, for photos of several sizes, and for a calibration that does not turn with them.
    """
    files = find_photos(source)
    if not files:
        raise SceneError(f'{source}: expected photos, there are none')
    listing = _list_readable(source, files, progress)
    readable = list(listing.stored)
    notes = [*_aside_notes(source, files), *_notes(files, listing)]
    lens = None if camera_info is None else read_camera_file(camera_info)
    if listing.mixed or not listing.turned:
        return Capture(tuple(CapturedFrame(f'images/{file.name}', None, lens, file=file)
                             for file in readable), tuple(notes))

    def read(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        return ((index, read_photo(readable[index], upright=True)) for index in indices)

    lenses = {file: None if lens is None or camera_info is None else
              _upright_lens(lens, file, listing, camera_info) for file in readable}
    return Capture(
        tuple(CapturedFrame(f'images/{file.name}', None, lenses[file]) for file in readable),
        (*notes, f'{listing.turned} photos are stored turned (EXIF); all are written upright, as '
                 'PNG'),
        read, origin_of(readable[0].parent))


@dataclass(frozen=True)
class _Listing:
    """
    The photos that can be read.

    stored, shown  how large they are as stored and upright, (width, height)
    orientations   how they are stored, as EXIF counts; 1 is upright
    """

    stored: dict[Path, tuple[int, int]]
    shown: dict[Path, tuple[int, int]]
    orientations: dict[Path, int]

    @property
    def turned(self) -> int:
        """How many are stored otherwise than they are shown."""
        return sum(orientation != UPRIGHT for orientation in self.orientations.values())

    @property
    def mixed(self) -> bool:
        """Whether only some were turned, so that upright they differ in size."""
        return len(set(self.shown.values())) > 1 and len(set(self.stored.values())) == 1


def _list_readable(source: Path, files: Sequence[Path], progress: Progress) -> _Listing:
    """Read all photos once; raises SceneError where none can be, and for several sizes."""
    stored: dict[Path, tuple[int, int]] = {}
    shown: dict[Path, tuple[int, int]] = {}
    orientations: dict[Path, int] = {}
    for done, file in enumerate(files, start=1):
        photo = read_photo(file)
        progress(done, len(files))
        if photo is None:
            continue
        stored[file] = (photo.shape[1], photo.shape[0])
        orientations[file] = _orientation(file, photo)
        shown[file] = shown_size(stored[file], orientations[file])
    if not stored:
        raise SceneError(f'{source}: none of the {len(files)} images can be read'
                         f'{heic_advice(files)}')
    listing = _Listing(stored, shown, orientations)
    by_size: dict[tuple[int, int], list[str]] = {}
    for file, size in (stored if listing.mixed else shown).items():
        by_size.setdefault(size, []).append(file.name)
    if len(by_size) > 1:
        described = '; '.join(f'{size[0]}x{size[1]}: {listed(names, 3)}'
                              for size, names in by_size.items())
        raise SceneError(f'{source}: expected photos of one size, got {described}. '
                         'Photos are never resized: import the sizes as scenes of their own')
    return listing


def _orientation(file: Path, photo: np.ndarray) -> int:
    """Return how a photo is stored, as EXIF counts."""
    if file.suffix.lower() not in EXIF_SUFFIXES:
        return UPRIGHT
    data = file.read_bytes()
    if data.startswith((JPEG_START, *TIFF_STARTS)):  # To decode large photos twice takes minutes.
        return stored_orientation(data)
    upright = decode_photo(data, upright=True)
    assert upright is not None, 'it could be read just now'
    return next((orientation for orientation in TURNS
                 if np.array_equal(shown_pixels(photo, orientation), upright)), UPRIGHT)


def _upright_lens(lens: Lens, file: Path, listing: _Listing, camera_info: Path) -> Lens:
    """Return the lens of a photo that is written upright."""
    size = (lens.intrinsics.width, lens.intrinsics.height)
    if size == listing.stored[file]:
        return shown_lens(lens, listing.orientations[file], camera_info)
    if size == listing.shown[file] and len({*listing.orientations.values()} - {UPRIGHT}) == 1:
        return lens  # Of photos that were shown upright, too.
    stored = listing.stored[file]
    raise SceneError(
        f'--camera-info {camera_info}: expected the camera of {stored[0]}x{stored[1]} pixels, as '
        f'{file.name} is stored before it is turned (EXIF), got {size[0]}x{size[1]}; {REMEDY}')


def _aside_notes(source: Path, files: Sequence[Path]) -> list[str]:
    """Name the photos that lie in other folders than those that are taken."""
    return [f'{len(others)} photos in {others[0].parent} are left aside, as {files[0].parent} has '
            f'{len(files)}: {listed([file.name for file in others])}'
            for others in _photo_lists(source) if others and others != files]


def _notes(files: Sequence[Path], listing: _Listing) -> list[str]:
    """Say which files are left out, and which stay turned."""
    notes: list[str] = []
    unreadable = [file for file in files if file not in listing.stored]
    if unreadable:
        notes.append(f'{len(unreadable)} images cannot be read and are left out: '
                     f'{listed([file.name for file in unreadable])}{heic_advice(unreadable)}')
    others = sorted(path.name for path in files[0].parent.iterdir()
                    if path.suffix.lower() in UNREAD_SUFFIXES and not path.name.startswith('.'))
    if others:
        notes.append(f'{len(others)} files are of kinds that are not read, and are left out: '
                     f'{listed(others)}; export them as JPEG, PNG or TIFF')
    if listing.mixed:
        notes.append(f'{listing.turned} of {len(listing.stored)} photos are stored turned (EXIF); '
                     'upright they would be of another size than the others, so all stay as they '
                     'are stored')
    return notes
