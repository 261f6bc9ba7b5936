"""What the runtime needs of the memory: a wide view that shows the scene, or none."""
from collections.abc import Callable, Sequence
from functools import partial
import logging
import os
from pathlib import Path
import threading

from neo_ros.errors import ModelError
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.memory.fusion import fuse, FusionThresholds
from neo_ros.memory.journal import journal_path, JournalWriter, most_bytes
from neo_ros.memory.learning import Learn, Learner
from neo_ros.memory.learnt import read_learnt
from neo_ros.memory.light_file import Cells, lights_path, read_lights, write_lights
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.sight import Guide
import numpy as np

logger = logging.getLogger(__name__)
KeepLights = Callable[[Sequence[Cells]], None]
# While it learns, images in another light after which the lights are written, beside the images.
LIGHTS_EVERY = 600


class GuidedView:
    """Follows one camera and fuses its images with what the memory shows around them."""

    def __init__(self, guide: SceneGuide,
                 thresholds: FusionThresholds = FusionThresholds()) -> None:
        self._guide, self._thresholds = guide, thresholds
        self._keep_lights: KeepLights | None = None
        self._images = 0  # In another light, since it was written.
        self._writing: threading.Thread | None = None
        self._read_lights: Callable[[], list[Cells]] = list

    @classmethod
    def load(cls, path: Path, sha256: str, expansion: ViewExpansion, threads: int,
             learn: Learn = 'never') -> 'GuidedView':
        """
        Read a memory, and what has changed since, and compile what is compiled.

        Raises ModelError as `read_learnt`, and where it is to learn, but cannot write.
        """
        memory, journal = read_learnt(path, sha256), journal_path(path)
        if learn != 'never' and not os.access(journal if journal.exists() else path.parent,
                                              os.W_OK):
            raise ModelError(f'{journal}: cannot be written, which learning needs; copy model '
                             'and memory to a folder that can be')
        guide = SceneGuide(memory, expansion, threads)
        view, shown = cls(guide), guide.warm_up()
        view.fuse(expansion.crop(shown.image).astype(np.uint8), shown)
        lights = lights_path(path)
        view._read_lights = partial(read_lights, lights, sha256, guide.light.empty)
        view.forget_light()
        if learn != 'never':
            guide.learner = Learner(memory, expansion, partial(
                JournalWriter, journal, sha256, most_bytes(path.stat().st_size)),
                learn == 'beside')
            view._keep_lights = partial(write_lights, lights, sha256)
        return view

    def finish_learning(self) -> None:
        """Learn from what is left of the images, if it learns, and let others write."""
        if self._guide.learner is not None:
            self._guide.learner.finish()
            self._guide.learner = None
        self._write_lights()

    def stop_learning(self) -> None:
        """Let others write the journal, at once."""
        if self._guide.learner is not None:
            self._guide.learner.close()
            self._guide.learner = None
        self._write_lights()

    def _write_lights(self) -> None:
        """Keep in which lights the scene was seen, for the last time."""
        keep, self._keep_lights = self._keep_lights, None
        if self._writing is not None:
            self._writing.join()
        if keep is not None:
            _write(keep, self._guide.light.known())

    def guide(self, image: np.ndarray, prior: CameraPose | None = None,
              motion: np.ndarray | None = None, pace: float = 1.0, stamp_ns: int | None = None
              ) -> Guide | None:
        """Find the camera and draw what is around it; None while it is lost."""
        keep, light = self._keep_lights, self._guide.light
        self._images += light.other
        if keep is not None and self._images >= LIGHTS_EVERY and not (
                self._writing is not None and self._writing.is_alive()):
            self._images = 0
            known = [[cells.copy() for cells in one] for one in light.known()]
            self._writing = threading.Thread(target=_write, args=(keep, known), name='lights',
                                             daemon=True)
            self._writing.start()
        return self._guide.guide(image, prior, motion, pace, stamp_ns)

    @property
    def ambiguous(self) -> bool:
        """Whether there is no guide because several places explain the last image."""
        return self._guide.ambiguous

    def fuse(self, image: np.ndarray, guide: Guide) -> tuple[np.ndarray, np.ndarray]:
        """Return wide image and expected error: see `fusion.fuse`."""
        with self._guide.loops():
            return fuse(image, guide, self._guide.expansion, self._thresholds)

    def reset(self) -> None:
        """Forget the frames so far; the light stays."""
        self._guide.reset()

    def forget_light(self) -> None:
        """Begin with the lights that lie beside the memory, as if nothing had been seen since."""
        self._guide.light.begin(self._read_lights())


def _write(keep: KeepLights, lights: Sequence[Cells]) -> None:
    try:
        if lights:
            keep(lights)
    except ModelError as error:  # A full disk must not end the camera.
        logger.warning('learning: %s', error)
