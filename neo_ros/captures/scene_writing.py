"""Write a capture as a scene folder: one pinhole camera, images that are known to be readable."""
from collections.abc import Iterable, Sequence
from dataclasses import replace
import json
from pathlib import Path
import shutil
from typing import Any

import cv2
from neo_ros.captures.capture import Capture, CapturedFrame, name_beside
from neo_ros.captures.depth_agreement import fit_to_depth
from neo_ros.captures.depth_writing import FOLDER as DEPTH_FOLDER, write_depths
from neo_ros.captures.masks import FOLDER as MASK_FOLDER, write_masks
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.lens import common_pinhole, Lens, Straightener
from neo_ros.machine.files import what_to_do, whole_file
from neo_ros.machine.names import listed
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.photo import heic_advice, HEIC_SUFFIXES, photo_size
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import clear_earlier_import
from neo_ros.scenes.transforms_json import write_transforms
import numpy as np

# What an interrupted import was doing, so that the next one knows which images it can keep.
NOTE_FILE = 'import.json'
# Beyond it, single precision rounds positions to more than a millimetre.
FARTHEST_M = 10_000


def write_capture(capture: Capture, scene: Path, progress: Progress = no_progress,
                  depth_progress: Progress = no_progress) -> tuple[str, ...]:
    """
    Write posed frames into a scene folder: images, masks, depth and transforms_train.json.

    Image files of a camera without distortion are copied as they are; all others are made
    straight and written as PNG. Frames whose image cannot be read are left out; returns the notes
    of the capture, and one that names these. An import that was broken off goes on where it
    stopped; test frames and floor map of an earlier one are taken away. Raises SceneError where
    no image can be read, for images whose size is not their camera's, for cameras far from the
    origin, for depth in a unit that cannot be, and where the folder cannot be written.
    """
    assert capture.posed, 'structure from motion comes first'
    check_near_origin([frame.name for frame in capture.frames],
                      [frame.pose for frame in capture.frames if frame.pose is not None])
    names, pinhole = write_images(capture, scene, progress)
    masks, mask_notes = write_masks(capture, names, pinhole, scene)
    depths, depth_notes = write_depths(capture, names, pinhole, scene, depth_progress)
    kept = [index for index, name in enumerate(names) if name is not None]
    images = PosedImages(
        pinhole, tuple(scene / str(names[index]) for index in kept),
        tuple(pose for index in kept if (pose := capture.frames[index].pose) is not None),
        tuple(capture.frames[index].path_id for index in kept), capture.z_up,
        capture.arbitrary_scale, tuple(depths[index] for index in kept) if depths else (),
        tuple(masks[index] for index in kept) if masks else ())
    if depths:
        units = {frame.depth.unit for frame in capture.frames if frame.depth is not None}
        images, agreement = fit_to_depth(images, units.pop())
        depth_notes.append(agreement)
    clear_earlier_import(scene)
    write_transforms(scene / 'transforms_train.json', images)
    return (*capture.notes, *unreadable_note(capture, names), *mask_notes, *depth_notes)


def check_near_origin(names: Sequence[object], poses: Sequence[CameraPose]) -> None:
    """Raise SceneError if a camera is so far out that a training would lose precision."""
    positions = np.array([pose.position for pose in poses])
    distance = np.linalg.norm(positions, axis=1)
    far = int(distance.argmax())
    if distance[far] > FARTHEST_M:
        middle = np.median(positions, axis=0).round(-2)
        raise SceneError(
            f'{names[far]}: expected a camera within {FARTHEST_M // 1000} km of the origin, got '
            f'one at {_numbers(positions[far])} m; subtract the middle of the capture, about '
            f'{_numbers(middle)}, from all positions')


