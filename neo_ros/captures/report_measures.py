"""How good a capture is, from its poses and pixels alone; what depends on depth is an estimate."""
from dataclasses import dataclass

import cv2
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.evenly import evenly
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.sharpness import blur_threshold, relative_sharpness
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
import numpy as np

# Nobody knows the depth before the field is fitted: walls and furniture of a room are about so
# far away. Photos from farther off than this are not counted as seeing the same place.
ASSUMED_DISTANCE = 2.5
MOST_PHOTOS, MOST_VIEWS = 1000, 150
MOST_ALIKE, MOST_NEAR = 50, 300
RAYS = (12, 16)  # rows and columns of the grid of rays that stand for a view
GOOD_OVERLAP = 0.6


@dataclass(frozen=True, eq=False)
class CaptureMeasures:
    """
    What was measured on the photos; arrays are per photo unless stated otherwise.

    overlap         largest share of its view that one other photo saw too
    sharpness       variance of the Laplacian over that of the grey levels, of the photos
                    `measured`
    blur_threshold  sharpness below which a photo counts as blurred, from the photos themselves
    brightness      mean grey level in [0, 1] of the photos `measured`
    viewed          indices of the photos at which the wide view was looked into
    wide_seen       bool (viewed, rows, columns): a photo saw this direction from near by
    walkable_near   share of the walkable area within 1 m of a photo, where there is a map
    """

    photos: PosedImages
    expansion: ViewExpansion
    overlap: np.ndarray
    measured: np.ndarray
    sharpness: np.ndarray
    blur_threshold: float
    brightness: np.ndarray
    viewed: np.ndarray
    wide_seen: np.ndarray
    walkable_near: float | None

    @property
    def blurred(self) -> np.ndarray:
        """Indices of the photos below the threshold."""
        return self.measured[self.sharpness < self.blur_threshold]

    @property
    def exposure_drift(self) -> float:
        """Range of the smoothed brightness over time, relative to its mean (5 to 95 %)."""
        width = max(1, len(self.brightness) // 20)
        smooth = np.convolve(self.brightness, np.ones(width) / width, 'valid')
        low, high = np.percentile(smooth, [5, 95])
        return float((high - low) / max(self.brightness.mean(), 1e-6))

    @property
    def wide_headings(self) -> np.ndarray:
        """Headings in degrees of all rays of `wide_seen` in the world, 0 along +x."""
        T_world_cam = self.photos.T_world_cam[self.viewed]
        world = np.einsum('nij,rj->nri', T_world_cam[:, :3, :3], _rays(self.expansion.target))
        headings = np.degrees(np.arctan2(world[..., 1], world[..., 0]))
        return headings.reshape(self.wide_seen.shape)

    @property
    def beyond_photo(self) -> np.ndarray:
        """Bool (rows, columns): rays of the wide view that lie outside the photo itself."""
        camera = self.photos.intrinsics
        pixels = camera.project(_rays(self.expansion.target)).reshape(*RAYS, 2)
        return ~((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=-1)


def measure_capture(scene: Scene, progress: Progress = no_progress) -> CaptureMeasures:
    """
    Measure the training photos of a scene.

    The wide view is that of the scene's test frames, or twice the photos' width and height. Of
    large captures an even selection is measured. Lengths are taken for metres.
    """
    photos = scene.train
    camera = photos.intrinsics
    expansion = scene.expansion or ViewExpansion.to_twice(camera)
    T_world_cam = photos.T_world_cam
    T_cam_world = np.linalg.inv(T_world_cam)
    measured, viewed = evenly(len(photos), MOST_PHOTOS), evenly(len(photos), MOST_VIEWS)
    steps = len(measured) + len(viewed) + len(photos)
    done = 0
    sharp, bright = np.empty(len(measured)), np.empty(len(measured))
    for place, index in enumerate(measured):
        image = photos.read_image(int(index))
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        sharp[place] = relative_sharpness(image)
        bright[place] = grey.mean() / 255
        progress(done := done + 1, steps)
    overlap = np.zeros(len(photos))
    for index in range(len(photos)):
        others = _alike(T_world_cam, index)
        if len(others):
            seen = _sees(camera, T_cam_world[others], _points(camera, T_world_cam[index]))
            overlap[index] = seen.mean(axis=1).max()
        progress(done := done + 1, steps)
    wide_seen = np.zeros((len(viewed), *RAYS), bool)
    for place, index in enumerate(viewed):
        points = _points(expansion.target, T_world_cam[index])
        near = T_cam_world[_near(T_world_cam, int(index))]
        wide_seen[place] = _sees(camera, near, points).any(axis=0).reshape(RAYS)
        progress(done := done + 1, steps)
    return CaptureMeasures(
        photos, expansion, overlap, measured, sharp, blur_threshold(sharp), bright, viewed,
        wide_seen, _walkable_near(scene))


def apart(T_world_cam: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return how far cameras (N, 4, 4) stand from one (4, 4) and look away from it: metres, radians.

    Both count alike: at the distances of a room they shift the picture about as much.
    """
    distance = np.linalg.norm(T_world_cam[:, :3, 3] - own[:3, 3], axis=1)
    return distance, np.arccos(np.clip(T_world_cam[:, :3, 2] @ own[:3, 2], -1, 1))


def _near(T_world_cam: np.ndarray, index: int) -> np.ndarray:
    """Return the cameras within the assumed distance, nearest first; of many, every n-th."""
    distance = np.linalg.norm(T_world_cam[:, :3, 3] - T_world_cam[index, :3, 3], axis=1)
    near = np.flatnonzero(distance <= ASSUMED_DISTANCE)
    near = near[np.argsort(distance[near], kind='stable')]
    return near[::-(-len(near) // MOST_NEAR)]


def _alike(T_world_cam: np.ndarray, index: int) -> np.ndarray:
    """Return the other cameras that may see the same, by distance and direction."""
    distance, turned = apart(T_world_cam, T_world_cam[index])
    order = np.argsort(np.where(distance <= ASSUMED_DISTANCE, distance + turned, np.inf))
    order = order[:MOST_ALIKE + 1]
    return order[(order != index) & (distance[order] <= ASSUMED_DISTANCE)]


def _rays(camera: Intrinsics) -> np.ndarray:
    """Return the unit rays (rays, 3) of a grid over the view, OpenCV camera axes."""
    rows, columns = RAYS
    x = ((np.arange(columns) + 0.5) / columns * camera.width - camera.cx) / camera.fx
    y = ((np.arange(rows) + 0.5) / rows * camera.height - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones(RAYS)], -1).reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _points(camera: Intrinsics, T_world_cam: np.ndarray) -> np.ndarray:
    """Return the points (rays, 3) of a grid of the view at the assumed distance, in the world."""
    return ASSUMED_DISTANCE * _rays(camera) @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]


def _sees(camera: Intrinsics, T_cam_world: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether each of the cameras (M, 4, 4) has each of the points (P, 3) in its image: (M, P)."""
    R, t = T_cam_world[:, :3, :3], T_cam_world[:, :3, 3]
    seen = points @ R.transpose(0, 2, 1) + t[:, None]
    z = seen[..., 2]
    safe = np.where(z > 0.1, z, 1.0)
    u = camera.fx * seen[..., 0] / safe + camera.cx
    v = camera.fy * seen[..., 1] / safe + camera.cy
    return (z > 0.1) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)


def _walkable_near(scene: Scene) -> float | None:
    if scene.walkable is None:
        return None
    centres = scene.walkable.centres()
    centres = centres[evenly(len(centres), 4000)]
    positions = scene.train.T_world_cam[:, :2, 3]
    nearest = [np.linalg.norm(positions - centre, axis=1).min() for centre in centres]
    return float((np.array(nearest) <= 1.0).mean())
