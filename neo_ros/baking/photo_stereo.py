"""
How far away is what photos show: each is compared with those that show the same from beside it.

The matching is OpenCV's, semi-global (Hirschmueller, PAMI 2008); a depth counts where pairs agree.
"""
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import cv2
from neo_ros.baking.sparse_model import SparseModel
from neo_ros.geometry import Intrinsics
import numpy as np


@dataclass(frozen=True)
class PhotoStereoRules:
    """Which photos are compared, at which depths, and which depths are believed."""

    partners: int = 6              # photos that each is compared with, at most
    least_points: int = 15         # of the sparse model, that both have to show
    # Radians between the rays of two photos to a point, in the median. Smaller ones tell no depth,
    # from the second on they tell it well, beyond the third the photos look less alike.
    angles: tuple[float, float, float] = (0.02, 0.12, 0.35)
    # The nearest and the farthest depth that is looked for, of those of the photo's points, but
    # for this share of them.
    nearer: float = 0.7
    farther: float = 2.0
    outliers: float = 0.02
    most_disparities: int = 512    # pixels
    least_ahead: float = 0.3       # cosine of the rays of photos and the axis that pairs share
    same: float = 0.03             # depths of one surface differ by this share at most
    witnesses: int = 2             # pairs that have to agree, where there are as many
    window: int = 5                # pixels across of what is compared
    uniqueness: int = 10           # per cent by which the best disparity has to be the best
    speckle: int = 80              # pixels of one surface, at least


def photo_depths(images: np.ndarray, camera: Intrinsics, T_world_cam: np.ndarray,
                 model: SparseModel, wanted: Iterable[int],
                 rules: PhotoStereoRules = PhotoStereoRules()) -> Iterator[np.ndarray]:
    """
    Yield for each wanted one of photos, uint8 (N, H, W, 3), its depth: float32 (H, W).

    Metres along the optical axis, 0 = unknown. T_world_cam (N, 4, 4); model: points that the
    photos show.
    """
    shown = [np.unique(of[of >= 0]) for of in model.point_of]
    seen_in = _photos_of_points(shown, len(model.points))
    for index in wanted:
        points = model.points[shown[index]]
        z = (points - T_world_cam[index, :3, 3]) @ T_world_cam[index, :3, 2]
        if not (z > 0).any():
            yield np.zeros(images.shape[1:3], np.float32)
            continue
        near, far = np.quantile(z[z > 0], [rules.outliers, 1 - rules.outliers])
        pairs = (pair_depth(images[index], images[other], camera, T_world_cam[index],
                            T_world_cam[other], near * rules.nearer, far * rules.farther, rules)
                 for other in partners_of(index, model.points, shown, seen_in, T_world_cam, rules))
        found = list(islice((pair for pair in pairs if pair is not None), rules.partners))
        yield (agreed_depth(np.stack(found), rules) if found
               else np.zeros(images.shape[1:3], np.float32))


def partners_of(index: int, points: np.ndarray, shown: Sequence[np.ndarray],
                seen_in: Sequence[np.ndarray], T_world_cam: np.ndarray,
                rules: PhotoStereoRules = PhotoStereoRules()) -> list[int]:
    """
    Return the photos that show what one shows, the best to compare it with first.

    points (M, 3); shown: the indices of those in each photo; seen_in: the photos of each point.
    """
    own = shown[index]
    shared = np.bincount(np.concatenate([seen_in[point] for point in own]), minlength=len(shown))
    shared[index] = 0
    scores = []
    for other in np.flatnonzero(shared >= rules.least_points).tolist():
        angle = _median_angle(points[np.intersect1d(own, shown[other])],
                              T_world_cam[index, :3, 3], T_world_cam[other, :3, 3])
        least, good, wide = rules.angles
        if angle >= least:
            scores.append((-shared[other] * min(angle / good, 1.0, wide / angle), other))
    return [other for _, other in sorted(scores)]


