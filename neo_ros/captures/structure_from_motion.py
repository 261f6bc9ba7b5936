"""Poses for photos that have none: structure from motion with pycolmap, on the CPU."""
from collections.abc import Sequence
from dataclasses import dataclass, replace
import json
import math
from pathlib import Path
import re
import shutil
from typing import Any

from neo_ros.captures.capture import Capture, CapturedFrame
from neo_ros.captures.colmap import read_colmap_model
from neo_ros.captures.levelling import level_world, scaled
from neo_ros.captures.masks import aligned_masks
from neo_ros.captures.scene_writing import unreadable_note, write_images
from neo_ros.captures.sfm_stages import (
    extract_features, focal_length_held, is_plausible, match_photos, place_photos)
from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.colmap import load_pycolmap
from neo_ros.machine.names import listed
from neo_ros.machine.progress import no_stage_progress, StageProgress
from neo_ros.pictures.usable import write_usable
import numpy as np

# With fewer than this placed, more should be recorded.
WELL_PLACED = 0.8
# Nobody knows the scale: the median point is put as far away as walls of a room often are.
MEDIAN_DISTANCE = 3.0
# What the database takes: 4096 features of 152 bytes a photo, and its matches with a score of
# others; and what it needs beside that, for its journal.
PHOTO_BYTES, SPARE_BYTES = 1_000_000, 30_000_000
# Below the working folder, as COLMAP looks for them: a photo's name with .png behind it.
MASKS = 'masks'


@dataclass(frozen=True)
class Verdict:
    """What structure from motion made of the photos; the error is the mean, in pixels."""

    registered: int
    photos: int
    reprojection_error: float
    points: int

    def __str__(self) -> str:
        return (
            f'structure from motion: {self.registered} of {self.photos} photos registered '
            f'({self.points} points, mean reprojection error {self.reprojection_error:.2f} px). '
            f'The scale is arbitrary, not metres: the median point is {MEDIAN_DISTANCE:g} units '
            'away')


def reconstruct(capture: Capture, work: Path,
                progress: StageProgress = no_stage_progress
                ) -> tuple[Capture, Verdict]:
    """
    Find the poses of an unposed capture; needs pycolmap (the train extra).

    All photos are of one camera: of the capture's lens if it has one, else its focal length and
    radial distortion are estimated; where that gives no camera that can be, the focal length is
    held at a common one, and a note says so. `work` keeps the images, the database and the model,
    so that an interrupted run goes on. The world is turned so that z points up. Photos that could
    not be placed are named in the notes and left out. Raises SceneError where fewer than three
    are placed.
    """
    pycolmap = load_pycolmap()
    capture = _without_blanks(capture)
    names, pinhole = write_images(
        capture, work, lambda done, total: progress('images', done, total))
    chosen = [name for name in names if name is not None]
    calibrated = all(frame.lens is not None for frame in capture.frames)
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)  # What fails is raised.
    masked = [frame for frame in capture.frames if frame.mask is not None]
    _claim(work, chosen, pinhole if calibrated else None, [_mask_state(one) for one in masked])
    model = work / 'model'
    if not (model / 'images.bin').is_file() or not is_plausible(pycolmap.Reconstruction(model)):
        database = work / 'database.db'
        if masked:
            _write_masks(capture, names, pinhole, work / MASKS)
        _check_room(work, database, len(chosen))
        extract_features(database, work, chosen, pinhole if calibrated else None, progress,
                         work / MASKS if masked else None)
        match_photos(database, work, chosen, progress)
        place_photos(database, work, model, len(chosen), calibrated, progress)
    reconstruction = pycolmap.Reconstruction(model)
    verdict = Verdict(
        reconstruction.num_reg_images(), len(capture),
        reconstruction.compute_mean_reprojection_error(), reconstruction.num_points3D())
    posed = {str(frame.file): frame for frame in read_colmap_model(model, work).frames}
    frames, placed, lost = [], [], []
    for index, (frame, name) in enumerate(zip(capture.frames, names)):
        found = posed.get(str(work / str(name)))
        if found is not None:
            placed.append(index)
            frames.append(replace(frame, pose=found.pose, lens=found.lens, file=found.file,
                                  name=str(name), raw_lens=frame.lens))
        elif name is not None:
            lost.append((frame.file or Path(frame.name)).name)
    registered = replace(
        capture.subset(placed), frames=tuple(frames), stream=None,
        notes=(*capture.notes, *unreadable_note(capture, names), *_notes(reconstruction, lost)))
    scale = MEDIAN_DISTANCE / _median_depth(reconstruction)
    return replace(scaled(level_world(registered), scale), arbitrary_scale=True), verdict


