"""What the radiance field shows at a pose, as a widened view; the oracle is the true pose's."""
from neo_ros.errors import SceneError
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.pictures.exposure import exposure_gain
import numpy as np


class FieldView:
    """Render wide views from a field and fit them to the camera's image."""

    def __init__(self, field: RadianceField, expansion: ViewExpansion,
                 supersample: int = 2) -> None:
        self.field, self.expansion, self.supersample = field, expansion, supersample

    def widen(self, narrow_image: np.ndarray, pose: CameraPose) -> np.ndarray:
        """Return the field's wide view (H, W, 3) uint8 at a pose, the observed pixels pasted."""
        return self.show(narrow_image, pose)[0]

    def show(self, narrow_image: np.ndarray, pose: CameraPose) -> tuple[np.ndarray, np.ndarray]:
        """
        Return what `widen` does, and how much of each pixel some photo saw, float (H, W).

        One gain per channel, from the window that both show, takes out differences of exposure.
        """
        view = render_view(self.field, self.expansion.target, pose, self.supersample)
        gain = exposure_gain(255 * self.expansion.crop(view.image), narrow_image)
        return self.expansion.paste(narrow_image, to_uint8(view.image * gain)), view.coverage


class Oracle:
    """The upper bound: the field at the true pose, which no robot knows."""

    name = 'oracle'
    observed_pasted = True

    def __init__(self, view: FieldView, train_minutes: float | None,
                 model_mb: float | None) -> None:
        self.view = view
        self.train_minutes, self.model_mb = train_minutes, model_mb

    def expand_at(self, narrow_image: np.ndarray, true_pose: CameraPose) -> np.ndarray:
        """Widen (h, w, 3) RGB uint8 to (H, W, 3) RGB uint8."""
        return self.view.widen(narrow_image, true_pose)

    def expand(self, narrow_image: np.ndarray) -> np.ndarray:
        """Refuse: without the pose there is no oracle."""
        raise SceneError('oracle: needs the true pose of the frame; call expand_at')
