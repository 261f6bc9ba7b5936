"""The stages of structure from motion with pycolmap: features, matches, cameras and poses."""
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
import math
from pathlib import Path
import shutil
from typing import Any

from neo_ros.errors import NeoError, SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.colmap import load_pycolmap
from neo_ros.machine.evenly import evenly
from neo_ros.machine.progress import StageProgress

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


def photo_pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return which photos are compared: all, or along a walk the near ones and some far ones."""
    count = len(names)
    if count <= EXHAUSTIVE_UP_TO:
        return list(combinations(names, 2))
    steps = [*range(1, NEIGHBOURS + 1)]
    while steps[-1] * 2 < min(count, 256):
        steps.append(1 << steps[-1].bit_length())
    pairs = {(i, i + step) for i in range(count) for step in steps if i + step < count}
    anchors = evenly(count, ANCHORS).tolist()
    pairs.update(combinations(anchors, 2))
    return [(names[i], names[j]) for i, j in sorted(pairs)]


def extract_features(database: Path, work: Path, names: list[str], pinhole: Intrinsics | None,
                     progress: StageProgress, masks: Path | None = None) -> None:
    """
    Add the features of photos that the database lacks.

    pinhole: their camera, if known; masks: a folder with NAME.png, black where there are none.
    """
    pycolmap = load_pycolmap()
    reader = pycolmap.ImageReaderOptions()
    if masks is not None:
        reader.mask_path = masks
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


def match_photos(database: Path, work: Path, names: list[str], progress: StageProgress) -> None:
    """Compare pairs of photos that the database has not compared yet."""
    pycolmap = load_pycolmap()
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


def place_photos(database: Path, work: Path, model: Path, count: int, calibrated: bool,
                 progress: StageProgress) -> None:
    """Write the largest model; raises SceneError where too few photos can be placed."""
    pycolmap = load_pycolmap()
    most = 0

    def show(placed: int) -> None:
        nonlocal most
        if placed > most:  # Where a model fails, the next one begins with two photos again.
            most = placed
            progress('poses', placed, count)

    found = _largest_model(database, work, count, not calibrated, show)
    if not (calibrated or found is not None and is_plausible(found)):
        with pycolmap.Database.open(database) as stored:
            camera, = stored.read_all_cameras()
            camera.has_prior_focal_length = True  # Else the first pair estimates it again.
            stored.update_camera(camera)
        most = 0
        found = _largest_model(database, work, count, False, show)
    if found is None or not is_plausible(found):
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
    pycolmap = load_pycolmap()
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


def is_plausible(reconstruction: Any) -> bool:
    """Whether enough photos are placed, with a camera that can be."""
    if reconstruction.num_reg_images() < FEWEST:
        return False
    camera, = reconstruction.cameras.values()
    if camera.model.name == 'PINHOLE' or focal_length_held(camera):
        return True
    f, cx, cy, k1 = camera.params
    try:
        lens = Lens(Intrinsics(camera.width, camera.height, f, f, cx, cy), (k1, 0.0, 0.0, 0.0))
        left, right, _, _ = lens.straight_rectangle()
    except NeoError:
        return False
    hfov = math.atan(right) - math.atan(left)
    return NARROWEST <= hfov <= WIDEST and abs(k1) <= STRONGEST_DISTORTION


def focal_length_held(camera: Any) -> bool:
    """Whether a SIMPLE_RADIAL camera kept the focal length that it began with."""
    # A distortion that was estimated is never exactly 0.
    return bool(camera.model.name == 'SIMPLE_RADIAL' and camera.params[3] == 0)


def _chunks(items: Sequence[Any], size: int) -> Iterator[Sequence[Any]]:
    return (items[start:start + size] for start in range(0, len(items), size))
