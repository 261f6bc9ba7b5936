"""Poses for photos that have none: structure from motion with pycolmap, on the CPU."""
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
import json
import math
from pathlib import Path
import re
import shutil
from typing import Any

from neo_ros.captures.capture import Capture
from neo_ros.captures.colmap import read_colmap_model
from neo_ros.captures.levelling import level_world, scaled
from neo_ros.captures.scene_writing import unreadable_note, write_images
from neo_ros.errors import NeoError, SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed
from neo_ros.machine.progress import no_stage_progress, StageProgress
import numpy as np

# All pairs up to this number of photos; beyond it photos are taken for a walk.
EXHAUSTIVE_UP_TO = 100
# Along a walk: the next ones, then 16, 32, ... frames on; and some photos each with each, which
# closes loops without a vocabulary of image words.
NEIGHBOURS, ANCHORS = 10, 60
FEATURES = 4096
CHUNK = 100
# Two photos alone fit almost any camera, and so do photos that hardly move: the focal length then
# runs away, with a small error. No camera of a robot or phone is outside these limits.
FEWEST = 3
NARROWEST, WIDEST = math.radians(20), math.radians(140)
STRONGEST_DISTORTION = 1.0
# With fewer than this placed, more should be recorded.
WELL_PLACED = 0.8
# Nobody knows the scale: the median point is put as far away as walls of a room often are.
MEDIAN_DISTANCE = 3.0


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
    import pycolmap
    capture = _without_blanks(capture)
    names, pinhole = write_images(
        capture, work, lambda done, total: progress('images', done, total))
    chosen = [name for name in names if name is not None]
    calibrated = all(frame.lens is not None for frame in capture.frames)
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)  # What fails is raised.
    _claim(work, chosen, pinhole if calibrated else None)
    model = work / 'model'
    if not (model / 'images.bin').is_file() or not _usable(pycolmap.Reconstruction(model)):
        database = work / 'database.db'
        _extract(database, work, chosen, pinhole if calibrated else None, progress)
        _match(database, work, chosen, progress)
        _map(database, work, model, len(chosen), calibrated, progress)
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


def photo_pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return which photos are compared: all, or along a walk the near ones and some far ones."""
    count = len(names)
    if count <= EXHAUSTIVE_UP_TO:
        return list(combinations(names, 2))
    steps = [*range(1, NEIGHBOURS + 1)]
    while steps[-1] * 2 < min(count, 256):
        steps.append(1 << steps[-1].bit_length())
    pairs = {(i, i + step) for i in range(count) for step in steps if i + step < count}
    anchors = np.unique(np.linspace(0, count - 1, ANCHORS).round().astype(int)).tolist()
    pairs.update(combinations(anchors, 2))
    return [(names[i], names[j]) for i, j in sorted(pairs)]


def _without_blanks(capture: Capture) -> Capture:
    """Rename frames where any name has a blank, at which a line of COLMAP's pairs would end."""
    if not any(re.search(r'\s', frame.name) for frame in capture.frames):
        return capture
    return replace(capture, frames=tuple(
        replace(frame, name=f'images/{index:06d}_' + re.sub(r'[\s/]', '_', frame.name))
        for index, frame in enumerate(capture.frames)))


def _claim(work: Path, names: list[str], pinhole: Intrinsics | None) -> None:
    """Keep the database of the same photos, and begin anew with others."""
    note = work / 'photos.json'
    wanted = json.dumps([names, repr(pinhole), (work / 'import.json').read_text()])
    if note.is_file() and note.read_text() == wanted:
        return
    for old in ('database.db', 'database.db-wal', 'database.db-shm'):
        (work / old).unlink(missing_ok=True)
    shutil.rmtree(work / 'model', ignore_errors=True)
    note.write_text(wanted)


def _extract(database: Path, work: Path, names: list[str], pinhole: Intrinsics | None,
             progress: StageProgress) -> None:
    import pycolmap
    reader = pycolmap.ImageReaderOptions()
    if pinhole is not None:
        reader.camera_model = 'PINHOLE'
        reader.camera_params = ','.join(
            repr(value) for value in (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy))
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features = FEATURES
    done = 0
    for chunk in _chunks(names, 8):
        with pycolmap.Database.open(database) as stored:
            cameras = stored.read_all_cameras()
        if cameras:  # one camera for all chunks
            reader.existing_camera_id = cameras[0].camera_id
        pycolmap.extract_features(
            database, work, list(chunk), pycolmap.CameraMode.SINGLE, reader, options,
            pycolmap.Device.cpu)
        done += len(chunk)
        progress('features', done, len(names))


