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
# How many coefficients OpenCV takes: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]].
COUNTS = (4, 5, 8, 12, 14)
FISHEYE_COUNTS = (4,)
# Of a fisheye's pinhole view, degrees: beyond, a few pixels at the rim fill most of the picture.
FISHEYE_VIEW = 120.0
# Steps of the angle in which a fisheye's polynomial is followed; between them it is a line.
ANGLE_STEPS = 2000
# Halvings that find the largest view inside a fisheye's image.
HALVINGS = 20
# All cameras have to show so much of what the middle one of them shows, across and down.
LEAST_COMMON = 0.7


@dataclass(frozen=True)
class Lens:
    """
    A camera as it was calibrated.

    intrinsics    the pinhole part of the model
    distortion    OpenCV's coefficients, of COUNTS; or k1 k2 k3 k4 of a fisheye. Zeros may follow
    fisheye       the equidistant model (COLMAP OPENCV_FISHEYE, ROS equidistant)
    fisheye_view  degrees that a fisheye's pinhole view has at most, across and down
    rim           pixels along the border that show nothing; not of a fisheye
    """

    intrinsics: Intrinsics
    distortion: tuple[float, ...] = ()
    fisheye: bool = False
    fisheye_view: float = FISHEYE_VIEW
    rim: int = 0

    def __post_init__(self) -> None:
        most = (FISHEYE_COUNTS if self.fisheye else COUNTS)[-1]
        if not np.isfinite(self.distortion).all() or any(self.distortion[most:]):
            raise GeometryError(f'distortion: expected finite numbers, at most {most}, '
                                f'got {self.distortion}')

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
        """The distortion as OpenCV wants it, one of COUNTS or FISHEYE_COUNTS numbers."""
        counts = FISHEYE_COUNTS if self.fisheye else COUNTS
        values = self.distortion[:counts[-1]]
        count = min(n for n in counts if n >= len(values))
        return np.array(values + (0.0,) * (count - len(values)))

    def straight_rectangle(self) -> tuple[float, float, float, float]:
        """
        Return the largest rectangle of the z = 1 plane whose edges the camera sees.

        (left, right, top, bottom), in tangents; of a fisheye inside `fisheye_view`. Raises
        SceneError for lenses that bend the image's border so far that there is none.
        """
        rectangle = self._fisheye_rectangle() if self.fisheye else self._inner_rectangle()
        if not self._shows(rectangle):
            raise SceneError(
                f'lens: no pinhole view fits into this camera (focal length '
                f'{self.intrinsics.fx:.1f} px, distortion {self.distortion}); is the '
                'calibration right?')
        a, b, c, d = map(float, rectangle)
        return a, b, c, d

    def straighten_maps(self, pinhole: Intrinsics, rotation: np.ndarray = np.eye(3)
                        ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the maps for cv2.remap, float32 (H, W), from this camera to `pinhole`.

        rotation: 3x3, from this camera's frame to the one of `pinhole`.
        """
        size = (pinhole.width, pinhole.height)
        undistort = (cv2.fisheye.initUndistortRectifyMap if self.fisheye
                     else cv2.initUndistortRectifyMap)
        return undistort(self.cv_matrix, self.coefficients, rotation, _cv_matrix(pinhole),
                         size, cv2.CV_32FC1)

    def sees(self, points: np.ndarray, tolerance: float) -> bool:
        """
        Say whether all points (N, 2) of the z = 1 plane are found again from their pixels.

        Beyond its turning point a lens polynomial brings rays that the camera cannot see back
        into the image. tolerance: in tangents.
        """
        found = self.straighten(self._project(points))
        return bool(np.isfinite(found).all() and np.abs(found - points).max() < tolerance)

    def _inner_rectangle(self) -> np.ndarray:
        """Return what lies inside the straightened border of the image, or inside its rim."""
        width, height = self.intrinsics.width, self.intrinsics.height
        x, y = (np.linspace(self.rim, size - self.rim, EDGE_POINTS) for size in (width, height))
        left, right, top, bottom = (
            self.straighten(np.stack(np.broadcast_arrays(*edge), -1)) for edge in (
                (x[0], y), (x[-1], y), (x, y[0]), (x, y[-1])))
        return np.array([left[:, 0].max(), right[:, 0].min(), top[:, 1].max(), bottom[:, 1].min()])

    def _fisheye_rectangle(self) -> np.ndarray:
        """
        Return what the lens shows straight to the sides and up and down, or that made smaller.

        It may see more than 180 degrees: its angles are followed from the axis outwards.
        """
        camera = self.intrinsics
        angles = np.linspace(0, np.radians(self.fisheye_view) / 2, ANGLE_STEPS)
        powers = angles[:, None] ** (2, 4, 6, 8)
        radii = angles * (1 + powers @ self.coefficients)
        rising = np.diff(radii) > 0
        count = len(angles) if rising.all() else 1 + int(rising.argmin())
        sides = np.array([camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx,
                          camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy])
        reach = np.tan(np.interp(sides, radii[:count], angles[:count])) * (-1, 1, -1, 1)
        if self._shows(reach):
            return reach
        fits, too_large = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = (fits + too_large) / 2
            fits, too_large = (middle, too_large) if self._shows(middle * reach) else (
                fits, middle)
        return fits * reach

    def _shows(self, rectangle: np.ndarray) -> bool:
        """Whether the whole border of a rectangle of the z = 1 plane is in the image."""
        left, right, top, bottom = rectangle
        if not (np.isfinite(rectangle).all() and left < right and top < bottom):
            return False
        x, y = np.linspace(left, right, EDGE_POINTS), np.linspace(top, bottom, EDGE_POINTS)
        border = np.concatenate([np.stack(np.broadcast_arrays(*edge), -1) for edge in (
            (left, y), (right, y), (x, top), (x, bottom))])
        camera = self.intrinsics
        pixels = self._project(border)
        # Half a pixel beyond the border is still nearer to it than to anything else.
        inside = (np.abs(pixels / (camera.width, camera.height) - 0.5)
                  <= 0.5 + CENTRE / np.array([camera.width, camera.height]))
        return bool(inside.all()) and self.sees(border, CENTRE / min(camera.fx, camera.fy))

    def straighten(self, pixels: np.ndarray) -> np.ndarray:
        """Undistort pixels (N, 2) to points (N, 2) of the z = 1 plane."""
        points = np.ascontiguousarray((pixels - CENTRE)[:, None], np.float64)
        if self.fisheye:
            straight = cv2.fisheye.undistortPoints(points, self.cv_matrix, self.coefficients)
        else:
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
            straight = cv2.undistortPoints(
                points, self.cv_matrix, self.coefficients, criteria=criteria)
        return straight[:, 0]

    def _project(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels (N, 2) of points (N, 2) of the z = 1 plane."""
        rays = np.concatenate([points, np.ones((len(points), 1))], axis=1)[:, None]
        project = cv2.fisheye.projectPoints if self.fisheye else cv2.projectPoints
        still = np.zeros(3)
        return project(rays, still, still, self.cv_matrix, self.coefficients)[0][:, 0] + CENTRE


def common_pinhole(lenses: Mapping[Lens, str]) -> Intrinsics:
    """
    Return the one pinhole camera that all images are brought to.

    lenses: each with the name of an image that was taken with it. A single camera without
    distortion or rim stays as it is. Otherwise the result has the images' size and shows the
    largest rectangle that every one of the cameras sees, without black borders.
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
    if len(cameras) == 1 and cameras[0].is_pinhole and not cameras[0].rim:
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
        # The outermost half pixels ask for neighbours beyond the border.
        return cv2.remap(image, *self._maps(lens), cv2.INTER_CUBIC,
                         borderMode=cv2.BORDER_REPLICATE)

    def pick(self, numbers: np.ndarray, lens: Lens) -> np.ndarray:
        """
        Return the pinhole view of numbers (H, W) that must not be mixed, such as depth.

        Each pixel takes the nearest one; what the lens does not see is 0.
        """
        if self.is_identity(lens):
            return numbers
        return cv2.remap(numbers, *self._maps(lens), cv2.INTER_NEAREST,
                         borderMode=cv2.BORDER_CONSTANT, borderValue=0)

    def _maps(self, lens: Lens) -> tuple[np.ndarray, np.ndarray]:
        if self._last is None or self._last[0] != lens:
            self._last = (lens, lens.straighten_maps(self.pinhole))
        return self._last[1]


def _cv_matrix(intrinsics: Intrinsics) -> np.ndarray:
    matrix = intrinsics.matrix
    matrix[:2, 2] -= CENTRE
    return matrix