def _check_room(work: Path, database: Path, count: int) -> None:
    """Raise SceneError where the database will not fit: COLMAP aborts the process then."""
    there = database.stat().st_size if database.is_file() else 0
    needed = max(count * PHOTO_BYTES - there, 0) + SPARE_BYTES
    free = shutil.disk_usage(work).free
    if free < needed:
        raise SceneError(
            f'{work}: expected {needed / 1e6:.0f} MB free on its disk, for the features of '
            f'{count} photos and their matches, got {free / 1e6:.0f} MB; make room, and '
            'give the same command again')


def _without_blanks(capture: Capture) -> Capture:
    """Rename frames where any name has a blank, at which a line of COLMAP's pairs would end."""
    if not any(re.search(r'\s', frame.name) for frame in capture.frames):
        return capture
    return replace(capture, frames=tuple(
        replace(frame, name=f'images/{index:06d}_' + re.sub(r'[\s/]', '_', frame.name))
        for index, frame in enumerate(capture.frames)))


def _write_masks(capture: Capture, names: Sequence[str | None], pinhole: Intrinsics, folder: Path
                 ) -> None:
    """Write a mask for every photo: COLMAP leaves out photos that have none where others do."""
    lens = Lens(pinhole)  # Of photos that nobody calibrated only the size counts.
    capture = replace(capture, frames=tuple(
        replace(frame, lens=frame.lens or lens) for frame in capture.frames))
    masked = {index for index, frame in enumerate(capture.frames) if frame.mask is not None}
    everything = np.ones((pinhole.height, pinhole.width), bool)
    for index, usable in aligned_masks(capture, sorted(masked), pinhole):
        if names[index] is not None:
            write_usable(folder / f'{names[index]}.png', everything if usable is None else usable)
    for index, name in enumerate(names):
        if name is not None and index not in masked:
            write_usable(folder / f'{name}.png', everything)


def _mask_state(frame: CapturedFrame) -> list[Any]:
    assert frame.mask is not None
    state = frame.mask.file.stat()
    return [frame.name, state.st_size, state.st_mtime_ns]


def _claim(work: Path, names: list[str], pinhole: Intrinsics | None, masks: list[Any]) -> None:
    """Keep the database of the same photos and masks, and begin anew with others."""
    note = work / 'photos.json'
    wanted = json.dumps([names, repr(pinhole), (work / 'import.json').read_text(), *masks])
    if note.is_file() and note.read_text() == wanted:
        return
    for old in ('database.db', 'database.db-wal', 'database.db-shm'):
        (work / old).unlink(missing_ok=True)
    for old in ('model', MASKS):
        shutil.rmtree(work / old, ignore_errors=True)
    note.write_text(wanted)


def _notes(reconstruction: Any, lost: list[str]) -> tuple[str, ...]:
    """Say what the verdict does not: which photos are lost, and that the camera is guessed."""
    notes = []
    if lost:
        notes.append(f'{len(lost)} photos could not be placed and are left out: {listed(lost)}')
        placed = reconstruction.num_reg_images()
        if placed < WELL_PLACED * (placed + len(lost)):
            notes[-1] += ('. Record more photos around them, each with more than half in common '
                          'with the one before, from a camera that moves sideways')
    camera, = reconstruction.cameras.values()
    if focal_length_held(camera):
        f, width = camera.params[0], camera.width
        notes.append(
            f'the focal length could not be estimated and is taken to be {f:.0f} px '
            f'({math.degrees(2 * math.atan(width / 2 / f)):.0f} degrees across), so shapes may be '
            'wrong. Record more photos, of things near and far, from a camera that moves sideways')
    return tuple(notes)


def _median_depth(reconstruction: Any) -> float:
    depths = []
    for image in reconstruction.images.values():
        if not image.has_pose:
            continue
        points = [reconstruction.points3D[point.point3D_id].xyz
                  for point in image.points2D if point.has_point3D()]
        if points:
            T_cam_world = image.cam_from_world().matrix()
            depths.append(np.array(points) @ T_cam_world[2, :3] + T_cam_world[2, 3])
    return float(np.median(np.concatenate(depths))) if depths else MEDIAN_DISTANCE
