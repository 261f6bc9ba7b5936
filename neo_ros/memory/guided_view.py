"""What the runtime needs of the memory: a wide view that shows the scene, or none."""
from pathlib import Path

from neo_ros.geometry import ViewExpansion
from neo_ros.memory.fusion import fuse
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.scene_memory import SceneMemory
import numpy as np


class GuidedView:
    """Follows one camera and fuses its images with what the memory shows around them."""

    def __init__(self, guide: SceneGuide) -> None:
        self._guide = guide

    @classmethod
    def load(cls, path: Path, sha256: str, expansion: ViewExpansion, threads: int
             ) -> 'GuidedView':
        """Read a memory and compile what is compiled; ModelError as `SceneMemory.read`."""
        guide = SceneGuide(SceneMemory.read(path, sha256), expansion, threads)
        guide.warm_up()
        return cls(guide)

    def fuse(self, image: np.ndarray, network_image: np.ndarray
             ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return wide image and expected error, see `fusion.fuse`; None while lost."""
        guide = self._guide.guide(image)
        if guide is None:
            return None
        return fuse(image, guide, network_image, self._guide.expansion)

    def reset(self) -> None:
        """Forget the frames so far."""
        self._guide.reset()