def pair_depth(image: np.ndarray, other: np.ndarray, camera: Intrinsics, T: np.ndarray,
               T_other: np.ndarray, near: float, far: float,
               rules: PhotoStereoRules = PhotoStereoRules()) -> np.ndarray | None:
    """
    Return the depth of an image, float32 (H, W), metres along its axis, from one beside it.

    Looked for from `near` to `far`; 0 = unknown. None where the two cannot be brought to one plane
    in which a point lies in the same row of both: the other camera is ahead, not beside.
    """
    step = T_other[:3, 3] - T[:3, 3]
    baseline = float(np.linalg.norm(step))
    across = step / baseline
    ahead = T[:3, 2] + T_other[:3, 2]
    ahead = ahead - across * (across @ ahead)
    ahead /= max(float(np.linalg.norm(ahead)), 1e-9)
    shared = np.stack([across, np.cross(ahead, across), ahead])
    to_shared, other_to_shared = shared @ T[:3, :3], shared @ T_other[:3, :3]
    own, beside = (_extent(camera, R, rules.least_ahead) for R in (to_shared, other_to_shared))
    if own is None or beside is None:
        return None
    focal = camera.fx
    first = focal * baseline / far
    # OpenCV counts disparities by sixteen.
    count = 16 * int(np.ceil(min(focal * baseline / near - first, rules.most_disparities) / 16))
    # A pixel of the image is looked for so many pixels to its left, and at most `count` more.
    left, right = own[0, 0] - count / focal, own[1, 0]
    top, bottom = max(own[0, 1], beside[0, 1]), min(own[1, 1], beside[1, 1])
    width, height = int((right - left) * focal), int((bottom - top) * focal)
    if height < 2 * rules.window or width * height > 4 * camera.width * camera.height:
        return None
    x, y = np.meshgrid((np.arange(width) + 0.5) / focal + left,
                       (np.arange(height) + 0.5) / focal + top)
    mine, inside = _warped(image, camera, to_shared, x, y, rules.window)
    yours, there = _warped(other, camera, other_to_shared, x - first / focal, y, rules.window)
    disparity = cv2.StereoSGBM.create(
        0, count, rules.window, 8 * 3 * rules.window ** 2, 32 * 3 * rules.window ** 2,
        disp12MaxDiff=1, preFilterCap=31, uniquenessRatio=rules.uniqueness,
        speckleWindowSize=rules.speckle, speckleRange=2, mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
    ).compute(mine, yours).astype(np.float32) / 16
    column = np.rint(np.arange(width) - disparity).astype(int)
    known = (disparity >= 0) & (column >= 0) & inside
    known &= np.take_along_axis(there, np.clip(column, 0, width - 1), 1)
    z = np.where(known, focal * baseline / np.maximum(disparity + first, 1e-6), 0)
    # Back to the pixels of the image.
    rays = camera.pixel_rays() @ to_shared.T
    found = cv2.remap(z.astype(np.float32),
                      *_pixels((rays[..., 0] / rays[..., 2] - left) * focal,
                               (rays[..., 1] / rays[..., 2] - top) * focal),
                      cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    return (found / rays[..., 2]).astype(np.float32)


def agreed_depth(depths: np.ndarray, rules: PhotoStereoRules = PhotoStereoRules()) -> np.ndarray:
    """Return what most of several depths (K, H, W) tell, their mean nearness; 0 = unknown."""
    nearness = np.divide(1, depths, out=np.zeros_like(depths), where=depths > 0)
    most, best = np.zeros(depths.shape[1:], int), np.zeros(depths.shape[1:], np.float32)
    for one in nearness:
        agree = (nearness > 0) & (np.abs(nearness - one) < rules.same * one)
        count = agree.sum(0)
        more = count > most
        most[more] = count[more]
        best[more] = ((nearness * agree).sum(0) / np.maximum(count, 1))[more]
    told = most >= min(rules.witnesses, len(depths))
    return np.divide(1, best, out=np.zeros_like(best), where=told & (best > 0))


def _photos_of_points(shown: Sequence[np.ndarray], count: int) -> list[np.ndarray]:
    """Return for each of `count` points the photos that show it."""
    photos = np.repeat(np.arange(len(shown)), [len(one) for one in shown])
    every = np.concatenate(shown)
    order = np.argsort(every, kind='stable')
    return np.split(photos[order], np.cumsum(np.bincount(every, minlength=count))[:-1])


def _median_angle(points: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    a, b = points - one, points - other
    cosine = (a * b).sum(1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
    return float(np.median(np.arccos(np.clip(cosine, -1, 1))))


def _extent(camera: Intrinsics, R: np.ndarray, least_ahead: float) -> np.ndarray | None:
    """Return the least and the greatest x / z, y / z (2, 2) of an image turned by R."""
    corners = np.array([[x, y, 1] for x in (-camera.cx / camera.fx,
                                            (camera.width - camera.cx) / camera.fx)
                        for y in (-camera.cy / camera.fy,
                                  (camera.height - camera.cy) / camera.fy)])
    turned = corners @ R.T
    if not (turned[:, 2] > least_ahead * np.linalg.norm(turned, axis=1)).all():
        return None
    turned = turned[:, :2] / turned[:, 2:]
    return np.stack([turned.min(0), turned.max(0)])


def _warped(image: np.ndarray, camera: Intrinsics, R: np.ndarray, x: np.ndarray, y: np.ndarray,
            window: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the image turned by R where its rays are (x, y, 1), and where it fills a window."""
    rays = np.stack([x, y, np.ones_like(x)], -1) @ R
    z = np.where(rays[..., 2] > 1e-3, rays[..., 2], np.nan)
    column, row = _pixels(camera.fx * rays[..., 0] / z + camera.cx,
                          camera.fy * rays[..., 1] / z + camera.cy)
    inside = ((column >= 0) & (row >= 0)
              & (column <= camera.width - 1) & (row <= camera.height - 1))
    return cv2.remap(image, np.where(inside, column, -2), np.where(inside, row, -2),
                     cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), cv2.erode(
        inside.view(np.uint8), np.ones((window, window), np.uint8),
        borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0


def _pixels(column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places in an image, its corner at 0, as OpenCV counts them: its first pixel at 0."""
    return (column - 0.5).astype(np.float32), (row - 0.5).astype(np.float32)
