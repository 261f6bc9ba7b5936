"""Step 2 of the paper: poses where the robot can be, in groups that share one position."""
from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Literal

from neo_ros.errors import ConfigError
from neo_ros.geometry import CameraPose
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.storeys import storey_borders
from neo_ros.scenes.walkable import WalkableMap
import numpy as np


# Metres between grid positions in the paper: section 4.1 (best of 0.05 to 1.0), section 4.2.
FLOOR_INTERVAL, PHOTOS_INTERVAL = 0.05, 0.2
# Of a grid, before what is not free is left out; to look at so many takes 6 GB.
MOST_PLACES = 100_000_000
# Means and deviations of pitch and roll, radians, of a camera that is mounted level.
LEVEL = (0.0, 0.0), (0.0, 0.0)
# Its poses are off by less than so many radians.
LEAST_TILT = math.radians(1.0)


@dataclass(frozen=True)
class SamplingConfig:
    """Where wide training views are rendered."""

    __pydantic_config__ = {'extra': 'forbid'}
    # walkable: the scene's floor map; free_space: floor that the photos saw free; photos: as a
    # hand holds a camera, around the photos; auto: walkable where there is a map, else photos
    area: Literal['auto', 'walkable', 'free_space', 'photos'] = 'auto'
    # metres between grid positions; default: 0.05 on a floor, 0.2 around photos
    interval: float | None = None
    yaws: int = 72           # headings at a position on the floor, evenly spaced; 0 = any
    robot_radius: float = 0.2  # metres that the camera keeps off the edge of free floor
    camera_height: float | None = None  # z of the camera; default: the map's or the photos'
    radius: float = 0.3      # metres around the photos that a hand-held camera can be
    positions: int = 1000    # positions to render, drawn from the grid
    sharp_only: bool | None = None  # draw blurred views again; default: for `photos` only

    def __post_init__(self) -> None:
        if not ((self.interval is None or 0 < self.interval < math.inf)
                and 0 < self.radius < math.inf and self.positions > 0):
            raise ConfigError(
                'sampling: expected finite interval, radius and positions > 0, got '
                f'{self.interval}, {self.radius}, {self.positions}')
        if not (self.yaws >= 0 and self.robot_radius >= 0):
            raise ConfigError('sampling: expected yaws and robot_radius >= 0, got '
                              f'{self.yaws}, {self.robot_radius}')
        if self.camera_height is not None and not math.isfinite(self.camera_height):
            raise ConfigError('sampling.camera_height: expected metres, got '
                              f'{self.camera_height}')


