"""Widen images with a model file: load, check, run."""
from collections.abc import Sequence
from dataclasses import dataclass
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from neo_ros.errors import ImageRejected, ModelError
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.machine.regular_file import open_model_file
from neo_ros.memory.memory_file import MOST_BYTES
from neo_ros.runtime.confidence import confidence_of
from neo_ros.runtime.model_card import MemoryFile, ModelCard
from neo_ros.runtime.model_file import open_model
from neo_ros.runtime.scene_check import SceneCheck
import numpy as np
import onnxruntime

if TYPE_CHECKING:
    from neo_ros.memory.guided_view import GuidedView
    from neo_ros.memory.learning import Learn
    from neo_ros.memory.sight import Guide

MEMORY_SUFFIX = '.memory'


@dataclass(frozen=True)
class WideView:
    """
    One widened image.

    wide_image: uint8 RGB (H, W, 3), the camera's pixels bit-identical in their window.
    confidence: uint8 (H, W), 255 = sure, see `runtime/confidence.py`.
    Both are contiguous and belong to the caller.
    guided: the scene memory knew where the camera is, and shows the scene; else the network
    alone made it up. guide: then what the memory knows, with the camera's `pose` in the scene
    and its `covariance`, `agreement`, `landmarks`, how it was `found`, and `depth()`; what is not
    asked for is not computed. It keeps the images it comes from.
    ambiguous: not guided, as several places of the scene explain the image equally well.
    """

    wide_image: np.ndarray
    confidence: np.ndarray
    guided: bool = False
    guide: 'Guide | None' = None
    ambiguous: bool = False


