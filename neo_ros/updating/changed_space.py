"""Where a scene has changed: cells of the field that images contradict."""
from dataclasses import dataclass

from neo_ros.field.voxel_field import VoxelField
from neo_ros.updating.driven_photos import Drive
from neo_ros.updating.kernels import count_votes, rays_meet
import numpy as np
from scipy import ndimage


@dataclass(frozen=True)
class ChangeRules:
    """How many images have to say so; metres."""

    # Images that contradict what was seen through a cell, or at it, and their share of all that
    # see it: what is new in front of a wall of its own colour is no contradiction.
    least_images: int = 3
    least_share: float = 0.6
    # What was seen hides what is behind it: the back of a chair that left is not there either.
    behind: float = 0.4
    # Where the camera itself was, there is air.
    around_camera: float = 0.3
    # Cells that hang together, at least; and how far around them may change, too, cells.
    least_cells: int = 12
    margin: int = 1
    # Where the photos that the memory was made of contradict it by a larger share, it is poor.
    most_own_share: float = 0.2


@dataclass(frozen=True, eq=False)
class ChangedPlace:
    """
    Cells that hang together: their indices (N, 3), corners of their box (3,), metres.

    images: that say so.
    """

    cells: np.ndarray
    low: np.ndarray
    high: np.ndarray
    images: int


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
        met = np.empty(reach.size, np.uint8)
        rays_meet(np.asarray(origin, np.float64),
                  np.ascontiguousarray(rays_d.reshape(-1, 3), np.float32),
                  np.where(reach > 0, reach, np.inf).ravel().astype(np.float32), field.box,
                  np.array(field.shape), self.cells.ravel().view(np.uint8), field.near, met)
        return met.reshape(reach.shape).view(bool)

    def holds(self, field: VoxelField, points: np.ndarray) -> np.ndarray:
        """Tell which world points (N, 3) lie in it: bool (N,)."""
        size = np.array(field.shape)
        place = (field.grid_position(points) + 1) / 2 * (size - 1)
        return self.cells[tuple(np.clip(place.astype(int), 0, size - 2).T)]


def find_changed_space(field: VoxelField, drive: Drive, rules: ChangeRules = ChangeRules()
                       ) -> ChangedSpace:
    """Let the photos of a drive vote on every cell of the field."""
    against = np.zeros(field.shape, np.int32)
    agree = np.zeros(field.shape, np.int32)
    for plane in range(field.shape[0] - 1):  # One by one: positions are float64.
        index = np.moveaxis(np.indices((1, *field.shape[1:])), 0, -1) + [plane, 0, 0]
        points = field.world_points(index + 0.5).reshape(-1, 3).astype(np.float32)
        _vote(points, drive, field.voxel, rules, against[plane].reshape(-1),
              agree[plane].reshape(-1))
    changed = (against >= rules.least_images) & (
        against >= rules.least_share * (against + agree))
    changed[-1], changed[:, -1], changed[:, :, -1] = False, False, False  # There are no cells.
    positions = np.stack([photo.pose.position for photo in drive.photos])
    return _of_places(field, changed, against, positions, rules)


def without_poor_places(space: ChangedSpace, field: VoxelField, own: Drive,
                        rules: ChangeRules = ChangeRules()) -> ChangedSpace:
    """Leave out places where photos of before contradict the memory, too: own compares them."""
    stay = []
    for place in space.places:
        points = field.world_points(place.cells + 0.5).astype(np.float32)
        against, agree = np.zeros((2, len(points)), np.int32)
        _vote(points, own, field.voxel, rules, against, agree)
        if against.sum() <= rules.most_own_share * (against.sum() + agree.sum()):
            stay.append(place)
    return _space(field, stay, rules)


def _vote(points: np.ndarray, drive: Drive, voxel: float, rules: ChangeRules,
          against: np.ndarray, agree: np.ndarray) -> None:
    T = np.stack([photo.pose.T_world_cam for photo in drive.photos])
    depth, off = (np.stack([getattr(photo, name) for photo in drive.photos])
                  for name in ('depth', 'off'))
    camera = drive.small_camera
    count_votes(points, np.ascontiguousarray(T[:, :3, :3], np.float32),
                np.ascontiguousarray(T[:, :3, 3], np.float32),
                tuple(map(np.float32, (camera.fx, camera.fy, camera.cx, camera.cy))),
                depth, off, np.float32(voxel), np.float32(rules.behind), against, agree)


def _space(field: VoxelField, places: list[ChangedPlace], rules: ChangeRules) -> ChangedSpace:
    cells = np.zeros(field.shape, bool)
    for place in places:
        cells[tuple(place.cells.T)] = True
    if places and rules.margin:
        cells = ndimage.binary_dilation(cells, np.ones((3, 3, 3)), iterations=rules.margin)
    return ChangedSpace(cells, places)


def _of_places(field: VoxelField, changed: np.ndarray, against: np.ndarray,
               positions: np.ndarray, rules: ChangeRules) -> ChangedSpace:
    index = np.argwhere(changed)
    for position in positions:
        near = np.linalg.norm(field.world_points(index + 0.5) - position, axis=1)
        changed[tuple(index[near < rules.around_camera].T)] = False
        index = index[near >= rules.around_camera]
    labels, _ = ndimage.label(changed, np.ones((3, 3, 3)))
    places = []
    for number, box in enumerate(ndimage.find_objects(labels), 1):
        mine = labels[box] == number
        if mine.sum() < rules.least_cells:
            continue
        low, high = (np.array([getattr(part, end) for part in box]) for end in ('start', 'stop'))
        places.append(ChangedPlace(
            np.argwhere(mine) + low, field.world_points(low), field.world_points(high),
            int(against[box][mine].max())))
    places.sort(key=lambda place: -float(np.prod(place.high - place.low)))
    return _space(field, places, rules)