@dataclass(frozen=True, eq=False)
class PoseSampler:
    """
    Positions in the world with the orientations that a camera takes there.

    positions_xy   (M, 2) metres
    yaw_range      (low, width) radians: yaw is uniform in low ... low + width
    pitch_roll     means and standard deviations ((pitch, roll), (pitch, roll)), radians
    height         mean and standard deviation of z, metres
    rise           (M,) metres that positions are higher: on other storeys; None: on none
    deviation      (M,) standard deviations of z around these heights; None: as `height` says
    yaws           headings at one position, evenly spaced over the range; 0 = any
    floor          the free floor that the positions lie on, where they lie on one
    """

    positions_xy: np.ndarray
    yaw_range: tuple[float, float]
    pitch_roll: tuple[tuple[float, float], tuple[float, float]]
    height: tuple[float, float]
    yaws: int = 0
    floor: WalkableMap | None = None
    rise: np.ndarray | None = None
    deviation: np.ndarray | None = None

    def __post_init__(self) -> None:
        if not len(self.positions_xy):
            raise ConfigError('sampling.interval: expected a grid with positions where the camera '
                              'can be, got none; choose a smaller interval')

    @classmethod
    def for_walkable(cls, walkable: WalkableMap, config: SamplingConfig,
                     upper: Sequence[WalkableMap] = (), photos: PosedImages | None = None
                     ) -> 'PoseSampler':
        """
        3-DoF (section 4.1): a grid over the free floor, fixed height, yaws all around.

        upper: the maps of other storeys. photos: of the camera, which may be mounted tilted or
        upside down: pitch and roll are those of `around_photos`. Without photos, and where all
        of them are level, views are level as in the paper.
        """
        grids = [_grid_over(floor.kept_off(config.robot_radius), config)
                 for floor in (walkable, *upper)]
        height = (walkable.camera_height if config.camera_height is None
                  else config.camera_height)
        rise = np.repeat([floor.camera_height - walkable.camera_height
                          for floor in (walkable, *upper)], [len(grid) for grid in grids])
        pitch_roll = LEVEL if photos is None else _tilt(_angles(photos))
        if np.abs(pitch_roll).max() < LEAST_TILT:
            pitch_roll = LEVEL
        return cls(np.concatenate(grids), (-math.pi, 2 * math.pi), pitch_roll, (height, 0.0),
                   config.yaws, walkable, rise if upper else None)

    @classmethod
    def around_photos(cls, photos: PosedImages, config: SamplingConfig) -> 'PoseSampler':
        """
        6-DoF (section 4.2): a horizontal grid within `radius` of the photos.

        Yaw is uniform between the photos' bounds; height, pitch and roll are Gaussian with the
        photos' mean and deviation. On several storeys there is a grid for each, with the height
        of its own photos: between them is a ceiling. The world's z axis must point up.
        """
        interval = PHOTOS_INTERVAL if config.interval is None else config.interval
        T = photos.T_world_cam
        xy = T[:, :2, 3]
        low, high = xy.min(0) - config.radius, xy.max(0) + config.radius
        _check_grid(high - low, interval)
        axes = [np.arange(a, b + interval, interval) for a, b in zip(low, high)]
        mean, std = float(T[:, 2, 3].mean()), float(T[:, 2, 3].std())
        storey_of = np.searchsorted(storey_borders(T[:, 2, 3]), T[:, 2, 3])
        grids, rise, deviation = [], [], []
        for storey in np.unique(storey_of):
            own = T[storey_of == storey, :3, 3]
            grids.append(_grid_around(own[:, :2], axes, interval, config.radius))
            rise.append(np.full(len(grids[-1]), own[:, 2].mean() - mean))
            deviation.append(np.full(len(grids[-1]), own[:, 2].std()))
        heights = ((np.concatenate(rise), np.concatenate(deviation)) if len(grids) > 1
                   else (None, None))
        angles = _angles(photos)
        return cls(np.concatenate(grids), _yaw_bounds(angles[:, 0]), _tilt(angles), (mean, std),
                   0, None, *heights)

    def draw_position(self, random: np.random.Generator) -> np.ndarray:
        """Draw one position, (3,) metres."""
        index = random.integers(len(self.positions_xy))
        x, y = self.positions_xy[index]
        rise = 0.0 if self.rise is None else self.rise[index]
        mean, deviation = self.height
        if self.deviation is not None:
            deviation = self.deviation[index]
        return np.array([x, y, random.normal(mean, deviation) + rise])

    def places(self) -> np.ndarray:
        """Return all positions at their mean heights, (M, 3) metres."""
        z = np.full(len(self.positions_xy), self.height[0])
        return np.column_stack([self.positions_xy, z if self.rise is None else z + self.rise])

    def draw_rotation(self, random: np.random.Generator, place: int = 0) -> np.ndarray:
        """Draw one camera-to-world rotation (3, 3) at place number `place`, OpenCV axes."""
        share = random.random()
        if self.yaws:
            # Each place is turned against the last (golden ratio): together they look everywhere.
            share = (math.floor(share * self.yaws) + 0.618034 * place % 1) / self.yaws
        yaw = self.yaw_range[0] + self.yaw_range[1] * share
        pitch, roll = random.normal(*self.pitch_roll)
        return rotation_from_angles(yaw, pitch, roll)


