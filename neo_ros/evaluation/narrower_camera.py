"""Score a camera without wide truth: its recorded frame is the truth of a narrower camera."""
import math

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.geometry import ViewExpansion
import numpy as np

# Below this the score would be about a handful of pixels.
MIN_WINDOW = 16


class NarrowerCamera:
    """
    A virtual camera at the same place that sees only the middle of what was recorded.

    The recorded frame (or the largest part of it with the shape of the wide view) takes the
    place of the wide view; the window that a narrower camera would have seen is cut out of it
    and enlarged to the model's input. What the model makes of the rest can be held against what
    was recorded there. The model sees everything `focal_ratio` times as large as in training.

    expansion    window -> part of the recorded frame, at the recorded resolution
    focal_ratio  focal length of the virtual camera over that of the model, both in pixels of
                 the model's input
    """

    def __init__(self, model: ViewExpansion) -> None:
        """Raise ImageRejected for a model whose input is too small for this."""
        source, target = model.source, model.target
        # The largest part of the frame with the optical axis where the wide view has it.
        scale = min(source.cx / target.cx, (source.width - source.cx) / (target.width - target.cx),
                    source.cy / target.cy,
                    (source.height - source.cy) / (target.height - target.cy))
        # Rounded one by one, so that they sum up.
        width, height, left, right, top, bottom = (
            round(scale * pixels) for pixels in (
                source.width, source.height, model.left, model.right, model.top, model.bottom))
        wide = min(left + width + right, source.width)
        high = min(top + height + bottom, source.height)
        width, height = min(width, wide - left), min(height, high - top)
        if min(width, height) < MIN_WINDOW:
            raise ImageRejected('size', f'the model takes {source.width}x{source.height} pixels: '
                                'too few to cut a narrower camera out of them')
        x, y = (max(0, min(round(c - scale * c_wide), size - part)) for c, c_wide, size, part in (
            (source.cx, target.cx, source.width, wide),
            (source.cy, target.cy, source.height, high)))
        self._model = model
        self._part = slice(y, y + high), slice(x, x + wide)
        self.expansion = ViewExpansion.inside(
            source.cropped(x, y, wide, high), left, top, width, height)
        self.focal_ratio = source.width / width

    def truth(self, image: np.ndarray) -> np.ndarray:
        """Return what the model's output is held against, a view of the recorded image."""
        return image[self._part]

    def model_input(self, image: np.ndarray) -> np.ndarray:
        """Return what the narrower camera saw, at the size that the model takes."""
        source = self._model.source
        return cv2.resize(self.expansion.crop(self.truth(image)), (source.width, source.height),
                          interpolation=cv2.INTER_CUBIC)

    def prediction(self, wide_image: np.ndarray, image: np.ndarray) -> np.ndarray:
        """Return the model's output at the recorded resolution, the seen window as recorded."""
        target = self.expansion.target
        small = cv2.resize(wide_image, (target.width, target.height),
                           interpolation=cv2.INTER_AREA)
        return self.expansion.paste(self.expansion.crop(self.truth(image)), small)

    def describe(self) -> str:
        """Say what was measured, and how it differs from the use of the model."""
        model, used = self._model, self.expansion
        fov = [math.degrees(view.hfov) for view in (
            model.source, model.target, used.source, used.target)]
        return (f'Scored against the camera itself: the middle {used.source.width}x'
                f'{used.source.height} pixels of each recorded frame are widened, and the '
                f'border up to {used.target.width}x{used.target.height} is scored. The model '
                f'was trained to widen {fov[0]:.1f} to {fov[1]:.1f} degrees; here it widens '
                f'{fov[2]:.1f} to {fov[3]:.1f}, at {self.focal_ratio:.2f} times the focal length '
                'of its training, so everything looks that much larger to it. Expect lower '
                'scores than in use, and compare them only with scores taken in this way.')
