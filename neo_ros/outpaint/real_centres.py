"""
Real photos in the middle of rendered wide views: training pairs whose input is no rendering.

At run time a sharp photo comes in; a network that saw renderings alone has never met one. Where a
photo shows more than the source view, its own pixels are the truth there.
"""
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.geometry import ViewExpansion
from neo_ros.pictures.exposure import exposure_gain
from neo_ros.scenes.posed_images import PosedImages
import numpy as np


# Views that are kept; of those that were not asked for the longest, some are rendered again.
KEPT_BYTES = 4 << 30


class RealCentres:
    """
    Wide views at the poses of photos: photo where it reaches, field in its exposure around.

    What a mask leaves out of a photo comes from the field, too.
    """

    def __init__(self, field: RadianceField, photos: PosedImages, expansion: ViewExpansion,
                 scale: float) -> None:
        self.field, self.photos = field, photos
        self.expansion, self.scale = expansion, scale
        self.camera = photos.intrinsics.scaled(scale)
        self._rendered: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        return len(self.photos)

    def view(self, index: int) -> np.ndarray:
        """Return RGBA uint8 (H, W, 4) of photo `index`; A is coverage, 255 in the photo."""
        found = self._rendered.pop(index, None)
        if found is None:
            found = self._render(index)
        self._rendered[index] = found
        if len(self._rendered) * found.nbytes > KEPT_BYTES:
            del self._rendered[next(iter(self._rendered))]
        return found

    def views(self, indices: list[int]) -> np.ndarray:
        """Return RGBA uint8 (N, H, W, 4) of several photos."""
        return np.stack([self.view(index) for index in indices])

    def _render(self, index: int) -> np.ndarray:
        target = self.expansion.target
        rendering = render_view(self.field, target, self.photos.poses[index], supersample=1)
        image, covered = 255 * rendering.image, rendering.coverage > 0.5
        photo = self.photos.read_image(index, self.scale)
        down, across = target.window(self.camera)
        rows = slice(max(down.start, 0), min(down.stop, target.height))
        columns = slice(max(across.start, 0), min(across.stop, target.width))
        of_photo = (slice(rows.start - down.start, rows.stop - down.start),
                    slice(columns.start - across.start, columns.stop - across.start))
        inside = photo[of_photo]
        usable = self.photos.read_usable(index, self.scale)
        shown = np.ones(inside.shape[:2], bool) if usable is None else usable[of_photo]
        # What lies around a photo is to have the photo's exposure.
        both = covered[rows, columns] & shown
        image *= exposure_gain(image[rows, columns][both], inside[both])
        wide = to_uint8(np.dstack([image / 255, rendering.coverage]))
        wide[rows, columns, :3][shown] = inside[shown]
        wide[rows, columns, 3][shown] = 255
        return wide
