"""Calibrated cameras with lens distortion, and the pinhole view that is cut out of them."""
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
from neo_ros.errors import GeometryError, SceneError
from neo_ros.geometry.intrinsics import Intrinsics
import numpy as np

# OpenCV counts pixel centres from 0, `Intrinsics` has them at +0.5.
CENTRE = 0.5
EDGE_POINTS = 65
# What a camera may see across and down, degrees: beyond, its focal length is in no pixels of ours.
LEAST_VIEW, MOST_VIEW = 3.0, 170.0
# All cameras have to show so much of what the middle one of them shows, across and down.
LEAST_COMMON = 0.7


@dataclass(frozen=True)
class Lens:
    """
    A camera as it was calibrated.

    intrinsics  the pinhole part of the model
    distortion  OpenCV's coefficients: k1 k2 p1 p2 [k3 [k4 k5 k6]], or k1 k2 k3 k4 of a fisheye
    fisheye     the equidistant model (COLMAP OPENCV_FISHEYE, ROS equidistant)
    """

    intrinsics: Intrinsics
    distortion: tuple[float, ...] = ()
    fisheye: bool = False

    def __post_init__(self) -> None:
        if not np.isfinite(self.distortion).all():
            raise GeometryError(f'distortion: expected finite numbers, got {self.distortion}')

    @property
    def is_pinhole(self) -> bool:
        """Whether straight lines are straight in its images."""
        return not self.fisheye and not any(self.distortion)

    @property
    def cv_matrix(self) -> np.ndarray:
        """The 3x3 calibration matrix as OpenCV wants it, pixel centres at 0."""
        return _cv_matrix(self.intrinsics)

    @property
    def coefficients(self) -> np.ndarray:
        """The distortion as OpenCV wants it: 4, 5 or 8 numbers."""
        count = 4 if self.fisheye else min(n for n in (4, 5, 8) if n >= len(self.distortion))
        return np.array(self.distortion + (0.0,) * (count - len(self.distortion)))

    def straight_rectangle(self) -> tuple[float, float, float, float]:
        """
        Return the largest rectangle of the z = 1 plane whose edges the camera sees.

        (left, right, top, bottom), in tangents. Raises SceneError for lenses that bend the
        image's border so far that there is none.
        """
        width, height = self.intrinsics.width, self.intrinsics.height
        along = np.linspace(0, 1, EDGE_POINTS)
        x, y, zero = along * width, along * height, np.zeros(EDGE_POINTS)
        edges = [np.stack(edge, -1) for edge in (
            (zero, y), (zero + width, y), (x, zero), (x, zero + height))]
        straight = [self._straighten(edge) for edge in edges]
        left, right, top, bottom = straight
        rectangle = (left[:, 0].max(), right[:, 0].min(), top[:, 1].max(), bottom[:, 1].min())
        # Beyond the turning point of its polynomial a lens has no straight counterpart.
        seen = all(self._bends_back(points, edge) for points, edge in zip(straight, edges)) and (
            rectangle[0] < rectangle[1] and rectangle[2] < rectangle[3])
        if not seen:
            raise SceneError(
                f'lens: no pinhole view fits into this camera (focal length '
                f'{self.intrinsics.fx:.1f} px, distortion {self.distortion}); is the '
                'calibration right? A lens of 180 degrees or more cannot be used')
        a, b, c, d = map(float, rectangle)
        return a, b, c, d

    def straighten_maps(self, pinhole: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
        """Return the maps for cv2.remap, float32 (H, W), from this camera to `pinhole`."""
        size = (pinhole.width, pinhole.height)
        undistort = (cv2.fisheye.initUndistortRectifyMap if self.fisheye
                     else cv2.initUndistortRectifyMap)
        return undistort(self.cv_matrix, self.coefficients, np.eye(3), _cv_matrix(pinhole),
                         size, cv2.CV_32FC1)

    def _straighten(self, pixels: np.ndarray) -> np.ndarray:
        """Undistort pixels (N, 2) to points (N, 2) of the z = 1 plane."""
        points = np.ascontiguousarray((pixels - CENTRE)[:, None], np.float64)
        if self.fisheye:
            straight = cv2.fisheye.undistortPoints(points, self.cv_matrix, self.coefficients)
        else:
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
            straight = cv2.undistortPoints(
                points, self.cv_matrix, self.coefficients, criteria=criteria)
        return straight[:, 0]

    def _bends_back(self, points: np.ndarray, pixels: np.ndarray) -> bool:
        """Whether points (N, 2) of the z = 1 plane are really seen at these pixels."""
        if not np.isfinite(points).all():
            return False
        rays = np.concatenate([points, np.ones((len(points), 1))], axis=1)[:, None]
        project = cv2.fisheye.projectPoints if self.fisheye else cv2.projectPoints
        still = np.zeros(3)
        found = project(rays, still, still, self.cv_matrix, self.coefficients)[0]
        return bool(np.abs(found[:, 0] + CENTRE - pixels).max() < CENTRE)


def common_pinhole(lenses: Mapping[Lens, str]) -> Intrinsics:
    """
    Return the one pinhole camera that all images are brought to.

    lenses: each with the name of an image that was taken with it. A single camera without
    distortion stays as it is. Otherwise the result has the images' size and shows the largest
    rectangle that every one of the cameras sees, without black borders.
    Raises SceneError for images of several sizes, and names the image whose camera sees next to
    nothing or all around, or not nearly what the others see.
    """
    cameras = list(lenses)
    sizes: dict[tuple[int, int], str] = {}
    for lens, name in lenses.items():
        sizes.setdefault((lens.intrinsics.width, lens.intrinsics.height), name)
    if len(sizes) > 1:
        raise SceneError(
            'expected photos of one size, got '
            + ', '.join(f'{w}x{h} ({name})' for (w, h), name in sorted(sizes.items()))
            + '; photos are never resized: import the sizes as scenes of their own')
    rectangles = np.array([_plausible_rectangle(lens, name) for lens, name in lenses.items()])
    if len(cameras) == 1 and cameras[0].is_pinhole:
        return cameras[0].intrinsics
    _check_alike(rectangles, list(lenses.values()))
    left, top = rectangles[:, 0].max(), rectangles[:, 2].max()
    right, bottom = rectangles[:, 1].min(), rectangles[:, 3].min()
    (width, height), = sizes
    fx, fy = width / (right - left), height / (bottom - top)
    return Intrinsics(width, height, fx, fy, -left * fx, -top * fy)


def _plausible_rectangle(lens: Lens, name: str) -> tuple[float, float, float, float]:
    try:
        rectangle = lens.straight_rectangle()
    except SceneError as error:
        raise SceneError(f'{name}: {error}') from error
    left, right, top, bottom = rectangle
    # As if the optical axis were in the middle: at the rim, it may be a cut of a larger picture.
    across, down = np.degrees(2 * np.arctan([(right - left) / 2, (bottom - top) / 2]))
    camera = lens.intrinsics
    if not (LEAST_VIEW <= min(across, down) and max(across, down) <= MOST_VIEW):
        raise SceneError(
            f'{name}: expected a camera that sees {LEAST_VIEW:g} to {MOST_VIEW:g} degrees, got '
            f'{across:.1f} across and {down:.1f} down (focal lengths {camera.fx:g} '
            f'and {camera.fy:g}); are they in pixels of images of {camera.width}x{camera.height}?')
    return rectangle


def _check_alike(rectangles: np.ndarray, names: list[str]) -> None:
    """Raise SceneError that names the odd one: all images would be cut to what it sees."""
    low, high = rectangles[:, ::2], rectangles[:, 1::2]  # (N, 2): across and down
    middle = np.median(low, axis=0), np.median(high, axis=0)
    common = np.minimum(high, middle[1]) - np.maximum(low, middle[0])
    share = (common / (middle[1] - middle[0])).min(1)
    odd = int(share.argmin())
    if share[odd] < LEAST_COMMON:
        raise SceneError(
            f'{names[odd]}: expected a camera like those of the other images, got one that shows '
            f'{max(share[odd], 0):.0%} of what they show; as all images are cut to what every '
            'camera shows, correct its calibration, or leave its images out')


class Straightener:
    """Bring images of several lenses to one pinhole camera; the maps are kept."""

    def __init__(self, pinhole: Intrinsics) -> None:
        self.pinhole = pinhole
        self._last: tuple[Lens, tuple[np.ndarray, np.ndarray]] | None = None

    def is_identity(self, lens: Lens) -> bool:
        """Whether the images of this lens stay as they are."""
        return lens.is_pinhole and lens.intrinsics == self.pinhole

    def apply(self, image: np.ndarray, lens: Lens) -> np.ndarray:
        """Return the pinhole view of a uint8 (H, W, 3) image."""
        if self.is_identity(lens):
            return image
        if self._last is None or self._last[0] != lens:
            self._last = (lens, lens.straighten_maps(self.pinhole))
        # The outermost half pixels ask for neighbours beyond the border.
        return cv2.remap(image, *self._last[1], cv2.INTER_CUBIC,
                         borderMode=cv2.BORDER_REPLICATE)


def _cv_matrix(intrinsics: Intrinsics) -> np.ndarray:
    matrix = intrinsics.matrix
    matrix[:2, 2] -= CENTRE
    return matrix
