"""What the runtime needs of the memory: a wide view that shows the scene, or none."""
from pathlib import Path

from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.memory.fusion import fuse, FusionThresholds
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.sight import Guide
import numpy as np


class GuidedView:
    """Follows one camera and fuses its images with what the memory shows around them."""

    def __init__(self, guide: SceneGuide,
                 thresholds: FusionThresholds = FusionThresholds()) -> None:
        self._guide, self._thresholds = guide, thresholds

    @classmethod
    def load(cls, path: Path, sha256: str, expansion: ViewExpansion, threads: int
             ) -> 'GuidedView':
        """Read a memory and compile what is compiled; ModelError as `SceneMemory.read`."""
        guide = SceneGuide(SceneMemory.read(path, sha256), expansion, threads)
        view, shown = cls(guide), guide.warm_up()
        view.fuse(expansion.crop(shown.image).astype(np.uint8), shown, None)
        return view

    def guide(self, image: np.ndarray, prior: CameraPose | None = None,
              motion: np.ndarray | None = None) -> Guide | None:
        """Find the camera and draw what is around it; None while it is lost."""
        return self._guide.guide(image, prior, motion)

    @property
    def ambiguous(self) -> bool:
        """Whether there is no guide because several places explain the last image."""
        return self._guide.ambiguous

    def needs_network(self, guide: Guide) -> bool:
        """Tell whether the memory has gaps that are worth the time of the network."""
        missing = ~guide.known
        missing[self._guide.expansion.observed] = False  # The camera shows that.
        return bool(missing.mean() > self._thresholds.most_missing)

    def fuse(self, image: np.ndarray, guide: Guide, network_image: np.ndarray | None
             ) -> tuple[np.ndarray, np.ndarray]:
        """Return wide image and expected error: see `fusion.fuse`."""
        with self._guide.loops():
            return fuse(image, guide, network_image, self._guide.expansion, self._thresholds)

    def reset(self) -> None:
        """Forget the frames so far."""
        self._guide.reset()
