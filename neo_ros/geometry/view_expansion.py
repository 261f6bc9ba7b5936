"""From a source view to a wider one at the same focal length and optical centre."""
from dataclasses import dataclass

from neo_ros.errors import GeometryError
from neo_ros.geometry.intrinsics import Intrinsics
import numpy as np


@dataclass(frozen=True)
class ViewExpansion:
    """
    Grow a source view by whole pixels at each side (the paper's h x w -> H x W, section 3).

    The focal length and the optical centre stay, so the source image is exactly the window
    `observed` of the target image, and the mask follows from geometry alone.
    """

    source: Intrinsics
    left: int
    right: int
    top: int
    bottom: int

    def __post_init__(self) -> None:
        for name in ('left', 'right', 'top', 'bottom'):
            value = getattr(self, name)
            if not isinstance(value, (int, np.integer)) or value < 0:
                raise GeometryError(f'{name}: expected pixels >= 0, got {value!r}')
        if self.left + self.right + self.top + self.bottom == 0:
            raise GeometryError('expansion: expected growth at one side at least, got none')

    @classmethod
    def to_size(cls, source: Intrinsics, width: int, height: int) -> 'ViewExpansion':
        """Grow evenly on opposite sides to a target of width x height pixels."""
        dx, dy = width - source.width, height - source.height
        if dx < 0 or dy < 0 or dx % 2 or dy % 2:
            raise GeometryError(
                f'target: expected at least {source.width}x{source.height} and an even growth, '
                f'got {width}x{height}')
        return cls(source, dx // 2, dx // 2, dy // 2, dy // 2)

    @classmethod
    def to_twice(cls, source: Intrinsics) -> 'ViewExpansion':
        """Grow to twice the width and height; an odd one grows by the odd pixel at its end."""
        left, top = source.width // 2, source.height // 2
        return cls(source, left, source.width - left, top, source.height - top)

    @classmethod
    def horizontal(cls, source: Intrinsics, width: int) -> 'ViewExpansion':
        """Grow left and right only, to `width` pixels (the paper's ScanNet protocol)."""
        return cls.to_size(source, width, source.height)

    @classmethod
    def inside(cls, target: Intrinsics, left: int, top: int,
               width: int, height: int) -> 'ViewExpansion':
        """Take a window of `target` as the source."""
        source = target.cropped(left, top, width, height)
        return cls(source, left, target.width - left - width,
                   top, target.height - top - height)

    @property
    def target(self) -> Intrinsics:
        """Intrinsics of the wide view."""
        return self.source.grown(self.left, self.right, self.top, self.bottom)

    @property
    def observed(self) -> tuple[slice, slice]:
        """Rows and columns of the target image that the camera saw."""
        return (slice(self.top, self.top + self.source.height),
                slice(self.left, self.left + self.source.width))

    @property
    def extrapolated_mask(self) -> np.ndarray:
        """Bool (H, W): True where the model made the pixel up, False where the camera saw."""
        mask = np.ones((self.target.height, self.target.width), bool)
        mask[self.observed] = False
        return mask

    def scaled(self, scale: float) -> 'ViewExpansion':
        """Describe the same expansion at another resolution; all sizes must stay whole."""
        sizes = [value * scale for value in (
            self.source.width, self.source.height, self.left, self.right, self.top, self.bottom)]
        if any(abs(size - round(size)) > 1e-6 for size in sizes):
            raise GeometryError(f'scale: {scale} does not give whole pixels, got {sizes}')
        return ViewExpansion(self.source.scaled(scale), *(round(size) for size in sizes[2:]))

    def crop(self, target_image: np.ndarray) -> np.ndarray:
        """Cut the source view (h, w, ...) out of a wide image (H, W, ...). A view, no copy."""
        expected = (self.target.height, self.target.width)
        if target_image.shape[:2] != expected:
            raise GeometryError(
                f'target_image: expected height x width {expected}, '
                f'got {target_image.shape[:2]}')
        return target_image[self.observed]

    def paste(self, source_image: np.ndarray, target_image: np.ndarray) -> np.ndarray:
        """Return a copy of the wide image with the source image in its window."""
        expected = (self.source.height, self.source.width)
        if source_image.shape[:2] != expected:
            raise GeometryError(
                f'source_image: expected height x width {expected}, '
                f'got {source_image.shape[:2]}')
        self.crop(target_image)
        result = target_image.copy()
        result[self.observed] = source_image
        return result

    def seam_mask(self, width: int) -> np.ndarray:
        """Bool (H, W): the extrapolated band of `width` pixels around the observed window."""
        rows, columns = self.observed
        near = np.zeros((self.target.height, self.target.width), bool)
        near[max(rows.start - width, 0):rows.stop + width,
             max(columns.start - width, 0):columns.stop + width] = True
        return near & self.extrapolated_mask