def yaw_pitch_roll(R_world_cam: np.ndarray) -> tuple[float, float, float]:
    """
    Angles of a camera in a z-up world, radians.

    Yaw is the heading of the optical axis (0 = +x, counter-clockwise), pitch is positive looking
    up, roll is positive when the image's right side dips.
    """
    forward, right = R_world_cam[:, 2], R_world_cam[:, 0]
    yaw = math.atan2(forward[1], forward[0])
    pitch = math.asin(float(np.clip(forward[2], -1, 1)))
    level = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    down = np.cross(forward, level)
    return yaw, pitch, math.atan2(float(right @ down), float(right @ level))


def rotation_from_angles(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """Return the camera-to-world rotation (3, 3) of `yaw_pitch_roll` angles."""
    forward = np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch),
                        math.sin(pitch)])
    level = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    down = np.cross(forward, level)
    right = math.cos(roll) * level + math.sin(roll) * down
    return CameraPose(np.block([
        [np.stack([right, np.cross(forward, right), forward], axis=1), np.zeros((3, 1))],
        [np.array([[0, 0, 0, 1.0]])]])).T_world_cam[:3, :3]


def _angles(photos: PosedImages) -> np.ndarray:
    """Return yaw, pitch and roll of photos, (N, 3) radians."""
    return np.array([yaw_pitch_roll(matrix[:3, :3]) for matrix in photos.T_world_cam])


def _tilt(angles: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return means and deviations of pitch and roll, as a sampler has them; angles (N, 3)."""
    # On the circle: a camera mounted upside down has rolls around +-pi.
    mean = np.angle(np.exp(1j * angles[:, 1:]).mean(0))
    deviation = np.angle(np.exp(1j * (angles[:, 1:] - mean))).std(0)
    return tuple(mean), tuple(deviation)


def _grid_around(photos: np.ndarray, axes: Sequence[np.ndarray], interval: float, radius: float
                 ) -> np.ndarray:
    """Return the places of a grid of x and y, its axes, near photos (N, 2): (M, 2) metres."""
    near = np.zeros((len(axes[1]), len(axes[0])), bool)
    for photo in photos:  # each looks at the part of the grid around it
        across, along = (slice(max(int((at - axis[0] - radius) / interval), 0),
                               int((at - axis[0] + radius) / interval) + 2)
                         for at, axis in zip(photo, axes))
        around = np.stack(np.meshgrid(axes[0][across], axes[1][along]), axis=-1)
        near[along, across] |= np.linalg.norm(photo - around, axis=-1) <= radius
    rows, columns = np.nonzero(near)
    return np.column_stack([axes[0][columns], axes[1][rows]])


def _grid_over(floor: WalkableMap, config: SamplingConfig) -> np.ndarray:
    """Return the places of a grid that are on free floor, (M, 2) metres."""
    interval = FLOOR_INTERVAL if config.interval is None else config.interval
    centres = floor.centres()
    _check_grid(np.ptp(centres, axis=0), interval)
    low, steps = centres.min(0), np.ptp(centres, axis=0) / interval
    axes = [start + interval * np.arange(int(count + 1e-6) + 1)
            for start, count in zip(low, steps)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return grid[floor.contains(grid)]


def _check_grid(extent: np.ndarray, interval: float) -> None:
    """Raise ConfigError where a grid over an extent (2,), metres, has too many places."""
    width, height = extent.tolist()
    places = (width / interval + 1) * (height / interval + 1)
    if places > MOST_PLACES:
        raise ConfigError(
            f'sampling.interval: expected a grid of at most {MOST_PLACES:.0e} places, got '
            f'{places:.0e} of {interval} m over {width:.0f} x {height:.0f} m; choose a larger '
            'interval')


def _yaw_bounds(yaws: np.ndarray) -> tuple[float, float]:
    """Return (low, width) of the shortest arc that holds all yaws, whatever the wrap-around."""
    ordered = np.sort(np.mod(yaws, 2 * math.pi))
    gaps = np.diff(np.append(ordered, ordered[0] + 2 * math.pi))
    widest = int(gaps.argmax())
    low = ordered[(widest + 1) % len(ordered)]
    return float(low), float(2 * math.pi - gaps[widest])
