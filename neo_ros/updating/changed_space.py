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


@dataclass(frozen=True)
class ChangedPlace:
    """Cells that hang together: corners of their box (3,), metres, and images that say so."""

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
    photos, camera = drive.photos, drive.small_camera
    T = np.stack([photo.pose.T_world_cam for photo in photos])
    rotations, positions = T[:, :3, :3].astype(np.float32), T[:, :3, 3].astype(np.float32)
    depth, off = (np.stack([getattr(photo, name) for photo in photos])
                  for name in ('depth', 'off'))
    pinhole = tuple(map(np.float32, (camera.fx, camera.fy, camera.cx, camera.cy)))
    against = np.zeros(field.shape, np.int32)
    agree = np.zeros(field.shape, np.int32)
    for plane in range(field.shape[0] - 1):  # One by one: positions are float64.
        index = np.moveaxis(np.indices((1, *field.shape[1:])), 0, -1) + [plane, 0, 0]
        points = field.world_points(index + 0.5).reshape(-1, 3).astype(np.float32)
        count_votes(points, rotations, positions, pinhole, depth, off, np.float32(field.voxel),
                    np.float32(rules.behind), against[plane].reshape(-1),
                    agree[plane].reshape(-1))
    changed = (against >= rules.least_images) & (
        against >= rules.least_share * (against + agree))
    changed[-1], changed[:, -1], changed[:, :, -1] = False, False, False  # There are no cells.
    return _of_places(field, changed, against, positions, rules)


def _of_places(field: VoxelField, changed: np.ndarray, against: np.ndarray,
               positions: np.ndarray, rules: ChangeRules) -> ChangedSpace:
    index = np.argwhere(changed)
    for position in positions:
        near = np.linalg.norm(field.world_points(index + 0.5) - position, axis=1)
        changed[tuple(index[near < rules.around_camera].T)] = False
        index = index[near >= rules.around_camera]
    labels, count = ndimage.label(changed, np.ones((3, 3, 3)))
    cells, places = np.zeros(field.shape, bool), []
    for number, box in enumerate(ndimage.find_objects(labels), 1):
        mine = labels[box] == number
        if mine.sum() < rules.least_cells:
            continue
        cells[box] |= mine
        low, high = (np.array([getattr(part, end) for part in box]) for end in ('start', 'stop'))
        places.append(ChangedPlace(field.world_points(low), field.world_points(high),
                                   int(against[box][mine].max())))
    if rules.margin:
        cells = ndimage.binary_dilation(cells, np.ones((3, 3, 3)), iterations=rules.margin)
    places.sort(key=lambda place: -float(np.prod(place.high - place.low)))
    return ChangedSpace(cells, places)