class FovExtrapolator:
    """
    The trained network of one scene, and its memory if there is one, on camera images.

    Deterministic: the same image gives the same bits, with a memory the same sequence of images
    since the last `reset` and `forget_light`. One instance serves one camera and one thread.
    """

    def __init__(self, session: onnxruntime.InferenceSession, card: ModelCard,
                 guided_view: 'GuidedView | None' = None) -> None:
        self._session = session
        self._guided_view = guided_view
        self._outputs = [card.outputs.wide.name, card.outputs.confidence.name]
        self.card = card
        self.scene_check = (SceneCheck(card.scene_reference, card.expansion)
                            if card.scene_reference else None)
        self.extrapolated_mask = card.expansion.extrapolated_mask
        self.extrapolated_mask.setflags(write=False)

    @classmethod
    def load(cls, path: Path | str, threads: int = 0,
             providers: Sequence[str] = ('CPUExecutionProvider',),
             guided: bool = True, learn: 'Learn' = 'never') -> 'FovExtrapolator':
        """
        Check a model file and make it ready to run; `threads` = 0 takes all cores.

        A scene memory that the card names must lie beside the file, see `memory_path`; with
        `guided` False it is left alone, and the network works by itself. What was learnt of
        changes lies in a journal beside it; `learn`: 'beside' the images, on a thread of low
        priority, or 'at once', adds to it: then `finish_learning`, or `stop_learning`.
        Runs the model once, so the first `expand` is not slower than the others.
        Raises ModelError for everything that is not a complete neo_ros model: see `open_model`;
        also when it does not give the camera's pixels back unchanged.
        """
        content, card = open_model(path)
        try:
            # From memory, so that not a single path inside the file is ever followed.
            session = onnxruntime.InferenceSession(
                content, _session_options(threads), providers=list(providers))
        except Exception as error:  # ORT raises a dozen types without a common base.
            raise ModelError(f'{path}: ONNX Runtime cannot load the model: {error}') from error
        guided_view = None
        if guided and card.memory is not None:
            # Its compiled loops take a second to load: not for models that do without.
            from neo_ros.memory.guided_view import GuidedView
            guided_view = GuidedView.load(memory_path(path, card.memory), card.memory.sha256,
                                          card.expansion, threads, learn)
        extrapolator = cls(session, card, guided_view)
        _check_observed_pixels(path, extrapolator)
        extrapolator.reset()
        return extrapolator

    @property
    def providers(self) -> list[str]:
        """What ONNX Runtime really runs the network on, best first."""
        return self._session.get_providers()

    @property
    def expansion(self) -> ViewExpansion:
        """The source and target views of the model."""
        return self.card.expansion

    def expand(self, image: np.ndarray, prior: CameraPose | None = None,
               motion: np.ndarray | None = None, pace: float = 1.0,
               stamp_ns: int | None = None) -> WideView:
        """
        Widen one camera image, uint8 RGB (h, w, 3).

        prior, motion, pace, stamp_ns: hints where the camera may be, and when it saw this, see
        `SceneGuide.guide`.
        Raises ImageRejected('size') for another shape or dtype than the model's.
        """
        source = self.expansion.source
        expected = (source.height, source.width, 3)
        if image.shape != expected or image.dtype != np.uint8:
            raise ImageRejected(
                'size', f'image: the model takes uint8 {expected} (height, width, RGB), got '
                f'{image.dtype} {image.shape}; resize or train a model for this camera')
        guided = self._guided_view
        guide = guided.guide(image, prior, motion, pace, stamp_ns) if guided else None
        if guided is None or guide is None:
            return WideView(*self._run_network(image),
                            ambiguous=guided is not None and guided.ambiguous)
        wide, error = guided.fuse(image, guide)
        return WideView(wide, confidence_of(error).astype(np.uint8), guided=True, guide=guide)

    def _run_network(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the wide image and the confidence that the network alone gives."""
        wide, confidence = self._session.run(
            self._outputs, {self.card.input.name: np.ascontiguousarray(image)[None]})
        return wide[0], confidence[0]

    def finish_learning(self) -> None:
        """Learn from the last images, too; then learn no more. Takes seconds."""
        if self._guided_view is not None:
            self._guided_view.finish_learning()

    def stop_learning(self) -> None:
        """Learn no more; the last images are not looked at."""
        if self._guided_view is not None:
            self._guided_view.stop_learning()

    def reset(self) -> None:
        """Forget where the camera was; the next image may be from anywhere."""
        if self._guided_view is not None:
            self._guided_view.reset()

    def forget_light(self) -> None:
        """Forget the light of now; the lights that are kept beside the memory are read again."""
        if self._guided_view is not None:
            self._guided_view.forget_light()


def memory_path(model: Path | str, memory: MemoryFile) -> Path:
    """
    Return where a model's memory lies: beside `model`, or beside the file it is a link to.

    Files may have been renamed, and others may have the name: its checksum tells. Where none has
    it, what has the name, or would have it.
    """
    beside, target = Path(model), Path(model).resolve()
    named = [path.with_name(memory.file) for path in (beside, target)]
    renamed = [path.with_suffix(MEMORY_SUFFIX) for path in (beside, target)]
    others = sorted(path for folder in (beside.parent, target.parent)
                    for path in folder.glob(f'*{MEMORY_SUFFIX}'))
    # Each once, the likeliest first.
    found = [path for path in dict.fromkeys([*named, *renamed, *others]) if path.exists()]
    return next((path for path in found if _checksum(path) == memory.sha256),
                next((path for path in found if path in named), named[-1]))


def _checksum(path: Path) -> str:
    """Return the SHA-256 of a file's bytes; '' where it cannot be read."""
    try:
        with open_model_file(path, 'memory', MOST_BYTES) as file:
            return hashlib.file_digest(file, 'sha256').hexdigest()
    except (ModelError, OSError):
        return ''


def _session_options(threads: int) -> onnxruntime.SessionOptions:
    onnxruntime.disable_telemetry_events()  # A robot reports to nobody.
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    # By default idle worker threads spin: a node at 5 Hz would burn whole cores.
    options.add_session_config_entry('session.intra_op.allow_spinning', '0')
    options.log_severity_level = 3  # Errors only: they are raised, warnings are for exporters.
    return options


def _check_observed_pixels(path: Path | str, extrapolator: FovExtrapolator) -> None:
    """Raise ModelError unless a noise image comes back bit-identical in its window."""
    source = extrapolator.expansion.source
    image = np.random.default_rng(0).integers(
        0, 256, (source.height, source.width, 3), np.uint8)
    try:
        wide_image = extrapolator.expand(image).wide_image
    except Exception as error:
        raise ModelError(f'{path}: the model does not run: {error}') from error
    if not np.array_equal(extrapolator.expansion.crop(wide_image), image):
        raise ModelError(
            f'{path}: the model changes pixels that the camera saw: the expansion of its card '
            'is not the one its graph pastes with; export the model again')
