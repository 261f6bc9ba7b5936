"""
Landmarks: points of the scene whose place is known better than that of any surface of the field.

They are triangulated from the photos. Matched with an image they give its pose, from nothing or
from about where the camera is (PnP with RANSAC), and they tell whether a pose found in another
way can be right: photometric alignment follows a surface that is at a wrong depth.
"""
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory.landmark_places import coded, PlaceFinder, PlaceThresholds
from neo_ros.memory.local_features import Features, find_features, match_features
import numpy as np

# Images are enlarged twice, or to so many pixels in width if that is less; those that landmarks
# are made of and those that are located alike. With 256 poses are no better (demo flat: 0.55
# instead of 0.62 cm), and SIFT takes half as long again.
WORKED_WIDTH = 192
# In each cube of so many metres the landmarks that most photos show are kept, at most so many.
# The demo flat has up to 3800 in one.
CUBE, MOST_IN_CUBE = 4.0, 4000
MOST_LANDMARKS = 1 << 22  # Of a file.
NEAREST = 0.1  # metres that a point lies before the camera at least


@dataclass(frozen=True)
class LandmarkThresholds:
    """Which landmarks are kept, when a pose follows from them, and which others they allow."""

    # Photos that have to show a landmark.
    least_photos: int = 3
    most_features: int = 500
    ratio: float = 0.9
    inlier_pixels: float = 2.0
    ransac_rounds: int = 300
    # On 369 images of other scenes chance makes 6 at most; on held-out photos it is 24 and more.
    least_inliers: int = 20
    # Of the pairs of landmarks and features that look alike at a place the first pose is made of
    # those most alike: with all of them fewer are right. So many have to agree on it.
    most_hints: int = 40
    least_hints: int = 10
    # How far outside the image landmarks are tried, in widths of it.
    margin: float = 0.25
    # Two poses that are nearer than this have nearly the same landmarks in view.
    alike_metres: float = 0.2
    alike_cosine: float = 0.99
    # How much more the pairs may be off than at the landmarks' own best pose, in variances: 6
    # would be chance. Of true poses 95 of 100 have at most 19 (demo flat), 28 (a real kitchen) and
    # 40 (images of 64 pixels); half a degree off 95 have 139, 115 and, of 64 pixels, 9 and more.
    most_doubt: float = 60.0
    # More than so many landmarks are not believed more: they err together.
    most_witnesses: int = 90
    # Of the squared distance of a landmark from its pixel: features are not found more exactly.
    least_variance: float = 0.1
    places: PlaceThresholds = PlaceThresholds()


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Points float32 (P, 3), world metres, and how they look, uint8 (P, 128): RootSIFT x 512."""

    points: np.ndarray
    descriptors: np.ndarray

    @classmethod
    def from_observations(cls, points: np.ndarray, point_of: np.ndarray,
                          descriptors: np.ndarray,
                          least_photos: int = LandmarkThresholds.least_photos
                          ) -> 'Landmarks | None':
        """
        Choose the points that most photos show, each with its mean descriptor; None without any.

        points (P, 3) world metres; point_of int (N,), the point that each feature of the photos
        shows, -1 = none; descriptors float32 (N, 128) of these features, of length 1.
        """
        shown = point_of >= 0
        photos = np.bincount(point_of[shown], minlength=len(points))
        chosen = np.flatnonzero(photos >= least_photos)
        chosen = chosen[_most_of_each(np.floor(points[chosen] / CUBE), photos[chosen])]
        if not len(chosen):
            return None
        sums = np.zeros((len(points), descriptors.shape[1]), np.float32)
        np.add.at(sums, point_of[shown], descriptors[shown])
        return cls(points[chosen].astype(np.float32), coded(_unit(sums[chosen])))

    @classmethod
    def joined(cls, parts: 'Iterable[Landmarks | None]') -> 'Landmarks | None':
        """Return the landmarks of all parts; None where there are none."""
        found = [one for one in parts if one is not None and len(one.points)]
        return cls(np.concatenate([one.points for one in found]),
                   np.concatenate([one.descriptors for one in found])) if found else None

    def subset(self, kept: np.ndarray) -> 'Landmarks':
        """Return those that are marked, bool (P,)."""
        return Landmarks(self.points[kept], self.descriptors[kept])


class Location(NamedTuple):
    """
    The pose that landmarks give an image, and what speaks for it: N points and pixels.

    other_points (M, 3), other_pixels (M, 2): of pairs that look alike, but do not fit this pose.
    """

    pose: CameraPose
    camera: Intrinsics
    points: np.ndarray
    pixels: np.ndarray
    thresholds: LandmarkThresholds = LandmarkThresholds()
    other_points: np.ndarray = np.zeros((0, 3))
    other_pixels: np.ndarray = np.zeros((0, 2))

    def allows(self, pose: CameraPose) -> bool:
        """
        Tell whether another pose fits the landmarks as well, but for chance.

        All pairs are asked: of a few that were chosen because they fit a pose, none fits another.
        """
        limits = self.thresholds
        own = self._squared_errors(self.pose)
        more = (self._squared_errors(pose) - own).sum()
        fits = len(self.points)
        if fits > limits.most_witnesses:
            more *= limits.most_witnesses / fits
        return bool(2 * more < limits.most_doubt * max(own[:fits].mean(), limits.least_variance))

    def _squared_errors(self, pose: CameraPose) -> np.ndarray:
        """Return how far off all pairs are, square pixels (N + M,); not more than what fits."""
        seen, off = _project(np.concatenate([self.points, self.other_points]), pose, self.camera)
        errors = ((off - np.concatenate([self.pixels, self.other_pixels])) ** 2).sum(1)
        return np.minimum(np.where(seen, errors, np.inf), self.thresholds.inlier_pixels ** 2)


class Locator:
    """Finds images of one camera by the landmarks of one scene."""

    def __init__(self, landmarks: Landmarks, camera: Intrinsics,
                 thresholds: LandmarkThresholds = LandmarkThresholds()) -> None:
        # An image that is shrunk to find features knows them less exactly, by its own pixels, and
        # one that is enlarged more exactly: of what they are found in the limits are.
        self.camera = camera.scaled(min(1.0, WORKED_WIDTH / camera.width))
        self._magnify = magnification(camera)
        self.thresholds = replace(
            thresholds, inlier_pixels=thresholds.inlier_pixels / max(self._magnify, 1.0))
        self._shrunk = np.array([self.camera.width / camera.width,
                                 self.camera.height / camera.height])
        self._points = landmarks.points.astype(np.float64)
        self._descriptors = landmarks.descriptors
        self._places = PlaceFinder(landmarks.points, landmarks.descriptors, thresholds.places)

    def features(self, image: np.ndarray) -> Features:
        """Find in an image, uint8 RGB (h, w, 3), what `locate` looks at."""
        found = find_features(image, self._magnify, self.thresholds.most_features)
        return Features(found.points * self._shrunk, found.descriptors)

    def locate(self, features: Features, around: CameraPose) -> Location | None:
        """
        Find the pose of an image near another pose; None if too few landmarks are seen.

        The landmarks that a camera there would see are tried. PnP after Gao et al. (2003) in
        RANSAC, then least squares.
        """
        found = self._match(features, around)
        if found is not None and not self._alike(found.pose, around):
            found = self._match(features, found.pose) or found  # Others are in view there.
        return found

    def search(self, features: Features) -> list[Location]:
        """
        Find the poses that an image could have anywhere, the one most landmarks speak for first.

        Places first, by landmarks that look like the features, then a pose at each: rooms that
        look alike give several.
        """
        found = list[Location]()
        for landmarks, shown_by in self._places.find(features.descriptors):
            for rough in self._poses_at(self._points[landmarks], features.points[shown_by],
                                        landmarks, shown_by):
                if any(self._alike(rough.pose, other.pose) for other in found):
                    continue
                # Equal rooms behind a wall are in view of a pose, too: then the place alone tells.
                location = self.locate(features, rough.pose)
                if location is None and len(rough.points) >= self.thresholds.least_inliers:
                    location = rough
                if location is not None and not any(
                        self._alike(location.pose, other.pose) for other in found):
                    found.append(location)
        return sorted(found, key=lambda one: -len(one.points))

    def _poses_at(self, points: np.ndarray, pixels: np.ndarray, landmarks: np.ndarray,
                  shown_by: np.ndarray) -> Iterator[Location]:
        """
        Yield the poses that pairs of landmarks and features agree on, at one place.

        points (K, 3), pixels (K, 2) of the pairs, the most alike first. A feature may be in
        several pairs: where rooms are equal, there is a pose in each of them.
        """
        least, left = self.thresholds.least_hints, np.arange(len(points))
        while len(left) >= least:
            once = left[_first(shown_by[left])]
            once = once[_first(landmarks[once])][:self.thresholds.most_hints]
            rough = self._pose(points[once], pixels[once], least)
            if rough is None:
                return
            fits = left[self._fits(rough.pose, points[left], pixels[left])]
            fits = fits[_first(shown_by[fits])]
            yield self._pose(points[fits], pixels[fits], least) or rough
            left = np.setdiff1d(left, fits)

    def _match(self, features: Features, around: CameraPose) -> Location | None:
        tried = self._visible(around)
        # As floats all of a building's would be large; those in view take a millisecond.
        matches = match_features(features.descriptors,
                                 _unit(self._descriptors[tried].astype(np.float32)),
                                 self.thresholds.ratio)
        if len(matches) < self.thresholds.least_inliers:
            return None
        return self._pose(self._points[tried[matches[:, 1]]], features.points[matches[:, 0]],
                          self.thresholds.least_inliers)

    def _visible(self, pose: CameraPose) -> np.ndarray:
        """Return the indices of the landmarks in view of a pose, or near to it."""
        near = self._places.near(pose.position)
        seen, pixels = _project(self._points[near], pose, self.camera)
        size = np.array([self.camera.width, self.camera.height])
        margin = self.thresholds.margin * self.camera.width
        return near[seen & ((pixels > -margin) & (pixels < size + margin)).all(1)]

    def _pose(self, points: np.ndarray, pixels: np.ndarray, least: int) -> Location | None:
        """Find the pose that at least so many of the points fit; None without one."""
        matrix, limits = self.camera.matrix, self.thresholds
        if len(points) < least:
            return None
        found, turn, shift, inliers = cv2.solvePnPRansac(
            points, pixels, matrix, None, iterationsCount=limits.ransac_rounds,
            reprojectionError=limits.inlier_pixels, confidence=0.9999, flags=cv2.SOLVEPNP_AP3P)
        if not found or inliers is None:
            return None
        fits = inliers[:, 0]
        for _ in range(2):
            if len(fits) < least:
                return None
            turn, shift = cv2.solvePnPRefineLM(points[fits], pixels[fits], matrix, None, turn,
                                               shift)
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
            if not np.isfinite(T).all():
                return None
            pose = CameraPose.nearest(np.linalg.inv(T))
            fits = np.flatnonzero(self._fits(pose, points, pixels))
        if len(fits) < least:
            return None
        others = np.setdiff1d(np.arange(len(points)), fits)
        return Location(pose, self.camera, points[fits], pixels[fits], limits, points[others],
                        pixels[others])

    def _fits(self, pose: CameraPose, points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Tell which points (K, 3) are seen at these pixels (K, 2) from a pose, bool (K,)."""
        seen, off = _project(points, pose, self.camera)
        fits: np.ndarray = seen & (
            ((off - pixels) ** 2).sum(1) < self.thresholds.inlier_pixels ** 2)
        return fits

    def _alike(self, one: CameraPose, other: CameraPose) -> bool:
        """Tell whether nearly the same landmarks are in view of two poses."""
        return bool(
            np.linalg.norm(one.position - other.position) < self.thresholds.alike_metres
            and one.forward @ other.forward > self.thresholds.alike_cosine)


