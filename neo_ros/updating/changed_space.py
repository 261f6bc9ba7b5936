"""Where a scene has changed: cells of the field that photos contradict."""
from dataclasses import dataclass, replace
from functools import cached_property
import math

import cv2
from neo_ros.errors import BagError
from neo_ros.field.grid_points import cells_apart
from neo_ros.field.rendering import world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.updating.compared_photos import ComparedPhotos, WitnessRules
from neo_ros.updating.kernels import compare_depths, count_votes, pinholes, rays_meet_cells
import numpy as np
from scipy import ndimage


@dataclass(frozen=True)
class ChangeRules:
    """How many photos have to say so; metres."""

    # Photos that contradict what was seen through a cell, or at it, and their share of all that
    # see it: what is new in front of a wall of its own colour is no contradiction.
    least_photos: int = 3
    least_share: float = 0.5
    # From one side all of them may be wrong for one reason; they look from so far apart, degrees.
    least_angle_deg: float = 5.0
    # Where a larger share of the photos that it was made of contradict the memory, it is poor.
    most_own_share: float = 0.2
    # What was seen hides what is behind it: the back of a chair that left is not there either.
    behind: float = 0.4
    # A picture was changed, not a thing, where photos agree upon what they show at the surface
    # that was there as well as anywhere before it, or so many metres behind it, but for so many
    # grey levels; of a window, a share of an image's height wide, no more may be otherwise.
    # So many other photos are asked, evenly chosen; so many have to see it, and a difference
    # counts no more than that.
    way_behind: float = 1.5
    grey_levels: float = 10.0
    window: float = 1 / 4
    most_otherwise: float = 0.25
    most_asked: int = 60
    least_asked: int = 3
    most_grey_levels: float = 60.0
    # Then only so many voxels before the surface may change, a third of that behind it: all that
    # see it from one side would have the fit hang it up somewhere before it.
    thick: float = 1.5
    # Where the camera itself was, there is air.
    around_camera: float = 0.3
    # In another light no more of what photos show may look painted anew: by lamps alone 10 % of
    # the demo flat do, in the sun 2 %, as much as where furniture and pictures were moved.
    most_in_other_light: float = 0.05
    # Cells that hang together, at least; and how far around them may change, too, cells.
    least_cells: int = 12
    margin: int = 1


@dataclass(frozen=True, eq=False)
class ChangedPlace:
    """
    Cells that hang together: their indices (M, 3), corners of their box (3,), metres.

    photos: that say so.
    """

    cells: np.ndarray
    low: np.ndarray
    high: np.ndarray
    photos: int


@dataclass(frozen=True, eq=False)
class ChangedSpace:
    """Cells of a field, bool (X, Y, Z), that may change, and the places they make up."""

    cells: np.ndarray
    places: list[ChangedPlace]

    def met_by(self, field: VoxelField, origin: np.ndarray, rays_d: np.ndarray,
               reach: np.ndarray) -> np.ndarray:
        """
        Tell which unit rays (..., 3) from one point (3,) meet it: bool (...).

        reach float32 (...): metres along the ray to what hides the rest, 0 = nothing does.
        """
        return rays_meet_cells(field, self._apart, origin, rays_d, reach)

    @cached_property
    def _apart(self) -> np.ndarray:
        return cells_apart(self.cells)

    def reached_by(self, field: VoxelField, compared: ComparedPhotos, beyond: float,
                   first: int = 0, every: int = 1) -> np.ndarray:
        """
        Tell which usable, or stale, pixels of photos see it: bool (N, h, w).

        As far as a surface, and a share `beyond` of its distance behind it. Asked are photos from
        number `first` on, and of their rows and columns one in `every`.
        """
        photos = compared.photos
        assert photos.usable is not None
        reached = np.zeros(photos.usable.shape, bool)
        some = slice(None, None, every), slice(None, None, every)
        for index in range(first, len(reached)):
            origin, rays = world_rays(photos.intrinsics, compared.pose(index))
            reached[index][some] = (
                photos.usable[index] | compared.stale[index])[some] & self.met_by(
                    field, origin, rays[some], (1 + beyond) * compared.depth[index][some])
        return reached

    def joined(self, other: 'ChangedSpace') -> 'ChangedSpace':
        """Return this and another one; its own places are the first."""
        return ChangedSpace(self.cells | other.cells, [*self.places, *other.places])

    def holds(self, field: VoxelField, points: np.ndarray) -> np.ndarray:
        """Tell which world points (N, 3) lie in it: bool (N,)."""
        return self.cells[tuple(field.cells_at(points).T)]


def find_changed_space(field: VoxelField, compared: ComparedPhotos,
                       rules: ChangeRules = ChangeRules(), other_light: bool = False
                       ) -> ChangedSpace:
    """
    Let the new photos vote on every cell of the field, and then those it was made of.

    other_light: the new ones were taken in another light than the scene's. A surface that looks
    otherwise has not changed then: the evening would overwrite the noon. Raises BagError where
    too many do.
    """
    photos, painted = np.zeros(field.shape, np.int32), np.zeros_like(compared.contradicts)
    for plane in range(field.shape[0] - 1):  # One by one: positions are float64.
        index = np.moveaxis(np.indices((1, *(size - 1 for size in field.shape[1:]))), 0, -1)
        _count(field, index.reshape(-1, 3) + [plane, 0, 0], compared, painted, rules, photos)
    painted = painted_anew(field, compared, photos > 0, rules)
    if other_light:
        new = slice(compared.old, None)
        share = painted[new].sum() / max(1, (compared.depth[new] > 0).sum())
        if share > rules.most_in_other_light:
            raise BagError(f'taken in another light than the scene, by which {share:.0%} of what '
                           'the images show looks otherwise: what has changed cannot be told; '
                           'give bags in the light of its photos')
        compared = replace(compared, contradicts=compared.contradicts & ~painted)
    _count(field, np.argwhere(photos > 0), compared, painted, rules, photos)
    changed = photos > 0
    cells = np.argwhere(changed)
    against, agree, _ = _vote(field, cells, compared, np.flatnonzero(compared.founders), painted,
                              rules)
    poor = against > rules.most_own_share * (against + agree)
    points = field.world_points(cells + 0.5)
    for position in compared.photos.T_world_cam[compared.old:, :3, 3]:
        poor |= np.linalg.norm(points - position, axis=1) < rules.around_camera
    changed[tuple(cells[poor].T)] = False
    return space_of(field, changed, photos, rules, rules.margin)


