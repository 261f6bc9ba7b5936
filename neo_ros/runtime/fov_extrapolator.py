"""Widen images with a model file: load, check, run."""
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from neo_ros.errors import ImageRejected, ModelError
from neo_ros.geometry import ViewExpansion
from neo_ros.runtime.model_card import ModelCard, read_model_card
import numpy as np
import onnxruntime


@dataclass(frozen=True)
class WideView:
    """
    One widened image.

    wide_image: uint8 RGB (H, W, 3), the camera's pixels bit-identical in their window.
    confidence: uint8 (H, W), 255 = sure.
    Both are contiguous and belong to the caller.
    """

    wide_image: np.ndarray
    confidence: np.ndarray


class FovExtrapolator:
    """
    The trained network of one scene as a function from camera images to wide views.

    Deterministic: the same image gives the same bits. Everything, compositing included, is in
    the model file; this class only checks what goes in. One instance serves one thread.
    """

    def __init__(self, session: onnxruntime.InferenceSession, card: ModelCard) -> None:
        self._session = session
        self._outputs = [card.outputs.wide.name, card.outputs.confidence.name]
        self.card = card
        self.extrapolated_mask = card.expansion.extrapolated_mask
        self.extrapolated_mask.setflags(write=False)

    @classmethod
    def load(cls, path: Path | str, threads: int = 0,
             providers: Sequence[str] = ('CPUExecutionProvider',)) -> 'FovExtrapolator':
        """
        Check a model file and make it ready to run; `threads` = 0 takes all cores.

        Runs the model once, so the first `expand` is not slower than the others.
        Raises ModelError for everything that is not a complete neo_ros model: see
        `read_model_card`; also when the graph's inputs and outputs are not those of the card
        or when it does not give the camera's pixels back unchanged.
        """
        card = read_model_card(path)
        try:
            # From memory, so that not a single path inside the file is ever followed.
            session = onnxruntime.InferenceSession(
                Path(path).read_bytes(), _session_options(threads), providers=list(providers))
        except Exception as error:  # ORT raises a dozen types without a common base.
            raise ModelError(f'{path}: ONNX Runtime cannot load the model: {error}') from error
        _check_tensors(path, session, card)
        extrapolator = cls(session, card)
        _check_observed_pixels(path, extrapolator)
        return extrapolator

    @property
    def expansion(self) -> ViewExpansion:
        """The source and target views of the model."""
        return self.card.expansion

    def expand(self, image: np.ndarray) -> WideView:
        """
        Widen one camera image, uint8 RGB (h, w, 3).

        Raises ImageRejected('size') for another shape or dtype than the model's.
        """
        source = self.expansion.source
        expected = (source.height, source.width, 3)
        if image.shape != expected or image.dtype != np.uint8:
            raise ImageRejected(
                'size', f'image: the model takes uint8 {expected} (height, width, RGB), got '
                f'{image.dtype} {image.shape}; resize or train a model for this camera')
        wide, confidence = self._session.run(
            self._outputs, {self.card.input.name: np.ascontiguousarray(image)[None]})
        return WideView(wide[0], confidence[0])


def _session_options(threads: int) -> onnxruntime.SessionOptions:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    # By default idle worker threads spin: a node at 5 Hz would burn whole cores.
    options.add_session_config_entry('session.intra_op.allow_spinning', '0')
    options.log_severity_level = 3  # Errors only: they are raised, warnings are for exporters.
    return options


def _check_tensors(path: Path | str, session: onnxruntime.InferenceSession,
                   card: ModelCard) -> None:
    """Raise ModelError unless the graph has exactly the card's inputs and outputs."""
    source, target = card.expansion.source, card.expansion.target
    wide_shape = [1, target.height, target.width, 3]
    expected = {
        'input': {card.input.name: [1, source.height, source.width, 3]},
        'output': {card.outputs.wide.name: wide_shape,
                   card.outputs.confidence.name: wide_shape[:3]},
    }
    for kind, nodes in (('input', session.get_inputs()), ('output', session.get_outputs())):
        found = {node.name: f'{node.type} {node.shape}' for node in nodes}
        wanted = {name: f'tensor(uint8) {shape}' for name, shape in expected[kind].items()}
        if found != wanted:
            raise ModelError(
                f'{path}: the model card does not agree with the graph: expected {kind} '
                f'{wanted}, got {found}; export the model again')


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
