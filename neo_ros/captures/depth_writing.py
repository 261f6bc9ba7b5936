"""Write the depth of a capture beside its photos, straight and of one size as they are."""
from collections.abc import Sequence
from pathlib import Path

from neo_ros.captures.capture import Capture, CapturedFrame, DepthSource, files_beside
from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import CENTRE, Lens, Straightener
from neo_ros.machine.evenly import evenly
from neo_ros.machine.names import listed
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.depth import MM_PER_M, nearest, read_depth, to_millimetres, write_depth
import numpy as np

FOLDER = 'depth'
# Metres that the middle of all depths can be. Nobody records closer or farther indoors.
NEAREST, FARTHEST = 0.05, 60.0
# Maps that are looked at before the unit is believed, and those that the coverage is taken from.
FIRST, MEASURED = 5, 100
# Pixels of another camera's depth across a cell of the image that it is brought to.
CELL = 1.25
# Metres of a step: metres, millimetres, centimetres, TUM's, Replica's, tenths of a millimetre.
UNITS = (1.0, 0.001, 0.01, 1 / 5000, 1 / 6553.5, 0.0001)
OPTION = '--depth-unit'


def write_depths(capture: Capture, names: Sequence[str | None], pinhole: Intrinsics, folder: Path,
                 progress: Progress = no_progress) -> tuple[tuple[Path | None, ...], list[str]]:
    """
    Write the depth of all frames whose photo has a name, aligned with the photo.

    Maps that are there already are kept. Returns the file of each frame, None where it has no
    depth that can be read, and what the user should know. Raises SceneError for depth in a unit
    that cannot be.
    """
    paths = files_beside(folder, FOLDER, names, [frame.depth for frame in capture.frames])
    wanted = list(paths)
    if not wanted:
        return (), []
    missing = [index for index in wanted if not paths[index].is_file()]
    straightener = Straightener(pinhole)
    middles: list[float] = []
    unreadable: list[int] = []
    progress(done := len(wanted) - len(missing), len(wanted))
    for index, metres in capture.depths(missing):
        if metres is None:
            unreadable.append(index)
        else:
            if len(middles) < FIRST and metres.any():
                middles.append(float(np.median(metres[metres > 0])))
                if len(middles) == FIRST:
                    _check_unit(middles, capture.frames[index].depth)
            aligned = align_depth(metres, capture.frames[index], straightener)
            write_depth(paths[index], to_millimetres(aligned))
        progress(done := done + 1, len(wanted))
    if middles:
        _check_unit(middles, capture.frames[wanted[0]].depth)
    notes = []
    if unreadable:
        shown = listed([str((depth := capture.frames[index].depth) and depth.file
                            or capture.frames[index].name) for index in unreadable])
        notes.append(f'{len(unreadable)} depth maps cannot be read and are left out: {shown}')
        for index in unreadable:
            del paths[index]
    if not paths:
        return (), notes
    notes.insert(0, _coverage(list(paths.values()), len(capture), pinhole))
    return tuple(paths.get(index) for index in range(len(capture))), notes


def align_depth(metres: np.ndarray, frame: CapturedFrame, straightener: Straightener
                ) -> np.ndarray:
    """Return depth float32 (h, w) as the straight photo of a frame sees it: (H, W), 0 unknown."""
    depth = frame.depth
    assert depth is not None
    if depth.T_image_depth is not None:
        assert depth.lens is not None, 'a camera that stands elsewhere has a lens of its own'
        return _seen_from(metres, depth.lens, depth.T_image_depth, straightener.pinhole)
    lens = depth.lens or frame.raw_lens or frame.lens
    assert lens is not None, 'photos have a lens when they are written'
    camera = lens.intrinsics
    sized = nearest(metres, camera.width, camera.height)
    return straightener.pick(sized, lens)


def _seen_from(metres: np.ndarray, lens: Lens, T_image_depth: np.ndarray, pinhole: Intrinsics
               ) -> np.ndarray:
    """
    Return the depth (H, W) of a camera that stands beside the image's, as the image sees it.

    Of points in one cell of the image the nearest counts. Cells are a little larger than the
    pixels that they come from: else far things would show through the gaps between near ones.
    """
    camera = lens.intrinsics
    metres = nearest(metres, camera.width, camera.height)
    rows, columns = np.nonzero(metres)
    rays = lens.straighten(np.stack([columns, rows], -1) + CENTRE)
    z = metres[rows, columns, None]
    points = np.concatenate([rays * z, z], 1) @ T_image_depth[:3, :3].T + T_image_depth[:3, 3]
    points = points[np.isfinite(points).all(1) & (points[:, 2] > 0)]
    share = min(1.0, camera.fx / pinhole.fx / CELL)
    cells = pinhole.scaled(share)
    u, v = np.floor(cells.project(points)).astype(np.int64).T
    inside = (u >= 0) & (u < cells.width) & (v >= 0) & (v < cells.height)
    u, v, far = u[inside], v[inside], points[inside, 2]
    seen = np.full((cells.height, cells.width), np.inf, np.float32)
    np.minimum.at(seen, (v, u), far.astype(np.float32))
    return nearest(np.where(np.isfinite(seen), seen, 0), pinhole.width, pinhole.height)


def _check_unit(middles: Sequence[float], depth: DepthSource | None) -> None:
    """Raise SceneError where depth in this unit is not of a place that people record."""
    assert depth is not None
    middle = float(np.median(middles))
    if NEAREST <= middle <= FARTHEST:
        return
    steps = middle / depth.unit
    fitting = [unit for unit in UNITS if 0.3 <= unit * steps <= 10]
    advice = f'{OPTION} {fitting[0]:.6g} would make it {fitting[0] * steps:.2g} m' if (
        fitting) else f'{OPTION} METRES says what one step of the numbers means'
    where = '' if depth.file is None else f'{depth.file.parent}: '
    raise SceneError(
        f'{where}depth: expected a median between {NEAREST:g} and {FARTHEST:g} m, got '
        f'{middle:.3g} m, as one step of the numbers is taken for {depth.unit:.6g} m; {advice}; '
        f'{OPTION} 0 leaves the depth out')


def _coverage(paths: Sequence[Path], photos: int, pinhole: Intrinsics) -> str:
    """Say how many photos have depth, and of how much of their picture."""
    maps = [read_depth(paths[place], pinhole.width, pinhole.height)
            for place in evenly(len(paths), MEASURED)]
    known = np.mean([(one > 0).mean() for one in maps])
    depths = np.concatenate([one[one > 0][::16] for one in maps])
    far = f', the median is {np.median(depths) / MM_PER_M:.2f} m' if len(depths) else ''
    return (f'depth: {len(paths)} of {photos} photos have a depth map, which covers '
            f'{known:.0%} of the picture{far}')