def magnification(camera: Intrinsics) -> float:
    """Return how many times an image is enlarged before features are looked for."""
    return min(2.0, WORKED_WIDTH / camera.width)


def _project(points: np.ndarray, pose: CameraPose, camera: Intrinsics
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return which points (N, 3) lie before the camera, and their pixels (N, 2)."""
    x, y, z = ((points - pose.position) @ pose.T_world_cam[:3, :3]).T
    seen = z > NEAREST
    z = np.where(seen, z, 1)
    return seen, np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], 1)


def _first(values: np.ndarray) -> np.ndarray:
    """Return where each value comes first, in ascending order."""
    return np.sort(np.unique(values, return_index=True)[1])


def _most_of_each(cubes: np.ndarray, photos: np.ndarray) -> np.ndarray:
    """Return in each cube (N, 3) the numbers of those with the most photos, in ascending order."""
    if not len(cubes):
        return np.zeros(0, np.int64)
    cube_of = np.unique(cubes, axis=0, return_inverse=True)[1].reshape(-1)
    order = np.lexsort((-photos, cube_of))
    first = np.searchsorted(cube_of[order], cube_of[order])
    return np.sort(order[np.arange(len(order)) - first < MOST_IN_CUBE])


def _unit(rows: np.ndarray) -> np.ndarray:
    """Return rows of length 1."""
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-6)
