"""Turn a field back to what a place looked like before an update changed it."""
from dataclasses import dataclass, replace

from neo_ros.baking.keyframes import BakingRules
from neo_ros.field.grid_points import dilated
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.updating.changed_space import ChangedSpace, ChangeRules, space_of
from neo_ros.updating.compared_photos import ComparedPhotos
from neo_ros.updating.kernels import count_spans
from neo_ros.updating.past import Past
import numpy as np
from scipy import ndimage


@dataclass(frozen=True)
class TurnRules:
    """When a place is as it was."""

    # Of all rows and columns of pixels one in so many is asked: a cell is seen by several.
    every: int = 2
    # That contradict the memory and see a place, at least: else nobody looks closer.
    least_pixels: int = 12
    # Photos show one of two looks where it is nearer to them by more than so many grey levels; so
    # many do at least, of all that decide.
    grey_levels: float = 15.0
    least_photos: int = 3
    least_share: float = 0.7
    # And so many of those around, metres, contradict the memory: colours of a field are rough.
    least_against: float = 0.3
    around: float = 0.12
    # Cells before and behind a surface that are of it.
    thick: float = 1.5
    # What no photo decides is as the nearest that one does, if that is so near, metres: a drive
    # sees the rims of a rug.
    reach: float = 1.0


@dataclass(frozen=True, eq=False)
class TurnedBack:
    """
    A field, photos compared with it, and the cells that are as they were once.

    undone int32 (X, Y, Z): the first update that no longer counts there, 0 = they all do.
    """

    field: VoxelField
    compared: ComparedPhotos
    space: ChangedSpace
    undone: np.ndarray


def turn_back(field: VoxelField, compared: ComparedPhotos, past: Past,
              progress: Progress = no_progress, rules: TurnRules = TurnRules()) -> TurnedBack:
    """
    Let the new photos choose between what is there and what was, the first change first.

    A thing that comes back is seen in part; what was there before it left is known as a whole.
    """
    undone, votes = np.zeros((2, *field.shape), np.int32)
    now, updates = field, past.looks.updates[::-1]
    for done, update in enumerate(updates, 1):
        points, values = past.looks.of(update, now)
        then = _with_values(now, points, values)
        back, photos = _chosen(now, then, _with_corners(points), compared, rules)
        if back.any():
            points &= dilated(back, 0)
            now = _with_values(now, points, then.grid[then.row_of[points.ravel()]])
            undone[back], votes[back] = update, photos[back]
        progress(done, len(updates))
    space = space_of(field, undone > 0, votes, ChangeRules(), 0)
    return TurnedBack(now, _compared_anew(now, compared, space) if space.places else compared,
                      space, undone)


def _with_values(field: VoxelField, points: np.ndarray, values: np.ndarray) -> VoxelField:
    """Return a field with rows of a grid (M, 1 + 3K) at points, bool (X, Y, Z)."""
    flat = points.ravel()
    found = field.keeping((field.row_of >= 0) | flat)
    found.grid[found.row_of[flat]] = values
    found.update_occupancy()
    return found


def _with_corners(points: np.ndarray) -> np.ndarray:
    """Return the cells that have one of these points for a corner, bool (X, Y, Z)."""
    cells = ndimage.maximum_filter(points.view(np.uint8), 2, mode='constant', origin=-1).view(bool)
    cells[-1], cells[:, -1], cells[:, :, -1] = False, False, False  # There are no cells.
    return cells


def _chosen(now: VoxelField, then: VoxelField, cells: np.ndarray, compared: ComparedPhotos,
            rules: TurnRules) -> tuple[np.ndarray, np.ndarray]:
    """Return which cells are as they were, bool (X, Y, Z), and how many photos say so, int32."""
    nothing = np.zeros(now.shape, bool), np.zeros(now.shape, np.int32)
    reached = _reached_by_new(now, compared, cells, rules.every)
    if (reached & compared.contradicts).sum() < rules.least_pixels:
        return nothing
    stays, back, contradict = _votes(now, then, reached, compared, rules)
    near = 2 * round(rules.around / now.voxel) + 1
    agreed, against = (ndimage.uniform_filter(one.astype(np.float32), near)
                       for one in (back, contradict))
    as_then = (back >= rules.least_photos) & (back >= rules.least_share * (back + stays)) & cells
    as_now = cells & ((stays > back) | as_then & (against < rules.least_against * agreed))
    as_then &= ~as_now
    if not as_then.any():
        return nothing
    box, = ndimage.find_objects(cells.view(np.uint8))
    apart, nearest = ndimage.distance_transform_edt(~(as_then | as_now)[box], return_indices=True)
    as_then[box] = as_then[box][tuple(nearest)] & (apart * now.voxel <= rules.reach) & cells[box]
    kept = np.zeros_like(cells)
    for place in space_of(now, as_then, back, ChangeRules(), 0).places:
        kept[tuple(place.cells.T)] = True
    return kept, back


