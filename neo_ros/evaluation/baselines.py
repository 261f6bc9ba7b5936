"""
The methods that are compared: each takes the narrow image and gives the wide one.

Edge replication and the mean image are the floors: whoever does not beat them has learnt nothing.
"""
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

import cv2
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.pictures.filling import extend_edges
from neo_ros.runtime.fov_extrapolator import FovExtrapolator, memory_path
import numpy as np


class Method(Protocol):
    """
    One way to widen a view.

    name             as it stands in tables and in the `method` column of results
    observed_pasted  whether the camera's pixels are in the wide image as they came
    train_minutes, model_mb  cost, None where there is none
    """

    name: str
    observed_pasted: bool
    train_minutes: float | None
    model_mb: float | None

    def expand(self, narrow_image: np.ndarray) -> np.ndarray:
        """Widen (h, w, 3) RGB uint8 to (H, W, 3) RGB uint8."""


class EdgeReplication:
    """Floor 1: repeat the outermost observed pixels outwards."""

    name = 'edge_replication'
    observed_pasted = True
    train_minutes: float | None = None
    model_mb: float | None = None

    def __init__(self, expansion: ViewExpansion) -> None:
        self.expansion = expansion

    def expand(self, narrow_image: np.ndarray) -> np.ndarray:
        """Widen (h, w, 3) RGB uint8 to (H, W, 3) RGB uint8."""
        grow = self.expansion
        return cv2.copyMakeBorder(narrow_image, grow.top, grow.bottom, grow.left, grow.right,
                                  cv2.BORDER_REPLICATE)


class MeanImage:
    """
    Floor 2: the mean of all training photos, resized to the wide frame, centre pasted.

    The photos cover the wide view (horizontal protocol) or only the narrow one (square
    protocol); either way their mean, stretched, is the best guess that looks at nothing.

    shown  images RGB uint8 (h, w, 3), all of one size, each with its pixels that show the scene,
           bool (h, w), as `PosedImages.read_shown` gives them; may be a stream
    """

    name = 'mean_image'
    observed_pasted = True
    train_minutes: float | None = None
    model_mb: float | None = None

    def __init__(self, expansion: ViewExpansion,
                 shown: Iterable[tuple[np.ndarray, np.ndarray]]) -> None:
        self.expansion = expansion
        total: np.ndarray | float = 0.0
        count: np.ndarray | None = None
        for image, usable in shown:
            total = total + image.astype(np.float64) * usable[..., None]
            count = usable.astype(int) if count is None else count + usable
        if count is None:
            raise SceneError('shown: expected at least one photo to average, got none')
        size = (expansion.target.width, expansion.target.height)
        shrink = size[0] < count.shape[1]
        # Pixels that no photo shows take their neighbours' colour.
        mean = extend_edges(total / np.maximum(count, 1)[..., None], count > 0)
        mean = cv2.resize(mean, size,
                          interpolation=cv2.INTER_AREA if shrink else cv2.INTER_LINEAR)
        self.mean_image = np.rint(mean).astype(np.uint8)

    def expand(self, narrow_image: np.ndarray) -> np.ndarray:
        """Widen (h, w, 3) RGB uint8 to (H, W, 3) RGB uint8."""
        return self.expansion.paste(narrow_image, self.mean_image)


class NeoModel:
    """The trained model of a scene, as the robot runs it."""

    observed_pasted = True

    def __init__(self, path: Path, name: str = '', threads: int = 0,
                 guided: bool = True) -> None:
        """
        Load a model file; raises ModelError as `FovExtrapolator.load` does.

        With `guided` False the scene memory is left alone. Without a name it is called guided,
        or as its network.
        """
        self._extrapolator = FovExtrapolator.load(path, threads, guided=guided)
        self.card = self._extrapolator.card
        self.expansion = self._extrapolator.expansion
        self.train_minutes: float | None = self.card.trained_seconds / 60
        self.guided = guided and self.card.memory is not None
        self.name = name or ('guided' if self.guided else self.card.network)
        files = [Path(path)]
        if self.guided and self.card.memory is not None:
            files.append(memory_path(path, self.card.memory))
        self.model_mb: float | None = sum(file.stat().st_size for file in files) / 1e6

    def expand(self, narrow_image: np.ndarray) -> np.ndarray:
        """Widen (h, w, 3) RGB uint8 to (H, W, 3) RGB uint8."""
        self._last = self._extrapolator.expand(narrow_image)
        return self._last.wide_image

    def notes(self, true_pose: CameraPose) -> dict[str, float]:
        """Return whether the scene memory knew where the camera of the last frame was."""
        return {'guided': float(self._last.guided)} if self.guided else {}

    def reset(self) -> None:
        """Forget the frames before, and their light."""
        self._extrapolator.reset()
        self._extrapolator.forget_light()
