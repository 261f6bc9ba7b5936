"""Turn a field back to what a place looked like before an update changed it."""
from dataclasses import dataclass, replace

from neo_ros.baking.keyframes import BakingRules
from neo_ros.field.grid_points import cells_around, dilated
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.contradiction import contradicted, contradiction
from neo_ros.updating.changed_space import ChangedSpace, ChangeRules, space_of
from neo_ros.updating.compared_photos import ComparedPhotos
from neo_ros.updating.past import Past
from neo_ros.updating.photo_votes import CellVotes, shown_twice
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
    now, updates = field, past.looks.updates
    for done, update in enumerate(updates, 1):
        points, values = past.looks.of(update, now)
        then = _with_values(now, points, values)
        back, photos = _chosen(now, then, cells_around(points), compared, rules)
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


def _chosen(now: VoxelField, then: VoxelField, cells: np.ndarray, compared: ComparedPhotos,
            rules: TurnRules) -> tuple[np.ndarray, np.ndarray]:
    """Return which cells are as they were, bool (X, Y, Z), and how many photos say so, int32."""
    nothing = np.zeros(now.shape, bool), np.zeros(now.shape, np.int32)
    reached = ChangedSpace(cells, []).reached_by(now, compared, BakingRules.one_surface,
                                                 compared.old, rules.every)
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
    votes = CellVotes(now, 3, rules.thick)
    for shown in shown_twice(now, then, reached, compared):
        like_now, like_then = (
            shown.off[1 - kind] - shown.off[kind] > rules.grey_levels / 255 for kind in (0, 1))
        against = like_then & compared.contradicts[shown.index][shown.pixels]
        for kind, (chosen, view) in enumerate(zip((like_now, like_then, against), (0, 1, 1))):
            votes.add(shown, kind, chosen, shown.first, shown.views[view].depth)
    return votes.counts


def _compared_anew(field: VoxelField, compared: ComparedPhotos, space: ChangedSpace
                   ) -> ComparedPhotos:
    """
    Compare with the field what new photos show of surfaces that are, or were, in turned cells.

    What lies behind them is left to the memory, which may differ from the field.
    """
    photos = compared.photos
    contradicts, agrees, depth = (one.copy() for one in (
        compared.contradicts, compared.agrees, compared.depth))
    reached = space.reached_by(field, compared, BakingRules.one_surface, compared.old)
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