def _match(database: Path, work: Path, names: list[str], progress: StageProgress) -> None:
    import pycolmap
    pairs = photo_pairs(names)
    options = pycolmap.ImportedPairingOptions()
    options.match_list_path = work / 'pairs.txt'
    done = 0
    for chunk in _chunks(pairs, CHUNK):  # pairs that are in the database are not matched again
        (work / 'pairs.txt').write_text('\n'.join(f'{a} {b}' for a, b in chunk))
        pycolmap.match_image_pairs(database, pairing_options=options,
                                   device=pycolmap.Device.cpu)
        done += len(chunk)
        progress('matches', done, len(pairs))


def _map(database: Path, work: Path, model: Path, count: int, calibrated: bool,
         progress: StageProgress) -> None:
    import pycolmap
    most = 0

    def show(placed: int) -> None:
        nonlocal most
        if placed > most:  # Where a model fails, the next one begins with two photos again.
            most = placed
            progress('poses', placed, count)

    found = _largest_model(database, work, count, not calibrated, show)
    if not (calibrated or found is not None and _usable(found)):
        with pycolmap.Database.open(database) as stored:
            camera, = stored.read_all_cameras()
            camera.has_prior_focal_length = True  # Else the first pair estimates it again.
            stored.update_camera(camera)
        most = 0
        found = _largest_model(database, work, count, False, show)
    if found is None or not _usable(found):
        what = 'the poses' if calibrated else 'camera and poses'
        placed = 'none' if found is None else found.num_reg_images()
        raise SceneError(
            f'{work}: {what} could not be estimated: structure from motion placed {placed} of '
            f'the {count} photos, expected at least {FEWEST}. Photos need texture, more than half '
            'in common with the one before, and a camera that moves sideways and does not only '
            'turn')
    partial = work / 'model.partial'
    for old in (partial, model):
        shutil.rmtree(old, ignore_errors=True)
    partial.mkdir()
    found.write(partial)
    partial.rename(model)
    show(count)


def _largest_model(database: Path, work: Path, count: int, refine: bool,
                   show: Callable[[int], None]) -> Any | None:
    """Place the photos; `refine` estimates focal length and distortion, too."""
    import pycolmap
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = 0
    options.min_model_size = FEWEST
    options.ba_refine_focal_length = options.ba_refine_extra_params = refine
    placed = 0

    def first_pair() -> None:
        nonlocal placed
        placed = 2
        show(placed)

    def one_more() -> None:
        nonlocal placed
        placed = min(placed + 1, count)  # A photo that was taken out may come again.
        show(placed)

    folder = work / 'models'
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    models = pycolmap.incremental_mapping(
        database, work, folder, options, initial_image_pair_callback=first_pair,
        next_image_callback=one_more)
    shutil.rmtree(folder, ignore_errors=True)
    return max(models.values(), key=lambda found: found.num_reg_images(), default=None)


def _usable(reconstruction: Any) -> bool:
    """Whether enough photos are placed, with a camera that can be."""
    if reconstruction.num_reg_images() < FEWEST:
        return False
    camera, = reconstruction.cameras.values()
    if camera.model.name == 'PINHOLE' or _focal_length_held(camera):
        return True
    f, cx, cy, k1 = camera.params
    try:
        lens = Lens(Intrinsics(camera.width, camera.height, f, f, cx, cy), (k1, 0.0, 0.0, 0.0))
        left, right, _, _ = lens.straight_rectangle()
    except NeoError:
        return False
    hfov = math.atan(right) - math.atan(left)
    return NARROWEST <= hfov <= WIDEST and abs(k1) <= STRONGEST_DISTORTION


def _focal_length_held(camera: Any) -> bool:
    # A distortion that was estimated is never exactly 0.
    return bool(camera.model.name == 'SIMPLE_RADIAL' and camera.params[3] == 0)


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
    if _focal_length_held(camera):
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


def _chunks(items: Sequence[Any], size: int) -> Iterator[Sequence[Any]]:
    return (items[start:start + size] for start in range(0, len(items), size))
