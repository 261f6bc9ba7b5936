"""
Find the masks that lie beside the photos of a capture, and write them into the scene.

nerfstudio's `mask_path` and its and COLMAP's folder masks/ are black where pixels are left out;
instant-ngp's dynamic_mask_NAME.png are white there. In a scene black is left out.
"""
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from neo_ros.captures.capture import Capture, CapturedFrame, files_beside, MaskSource
from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Straightener
from neo_ros.machine.names import listed
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.photo import DYNAMIC_MASK
from neo_ros.pictures.usable import read_ignored, read_usable, shrunk, write_usable
import numpy as np

FOLDER = 'masks'
# Masks that leave out more than this are the wrong way round.
MOST_LEFT_OUT = 0.9


def find_masks(capture: Capture, source: Path) -> Capture:
    """Give photos that are files the masks that lie beside them, where the format has none."""
    if any(frame.mask for frame in capture.frames):
        return capture
    frames = tuple(replace(frame, mask=None if frame.file is None else _beside(frame.file))
                   for frame in capture.frames)
    folder = source / FOLDER
    if not any(frame.mask for frame in frames) and folder.is_dir() and any(folder.iterdir()):
        return replace(capture, notes=(*capture.notes, (
            f'{folder} is not read: expected masks named like the photos, as 0001.jpg.png or '
            '0001.png of 0001.jpg, and photos that are not turned')))
    return replace(capture, frames=frames)


def write_masks(capture: Capture, names: Sequence[str | None], pinhole: Intrinsics, folder: Path,
                progress: Progress = no_progress) -> tuple[tuple[Path | None, ...], list[str]]:
    """
    Write the masks of all frames whose photo has a name, aligned with the photo.

    Returns the file of each frame, None where it has none, and what the user should know. Raises
    SceneError for masks that leave out nearly everything.
    """
    paths = files_beside(folder, FOLDER, names, [frame.mask for frame in capture.frames])
    wanted = list(paths)
    if not wanted:
        return (), []
    unreadable, shares = [], []
    for done, (index, usable) in enumerate(aligned_masks(capture, wanted, pinhole), start=1):
        if usable is None:
            mask = capture.frames[index].mask
            unreadable.append(str(mask and mask.file))
            del paths[index]
        else:
            write_usable(paths[index], usable)
            shares.append(1 - usable.mean())
        progress(done, len(wanted))
    if shares and np.mean(shares) > MOST_LEFT_OUT:
        file = capture.frames[wanted[0]].mask
        raise SceneError(
            f'{file and file.file}: expected masks that are black only where a photo shows what '
            f'is not of the scene, got {np.mean(shares):.0%} left out in {len(shares)} masks; '
            'turn black and white round, or move the masks away')
    notes = [f'masks: {len(paths)} of {len(capture)} photos have one, which leaves out '
             f'{np.mean(shares):.1%} of the picture'] if shares else []
    if unreadable:
        notes.append(f'{len(unreadable)} masks cannot be read and leave nothing out: '
                     f'{listed(unreadable)}')
    return tuple(paths.get(index) for index in range(len(capture))) if paths else (), notes


def aligned_masks(capture: Capture, indices: Sequence[int], pinhole: Intrinsics
                  ) -> Iterator[tuple[int, np.ndarray | None]]:
    """Yield (index, which pixels of the straight photo are used, bool (H, W), None unread)."""
    straightener = Straightener(pinhole)
    for index in indices:
        yield index, _aligned(capture.frames[index], straightener)


def _aligned(frame: CapturedFrame, straightener: Straightener) -> np.ndarray | None:
    lens, source = frame.raw_lens or frame.lens, frame.mask
    assert lens is not None and source is not None, 'photos have a lens when they are written'
    camera = lens.intrinsics
    if source.white_is_ignored:
        usable = read_ignored(source.file)
        if usable is None:
            return None
        usable = shrunk(usable, camera.width, camera.height)
    else:
        try:
            usable = read_usable(source.file, camera.width, camera.height)
        except SceneError:
            return None
    # The outermost half pixels ask for neighbours beyond the border: there is no mask either.
    return straightener.pick((~usable).astype(np.uint8), lens) == 0


def _beside(photo: Path) -> MaskSource | None:
    dynamic = photo.with_name(f'{DYNAMIC_MASK}{photo.stem}.png')
    if dynamic.is_file():
        return MaskSource(dynamic, white_is_ignored=True)
    above = photo.parent.parent
    for folder in (above / FOLDER, photo.parent / FOLDER,
                   above.parent / FOLDER / photo.parent.name):
        for name in (f'{photo.name}.png', f'{photo.stem}.png'):
            if (folder / name).is_file():
                return MaskSource(folder / name)
    return None