def painted_anew(field: VoxelField, compared: ComparedPhotos, cells: np.ndarray,
                 rules: ChangeRules = ChangeRules()) -> np.ndarray:
    """
    Tell where new photos show another picture on a surface that is still there: bool (N, h, w).

    cells bool (X, Y, Z): where a thing may be instead.
    """
    photos, camera = compared.photos, compared.photos.intrinsics
    count, painted = len(photos.images), np.zeros_like(compared.contradicts)
    asked = np.arange(compared.old, count, max(1, -(-(count - compared.old) // rules.most_asked)))
    cameras = pinholes(camera, photos.T_world_cam[asked])
    of_asked = [one[asked] for one in (
        compared.depth, compared.contradicts, photos.images, compared.gains)]
    window = 2 * (int(rules.window * camera.height) // 2) + 1  # One pixel is in the middle.
    for index in range(compared.old, count):
        off = compared.contradicts[index]
        if not off.any():
            continue
        origin, rays = world_rays(camera, compared.pose(index))
        at_surface, elsewhere = np.empty((2, int(off.sum())), np.float32)
        compare_depths(
            np.asarray(origin, np.float64), np.ascontiguousarray(rays[off], np.float32),
            compared.depth[index][off],
            (photos.images[index] * compared.gains[index])[off].astype(np.float32),
            int(np.searchsorted(asked, index)) if index in asked else -1, cameras, *of_asked,
            field.box, np.array(field.shape), cells.ravel().view(np.uint8), field.near,
            rules.way_behind, rules.thick * field.voxel, np.float32(WitnessRules.one_surface),
            rules.least_asked, rules.most_grey_levels, at_surface, elsewhere)
        otherwise = np.zeros(off.shape, np.float32)
        otherwise[off] = (at_surface < 0) | (at_surface - elsewhere > rules.grey_levels)
        of_window, all_of_it = (cv2.boxFilter(one, -1, (window, window), normalize=False) for one
                                in (otherwise, off.astype(np.float32)))
        painted[index] = off & (of_window <= rules.most_otherwise * all_of_it)
    return painted


def _count(field: VoxelField, cells: np.ndarray, compared: ComparedPhotos, painted: np.ndarray,
           rules: ChangeRules, photos: np.ndarray) -> None:
    """Note in `photos`, int32 (X, Y, Z), how many new ones contradict cells (M, 3); 0: too few."""
    against, agree, cosine = _vote(field, cells, compared, slice(compared.old, None), painted,
                                   rules)
    photos[tuple(cells.T)] = np.where(
        (against >= rules.least_photos) & (against >= rules.least_share * (against + agree))
        & (cosine <= math.cos(math.radians(rules.least_angle_deg))), against, 0)


def _vote(field: VoxelField, cells: np.ndarray, compared: ComparedPhotos,
          photos: slice | np.ndarray, painted: np.ndarray, rules: ChangeRules
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what `count_votes` says of cells (M, 3): against, agree, cosine (M,)."""
    points = field.world_points(cells + 0.5).astype(np.float32)
    against, agree = np.zeros((2, len(points)), np.int32)
    cosine = np.ones(len(points), np.float32)
    count_votes(points, pinholes(compared.photos.intrinsics, compared.photos.T_world_cam[photos]),
                compared.depth[photos], compared.contradicts[photos], compared.agrees[photos],
                painted[photos], np.float32(rules.behind), np.float32(rules.thick * field.voxel),
                against, agree, cosine)
    return against, agree, cosine


def space_of(field: VoxelField, changed: np.ndarray, photos: np.ndarray, rules: ChangeRules,
             margin: int) -> ChangedSpace:
    """
    Return cells bool (X, Y, Z) that hang together, and so many around them.

    photos int32 (X, Y, Z): how many of them say so.
    """
    labels, _ = ndimage.label(changed, np.ones((3, 3, 3)))
    places = []
    for number, box in enumerate(ndimage.find_objects(labels), 1):
        mine = labels[box] == number
        if mine.sum() < rules.least_cells:
            continue
        low, high = (np.array([getattr(part, end) for part in box]) for end in ('start', 'stop'))
        places.append(ChangedPlace(np.argwhere(mine) + low, field.world_points(low),
                                   field.world_points(high), int(photos[box][mine].max())))
    places.sort(key=lambda place: -len(place.cells))
    return around(field, places, margin)


def around(field: VoxelField, places: list[ChangedPlace], margin: int) -> ChangedSpace:
    """Return the cells of places, and so many around them."""
    cells = np.zeros(field.shape, bool)
    for place in places:
        cells[tuple(place.cells.T)] = True
    if places and margin:
        cells = ndimage.binary_dilation(cells, np.ones((3, 3, 3)), iterations=margin)
        cells[-1], cells[:, -1], cells[:, :, -1] = False, False, False  # There are no cells.
    return ChangedSpace(cells, places)