def _votes(now: VoxelField, then: VoxelField, reached: np.ndarray, compared: ComparedPhotos,
           rules: TurnRules) -> np.ndarray:
    """
    Count the photos that say something of each cell, by pixels bool (N, h, w): (3, X, Y, Z).

    That are nearer to what is there; to what was; and of these those that contradict the memory.
    """
    photos, thick = compared.photos, rules.thick * now.voxel
    counts = np.zeros((3, len(now.row_of)), np.int32)
    last = np.zeros(len(now.row_of), np.int32)
    for index in map(int, np.flatnonzero(reached.any((1, 2)))):
        pixels = reached[index]
        origin, rays = world_rays(photos.intrinsics, compared.pose(index))
        rays = np.ascontiguousarray(rays[pixels], np.float32)
        shown = [render_rays(field, origin, rays) for field in (now, then)]
        photo = photos.images[index][pixels] * (compared.gains[index] / 255)
        off = [np.abs(one.image - photo).max(-1) for one in shown]
        first = np.minimum(shown[0].depth, shown[1].depth)
        like_now, like_then = (
            off[1 - kind] - off[kind] > rules.grey_levels / 255 for kind in (0, 1))
        for kind, (those, depth) in enumerate((
                (like_now, shown[0].depth), (like_then, shown[1].depth),
                (like_then & compared.contradicts[index][pixels], shown[1].depth))):
            count_spans(origin.astype(np.float64), rays[those],
                        np.maximum(first[those] - thick, now.near), depth[those] + thick,
                        now.box, np.array(now.shape), 3 * index + kind + 1, last, counts[kind])
    return counts.reshape(3, *now.shape)


def _reached_by_new(field: VoxelField, compared: ComparedPhotos, cells: np.ndarray,
                    every: int = 1) -> np.ndarray:
    """Do what `ChangedSpace.reached_by` does, for some pixels of new photos: bool (N, h, w)."""
    found, photos, space = np.zeros_like(compared.stale), compared.photos, ChangedSpace(cells, [])
    assert photos.usable is not None
    some = slice(None, None, every), slice(None, None, every)
    for index in range(compared.old, len(found)):
        origin, rays = world_rays(photos.intrinsics, compared.pose(index))
        found[index][some] = photos.usable[index][some] & space.met_by(
            field, origin, rays[some],
            (1 + BakingRules.one_surface) * compared.depth[index][some])
    return found


def _compared_anew(field: VoxelField, compared: ComparedPhotos, space: ChangedSpace
                   ) -> ComparedPhotos:
    """
    Compare with the field what new photos show of surfaces that are, or were, in turned cells.

    What lies behind them is left to the memory, which may differ from the field.
    """
    photos = compared.photos
    contradicts, agrees, depth = (one.copy() for one in (
        compared.contradicts, compared.agrees, compared.depth))
    reached = _reached_by_new(field, compared, space.cells)
    for index in map(int, np.flatnonzero(reached.any((1, 2)))):
        pixels = reached[index]
        origin, rays = world_rays(photos.intrinsics, compared.pose(index))
        now, was = render_rays(field, origin, rays[pixels]), depth[index][pixels]
        mine = np.zeros(was.shape, bool)
        for surface in (now.depth, was):
            mine |= space.holds(field, origin + surface[:, None] * rays[pixels])
        known = mine & (now.coverage > BakingRules.least_coverage)
        depth[index][pixels] = np.where(mine, np.where(known, now.depth, 0), was)
        pixels[pixels] = mine
        image = photos.images[index].astype(np.float32)
        shown = image.copy()
        shown[pixels] = 255 * now.image[mine] / compared.gains[index]
        alike = pixels & ~contradicted(contradiction(image, shown, pixels))
        contradicts[index] &= ~alike
        agrees[index] = np.where(pixels, alike, agrees[index])
    return replace(compared, contradicts=contradicts, agrees=agrees, depth=depth)
