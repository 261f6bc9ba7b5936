"""Pinhole intrinsics. Top-left image corner is (0, 0), pixel centres lie at +0.5."""
from dataclasses import dataclass
import math

from neo_ros.errors import GeometryError
import numpy as np


@dataclass(frozen=True)
class Intrinsics:
    """
    A pinhole camera without distortion.

    Units are pixels; the top-left image corner is (0, 0), so a camera whose optical axis
    passes through the middle of the image has cx = width / 2.
    Raises GeometryError for sizes that are not positive integers, focal lengths that are
    not positive, and values that are not finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name in ('width', 'height'):
            value = getattr(self, name)
            if not isinstance(value, (int, np.integer)) or value <= 0:
                raise GeometryError(f'{name}: expected a positive integer, got {value!r}')
            object.__setattr__(self, name, int(value))
        for name in ('fx', 'fy', 'cx', 'cy'):
            value = float(getattr(self, name))
            if not math.isfinite(value):
                raise GeometryError(f'{name}: expected a finite number of pixels, got {value}')
            object.__setattr__(self, name, value)
        for name in ('fx', 'fy'):
            if getattr(self, name) <= 0:
                raise GeometryError(
                    f'{name}: expected a focal length > 0 pixels, got {getattr(self, name)}')

    @classmethod
    def from_hfov(cls, width: int, height: int, hfov: float) -> 'Intrinsics':
        """Square pixels, centred optical axis, horizontal field of view `hfov` in radians."""
        if not 0 < hfov < math.pi:
            raise GeometryError(f'hfov: expected radians in (0, pi), got {hfov}')
        focal = width / 2 / math.tan(hfov / 2)
        return cls(width, height, focal, focal, width / 2, height / 2)

    @property
    def hfov(self) -> float:
        """Horizontal field of view between the image's left and right edge, radians."""
        return math.atan2(self.cx, self.fx) + math.atan2(self.width - self.cx, self.fx)

    @property
    def vfov(self) -> float:
        """Vertical field of view between the image's top and bottom edge, radians."""
        return math.atan2(self.cy, self.fy) + math.atan2(self.height - self.cy, self.fy)

    @property
    def matrix(self) -> np.ndarray:
        """The 3x3 float64 calibration matrix, pixel centres at +0.5."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def scaled(self, scale: float) -> 'Intrinsics':
        """Describe the same view at `scale` times the resolution (sizes are rounded)."""
        width, height = round(self.width * scale), round(self.height * scale)
        if width < 1 or height < 1:
            raise GeometryError(
                f'scale: {scale} leaves no pixel of a {self.width}x{self.height} image')
        sx, sy = width / self.width, height / self.height
        return Intrinsics(
            width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy)

    def cropped(self, left: int, top: int, width: int, height: int) -> 'Intrinsics':
        """Describe the window of the image that starts at pixel (left, top)."""
        if left < 0 or top < 0 or left + width > self.width or top + height > self.height:
            raise GeometryError(
                f'crop: {width}x{height} at ({left}, {top}) is not inside '
                f'{self.width}x{self.height}')
        return Intrinsics(width, height, self.fx, self.fy, self.cx - left, self.cy - top)

    def middle(self, width: int, height: int) -> 'Intrinsics':
        """Describe the window of this size around the middle of the image, or grow it to that."""
        left, top = (self.width - width) // 2, (self.height - height) // 2
        return self.grown(-left, width - self.width + left, -top, height - self.height + top)

    def window(self, view: 'Intrinsics') -> tuple[slice, slice]:
        """
        Return rows and columns of this image at which `view` lies, to the nearest whole pixel.

        Both have one focal length and optical axis; the window may reach beyond the image.
        """
        left, top = round(self.cx - view.cx), round(self.cy - view.cy)
        return slice(top, top + view.height), slice(left, left + view.width)

    def grown(self, left: int, right: int, top: int, bottom: int) -> 'Intrinsics':
        """Describe the image with so many pixels added at each side, same focal length."""
        return Intrinsics(
            self.width + left + right, self.height + top + bottom,
            self.fx, self.fy, self.cx + left, self.cy + top)

    def pixel_rays(self) -> np.ndarray:
        """
        Directions through all pixel centres in OpenCV camera axes.

        Returns float32 (height, width, 3) with z = 1 (not normalised).
        """
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        rays = np.ones((self.height, self.width, 3), np.float32)
        rays[..., 0] = x[None, :]
        rays[..., 1] = y[:, None]
        return rays

    def project(self, points: np.ndarray) -> np.ndarray:
        """
        Project points in OpenCV camera axes, (..., 3) metres with z > 0, to pixels (..., 2).

        Points with z <= 0 give NaN.
        """
        points = np.asarray(points, np.float64)
        z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
        return np.stack([self.fx * points[..., 0] / z + self.cx,
                         self.fy * points[..., 1] / z + self.cy], axis=-1)
