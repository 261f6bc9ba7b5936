"""Where a scene has changed: cells of the field that photos contradict."""
from dataclasses import dataclass
import math

from neo_ros.field.rendering import world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.updating.compared_photos import ComparedPhotos
from neo_ros.updating.kernels import count_votes, pinholes, rays_meet_cells
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
    # Where the camera itself was, there is air.
    around_camera: float = 0.3
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
        return rays_meet_cells(field, self.cells, origin, rays_d, reach)

    def reached_by(self, field: VoxelField, compared: ComparedPhotos, beyond: float
                   ) -> np.ndarray:
        """
        Tell which usable, or stale, pixels of photos see it: bool (N, h, w).

        As far as a surface, and a share `beyond` of its distance behind it.
        """
        photos = compared.photos
        assert photos.usable is not None
        reached = np.zeros(photos.usable.shape, bool)
        for index in range(len(reached)):
            reached[index] = (photos.usable[index] | compared.stale[index]) & self.met_by(
                field, *world_rays(photos.intrinsics, compared.pose(index)),
                (1 + beyond) * compared.depth[index])
        return reached

    def holds(self, field: VoxelField, points: np.ndarray) -> np.ndarray:
        """Tell which world points (N, 3) lie in it: bool (N,)."""
        return self.cells[tuple(field.cells_at(points).T)]


def find_changed_space(field: VoxelField, compared: ComparedPhotos,
                       rules: ChangeRules = ChangeRules()) -> ChangedSpace:
    """Let the new photos vote on every cell of the field, and then those it was made of."""
    new = slice(compared.old, None)
    photos = np.zeros(field.shape, np.int32)
    changed = np.zeros(field.shape, bool)
    for plane in range(field.shape[0] - 1):  # One by one: positions are float64.
        index = np.moveaxis(np.indices((1, *(size - 1 for size in field.shape[1:]))), 0, -1)
        against, agree, cosine = _vote(field, index + [plane, 0, 0], compared, new, rules)
        changed[plane, :-1, :-1] = (against >= rules.least_photos) & (
            against >= rules.least_share * (against + agree)) & (
            cosine <= math.cos(math.radians(rules.least_angle_deg)))
        photos[plane, :-1, :-1] = against
    index = np.argwhere(changed)
    against, agree, _ = _vote(field, index, compared, np.flatnonzero(compared.founders), rules)
    poor = against > rules.most_own_share * (against + agree)
    points = field.world_points(index + 0.5)
    for position in compared.photos.T_world_cam[new, :3, 3]:
        poor |= np.linalg.norm(points - position, axis=1) < rules.around_camera
    changed[tuple(index[poor].T)] = False
    return space_of(field, changed, photos, rules, rules.margin)


def _vote(field: VoxelField, index: np.ndarray, compared: ComparedPhotos,
          photos: slice | np.ndarray, rules: ChangeRules
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what `count_votes` says of cells (..., 3): against, agree, cosine (...)."""
    lead = index.shape[:-1]
    points = field.world_points(index + 0.5).reshape(-1, 3).astype(np.float32)
    against, agree = np.zeros((2, len(points)), np.int32)
    cosine = np.ones(len(points), np.float32)
    count_votes(points, pinholes(compared.photos.intrinsics, compared.photos.T_world_cam[photos]),
                compared.depth[photos], compared.contradicts[photos], compared.agrees[photos],
                np.float32(rules.behind), against, agree, cosine)
    return against.reshape(lead), agree.reshape(lead), cosine.reshape(lead)


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
