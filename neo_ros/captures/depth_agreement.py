"""Does measured depth fit the poses? It is compared with points that pairs of photos show."""
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
from neo_ros.captures.depth_writing import OPTION
from neo_ros.captures.report_measures import apart
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.machine.evenly import evenly
from neo_ros.pictures.depth import MM_PER_M, read_depth
from neo_ros.scenes.posed_images import PosedImages
import numpy as np

# Photos that are looked at, and which of the nearest others each is compared with.
PHOTOS, PARTNERS = 24, (1, 3, 7)
FEATURES = 2000
# Of the best to the second distance of descriptors.
RATIO = 0.8
# Pixels off its epipolar line; radians between viewing directions, and between the rays of a
# point that is triangulated.
OFF_LINE, MOST_TURNED, LEAST_PARALLAX = 1.5, 0.6, 0.03
# Points without which nothing is said; the share around the middle that agrees.
LEAST_POINTS, CLOSE = 50, 0.05
# Depth and poses of one unit do not differ by more, however bad both are.
MOST_APART = 1.5


class Agreement(NamedTuple):
    """
    How depth lies to triangulated points.

    ratio  the median of measured depth over the poses' own
    close  share of the points whose ratio is within CLOSE of that median
    """

    points: int
    ratio: float
    close: float


def measure_agreement(photos: PosedImages) -> Agreement | None:
    """Triangulate what pairs of photos show and compare; None where there are too few points."""
    having = [index for index, path in enumerate(photos.depth_paths) if path is not None]
    if not having:
        return None
    chosen = evenly(len(having), PHOTOS)
    camera, sift = photos.intrinsics, cv2.SIFT.create(FEATURES)
    features: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def found(index: int) -> tuple[np.ndarray, np.ndarray]:
        if index not in features:
            grey = cv2.cvtColor(photos.read_image(index), cv2.COLOR_RGB2GRAY)
            keypoints, descriptors = sift.detectAndCompute(grey, None)
            features[index] = (np.array([one.pt for one in keypoints]).reshape(-1, 2) + 0.5,
                               np.zeros((0, 128), np.float32) if descriptors is None
                               else descriptors)
        return features[index]

    ratios = []
    for index in (having[place] for place in chosen):
        depth = read_depth(photos.depth_paths[index], camera.width, camera.height) / MM_PER_M
        for other in _partners(photos.T_world_cam, index):
            pixels, z = _triangulated(camera, np.linalg.inv(photos.T_world_cam[other])
                                      @ photos.T_world_cam[index], found(index), found(other))
            column, row = np.minimum(pixels.astype(int), (camera.width - 1, camera.height - 1)).T
            measured = depth[row, column]
            ratios.append(measured[measured > 0] / z[measured > 0])
    every = np.concatenate(ratios) if ratios else np.zeros(0)
    if len(every) < LEAST_POINTS:
        return None
    ratio = float(np.median(every))
    return Agreement(len(every), ratio, float((np.abs(every / ratio - 1) < CLOSE).mean()))


def fit_to_depth(photos: PosedImages, unit: float) -> tuple[PosedImages, str]:
    """
    Say how well depth fits the poses; poses of an arbitrary scale are brought to its metres.

    unit: metres of one step of the depth. Raises SceneError where the two have different units.
    """
    found = measure_agreement(photos)
    if found is None:
        return photos, 'depth: not compared with the poses, as too few points can be triangulated'
    close = f'{found.close:.0%} of {found.points} points are within {CLOSE:.0%} of that'
    if photos.arbitrary_scale:
        lengths = np.ones((4, 4))
        lengths[:3, 3] = found.ratio
        poses = tuple(CameraPose(lengths * pose.T_world_cam) for pose in photos.poses)
        return replace(photos, poses=poses, arbitrary_scale=False), (
            f'by the depth the scale is no longer arbitrary: all lengths are multiplied by '
            f'{found.ratio:.4g} to metres; {close}')
    if not 1 / MOST_APART < found.ratio < MOST_APART:
        raise SceneError(
            f'depth: expected the distances that the poses give, got {found.ratio:.4g} times as '
            f'much (median of {found.points} points); if the poses are in metres, import with '
            f'{OPTION} {unit / found.ratio:.4g}, if they are not, with all lengths multiplied: '
            f'--scale {found.ratio:.4g}; {OPTION} 0 leaves the depth out')
    return photos, (f'depth is {found.ratio:.3f} times what the poses give for triangulated '
                    f'points (median); {close}')


def _partners(T_world_cam: np.ndarray, index: int) -> Iterator[int]:
    """Yield photos that look the same way from near by; the unit of lengths does not matter."""
    distance, turned = apart(T_world_cam, T_world_cam[index])
    order = [int(other) for other in np.argsort(distance, kind='stable')
             if turned[other] < MOST_TURNED and distance[other] > 0]
    return (order[place] for place in PARTNERS if place < len(order))


def _triangulated(camera: Intrinsics, T_b_a: np.ndarray, a: tuple[np.ndarray, np.ndarray],
                  b: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (N, 2) of photo a and the depth (N,) there that photo b makes of them."""
    (points_a, looks_a), (points_b, looks_b) = a, b
    if min(len(points_a), len(points_b)) < 2:
        return np.zeros((0, 2)), np.zeros(0)
    pairs = cv2.BFMatcher().knnMatch(looks_a, looks_b, k=2)
    best = [first for first, second in pairs if first.distance < RATIO * second.distance]
    pixels = points_a[[match.queryIdx for match in best]].reshape(-1, 2)
    rays_a = _rays(camera, pixels) @ T_b_a[:3, :3].T
    rays_b = _rays(camera, points_b[[match.trainIdx for match in best]].reshape(-1, 2))
    t = T_b_a[:3, 3]
    # z_a * ray_a + t = z_b * ray_b, in the least squares.
    aa, bb, ab = ((x * y).sum(1) for x, y in (
        (rays_a, rays_a), (rays_b, rays_b), (rays_a, rays_b)))
    at, bt = rays_a @ t, rays_b @ t
    determinant = aa * bb - ab * ab  # squared sine of the parallax, times both lengths
    parallax = determinant > LEAST_PARALLAX ** 2 * aa * bb
    safe = np.where(parallax, determinant, 1)
    z_a, z_b = (ab * bt - bb * at) / safe, (aa * bt - ab * at) / safe
    seen = z_a[:, None] * rays_a + t
    ahead = parallax & (z_a > 0) & (z_b > 0) & (seen[:, 2] > 0)
    off = np.full(len(seen), np.inf)
    off[ahead] = np.linalg.norm(
        camera.project(seen[ahead]) - camera.project(rays_b[ahead]), axis=1)
    kept = off < OFF_LINE
    return pixels[kept], z_a[kept]


def _rays(camera: Intrinsics, pixels: np.ndarray) -> np.ndarray:
    return np.column_stack([(pixels[:, 0] - camera.cx) / camera.fx,
                            (pixels[:, 1] - camera.cy) / camera.fy, np.ones(len(pixels))])