def write_images(capture: Capture, folder: Path,
                 progress: Progress = no_progress) -> tuple[list[str | None], Intrinsics]:
    """
    Write the images alone, posed or not; frames without a lens are taken for pinhole images.

    Returns the relative name of every frame's image, None where it cannot be read, and the
    camera of all of them.
    """
    capture = _with_lenses(capture)
    _check_names(capture, folder)
    lenses: dict[Lens, str] = {}
    for frame in capture.frames:
        if frame.lens is not None:
            lenses.setdefault(frame.lens, _where(frame))
    straightener = Straightener(common_pinhole(lenses))
    names = [_written_name(frame, straightener) for frame in capture.frames]
    _claim(folder, capture, straightener.pinhole)
    missing = [index for index, name in enumerate(names) if not (folder / name).is_file()]
    unreadable = []
    done = len(names) - len(missing)
    progress(done, len(names))
    for index, image in capture.images(missing):
        frame = capture.frames[index]
        if image is None:
            unreadable.append(index)
        else:
            _write_image(frame, image, straightener, folder / names[index])
        done += 1
        progress(done, len(names))
    if len(unreadable) == len(names):
        files = [frame.file for frame in capture.frames if frame.file is not None]
        raise SceneError(f'{folder}: none of the {len(names)} images can be read'
                         f'{heic_advice(files)}')
    left_out = set(unreadable)
    return [None if index in left_out else name
            for index, name in enumerate(names)], straightener.pinhole


def unreadable_note(capture: Capture, names: Sequence[str | None]) -> tuple[str, ...]:
    """Name the images that `write_images` could not read, if there are any."""
    unreadable = [frame for frame, name in zip(capture.frames, names) if name is None]
    advice = heic_advice(frame.file for frame in unreadable if frame.file is not None)
    return (f'{len(unreadable)} images cannot be read and are left out: '
            f'{listed([_where(frame) for frame in unreadable])}{advice}',) if unreadable else ()


def _with_lenses(capture: Capture) -> Capture:
    """Give frames without calibration a camera of their image's size; only the size counts."""
    if all(frame.lens is not None for frame in capture.frames):
        return capture
    sizes = (None if frame.file is None else photo_size(frame.file) for frame in capture.frames)
    size = next((size for size in sizes if size is not None), None)
    if size is None:
        size = next((image.shape[1::-1] for _, image in capture.images(range(len(capture)))
                     if image is not None), None)
    if size is None:
        first = capture.frames[0]
        raise SceneError(f'none of the {len(capture)} images can be read, from '
                         f'{first.file or first.name} on; are the files whole?')
    lens = Lens(Intrinsics.from_hfov(*size, 1.0))
    return replace(capture, frames=tuple(
        replace(frame, lens=lens) for frame in capture.frames))


def _check_names(capture: Capture, folder: Path) -> None:
    written = {(folder / name).resolve() for name in _image_names(capture)}
    seen: set[str] = set()
    for frame in capture.frames:
        if frame.name in seen:
            raise SceneError(f'{_where(frame)}: expected every image once, got it twice; remove '
                             'the second entry')
        if Path(frame.name).is_absolute() or '..' in Path(frame.name).parts:
            raise SceneError(f'{frame.name}: expected a name of an image inside the scene folder')
        beside = [source.file for source in (frame.mask, frame.depth) if source is not None]
        for file in (frame.file, *beside):
            if file is not None and file.resolve() in written:
                raise SceneError(f'{folder}: expected another folder than the source: the import '
                                 f'would replace {file}; choose another scene folder')
        seen.add(frame.name)


def _copied(frame: CapturedFrame, straightener: Straightener) -> bool:
    # A scene is read without any extra: HEIC becomes PNG.
    return (frame.file is not None and frame.file.suffix.lower() not in HEIC_SUFFIXES
            and frame.lens is not None and straightener.is_identity(frame.lens))


def _written_name(frame: CapturedFrame, straightener: Straightener) -> str:
    """Images that are made straight become PNG; their old ending stays, so no two are alike."""
    if _copied(frame, straightener) or frame.name.endswith('.png'):
        return frame.name
    return frame.name + '.png'


