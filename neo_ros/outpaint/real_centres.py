"""
Real photos in the middle of rendered wide views: training pairs whose input is no rendering.

At run time a sharp photo comes in; a network that saw renderings alone has never met one. Where a
photo shows more than the source view, its own pixels are the truth there.
"""
from neo_ros.errors import ConfigError
from neo_ros.exposure import exposure_gain
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.field.voxel_field import RadianceField
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.scenes.posed_images import PosedImages
import numpy as np


def same_focal_length(camera: Intrinsics, view: Intrinsics) -> bool:
    """Tell whether a camera's pixels fit into a view as they are."""
    return np.allclose([camera.fx, camera.fy], [view.fx, view.fy], rtol=1e-3)


def check_focal_length(camera: Intrinsics, view: Intrinsics) -> None:
    """Raise ConfigError where photos do not fit into the middle of views."""
    if not same_focal_length(camera, view):
        raise ConfigError(
            'outpaint.real_centre: expected photos of the focal length of the views, '
            f'{view.fx:.1f} x {view.fy:.1f} pixels, got {camera.fx:.1f} x '
            f'{camera.fy:.1f}; set it to 0')


class RealCentres:
    """Wide views at the poses of photos: photo where it reaches, field in its exposure around."""

    def __init__(self, field: RadianceField, photos: PosedImages, expansion: ViewExpansion,
                 scale: float) -> None:
        self.field, self.photos = field, photos
        self.expansion, self.scale = expansion, scale
        self.camera = photos.intrinsics.scaled(scale)
        check_focal_length(self.camera, expansion.target)
        self._rendered: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        return len(self.photos)

    def view(self, index: int) -> np.ndarray:
        """Return RGBA uint8 (H, W, 4) of photo `index`; A is coverage, 255 in the photo."""
        if index not in self._rendered:
            self._rendered[index] = self._render(index)
        return self._rendered[index]

    def views(self, indices: list[int]) -> np.ndarray:
        """Return RGBA uint8 (N, H, W, 4) of several photos."""
        return np.stack([self.view(index) for index in indices])

    def _render(self, index: int) -> np.ndarray:
        target = self.expansion.target
        rendering = render_view(self.field, target, self.photos.poses[index], supersample=1)
        image, covered = 255 * rendering.image, rendering.coverage > 0.5
        photo = self.photos.read_image(index, self.scale)
        # Where the photo's corner lies in the wide view; both share the optical axis.
        left = round(target.cx - self.camera.cx)
        top = round(target.cy - self.camera.cy)
        rows = slice(max(top, 0), min(top + photo.shape[0], target.height))
        columns = slice(max(left, 0), min(left + photo.shape[1], target.width))
        inside = photo[rows.start - top:rows.stop - top,
                       columns.start - left:columns.stop - left]
        # What lies around a photo is to have the photo's exposure.
        both = covered[rows, columns]
        image *= exposure_gain(image[rows, columns][both], inside[both])
        wide = to_uint8(np.dstack([image / 255, rendering.coverage]))
        wide[rows, columns, :3] = inside
        wide[rows, columns, 3] = 255
        return wide