def _write_image(frame: CapturedFrame, image: np.ndarray, straightener: Straightener,
                 target: Path) -> None:
    assert frame.lens is not None
    camera = frame.lens.intrinsics
    if image.shape[:2] != (camera.height, camera.width):
        raise SceneError(
            f'{_where(frame)}: expected {camera.width}x{camera.height} pixels as its '
            f'camera says, got {image.shape[1]}x{image.shape[0]}; photos are never resized')
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(target) as partial:
            if _copied(frame, straightener):
                shutil.copyfile(str(frame.file), partial)
            else:
                straight = straightener.apply(image, frame.lens)
                partial.write_bytes(cv2.imencode('.png', straight[..., ::-1])[1].tobytes())
    except OSError as error:
        raise SceneError(f'{target}: cannot write: {error.strerror}; '
                         + what_to_do(error, 'choose another scene folder')) from error


def _where(frame: CapturedFrame) -> str:
    """Name an image as the source does: the name in a scene means nothing to its user."""
    if frame.file is None and frame.stamp_ns is not None:
        return f'the image of {frame.stamp_ns / 1e9:.3f} s'
    return str(frame.file or frame.name)


def _claim(folder: Path, capture: Capture, pinhole: Intrinsics) -> None:
    """Note what is imported; images of anything else that lie in the folder are written anew."""
    note = folder / NOTE_FILE
    wanted: dict[str, Any] = {
        'camera': [pinhole.width, pinhole.height, pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy],
        'lenses': sorted({repr(frame.lens) for frame in capture.frames}),
        'origin': capture.origin,
        'sources': [_fingerprint(frame) for frame in capture.frames]}
    depth = [_depth_fingerprint(frame) for frame in capture.frames if frame.depth is not None]
    if depth:
        wanted['depth'] = depth
    try:
        found = json.loads(note.read_text()) if note.is_file() else None
    except (OSError, ValueError):
        found = None
    if found == wanted:
        return
    check_own(folder, _image_names(capture))
    try:
        # First of all: the earlier poses must never meet other pictures.
        clear_earlier_import(folder)
        (folder / 'transforms_train.json').unlink(missing_ok=True)
        for name in _image_names(capture):
            (folder / name).unlink(missing_ok=True)
        folder.mkdir(parents=True, exist_ok=True)
        note.write_text(json.dumps(wanted))
    except OSError as error:
        raise SceneError(f'{folder}: cannot write: {error.strerror}; '
                         + what_to_do(error, 'choose another scene folder')) from error


def check_apart(scene: Path, files: Iterable[Path]) -> None:
    """Raise SceneError for a source among the images of a scene: the import deletes those."""
    images = (scene / 'images').resolve()
    for file in files:
        found = file.resolve()
        if images == found or images in found.parents:
            raise SceneError(f'{scene}: expected another folder than the source: the import '
                             f'writes to {scene / "images"} and would replace {file}; choose '
                             'another scene folder')


def check_own(folder: Path, names: Iterable[str]) -> None:
    """Raise SceneError for images that no import wrote: they may be the only ones."""
    if (folder / NOTE_FILE).is_file() or (folder / 'transforms_train.json').is_file():
        return
    for name in names:
        if (folder / name).exists():
            raise SceneError(f'{folder}: expected no images that another program wrote, got '
                             f'{name}; choose another scene folder, or move them away')


def _image_names(capture: Capture) -> list[str]:
    """Return all names that images of this capture may get, their masks and depth."""
    names = [name for frame in capture.frames for name in (frame.name, frame.name + '.png')]
    return names + sorted({name_beside(folder, name) for name in names
                           for folder in (DEPTH_FOLDER, MASK_FOLDER)})


def _numbers(xyz: np.ndarray) -> str:
    return '(' + ', '.join(f'{value:.0f}' for value in xyz) + ')'


def _fingerprint(frame: CapturedFrame) -> list[Any]:
    if frame.file is None:
        return [frame.name, frame.stamp_ns]
    state = frame.file.stat()
    return [frame.name, state.st_size, state.st_mtime_ns]


def _depth_fingerprint(frame: CapturedFrame) -> list[Any]:
    depth = frame.depth
    assert depth is not None
    state = None if depth.file is None else depth.file.stat()
    return [frame.name, depth.unit, repr(depth.lens), repr(depth.T_image_depth),
            None if state is None else [state.st_size, state.st_mtime_ns]]
