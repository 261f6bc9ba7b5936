"""Open a model file: everything that can be refused is, before a runtime sees a byte of it."""
from pathlib import Path

from neo_ros.errors import ModelError
from neo_ros.pictures.header import MAX_PIXELS
from neo_ros.runtime.model_card import card_of, ModelCard
from neo_ros.runtime.onnx_file import OnnxFile, scan_onnx_file
from neo_ros.runtime.operators import ALLOWED_OPERATORS


def open_model(path: Path | str) -> tuple[bytes, ModelCard]:
    """
    Return the bytes of a model file and its card.

    Raises ModelError as `read_model_card` does, and for operators that no model of ours has
    (custom ones, control flow), for functions of its own, and where the inputs and outputs of
    the graph are not those of the card. The bytes are what was checked: the file may be
    replaced meanwhile, and no path inside it is ever followed.
    """
    onnx_file = scan_onnx_file(path)
    card = card_of(path, onnx_file)
    _check_operators(path, onnx_file)
    _check_tensors(path, onnx_file, card)
    return onnx_file.content, card


def _check_operators(path: Path | str, onnx_file: OnnxFile) -> None:
    unknown = sorted(onnx_file.operators - ALLOWED_OPERATORS)
    if unknown or onnx_file.functions or onnx_file.graphs != 1:
        found = ', '.join(unknown) or (
            f'{onnx_file.functions} functions and {onnx_file.graphs} graphs')
        raise ModelError(
            f'{path}: expected one graph of the operators that "neo train" exports, got '
            f'{found:.200}; export the model again')


def _check_tensors(path: Path | str, onnx_file: OnnxFile, card: ModelCard) -> None:
    source, target = card.expansion.source, card.expansion.target
    # The images of a card take memory before the network has run once.
    if target.width * target.height > MAX_PIXELS:
        raise ModelError(f'{path}: expected a wide view of at most {MAX_PIXELS} pixels, got '
                         f'{target.width}x{target.height}')
    wide_shape = [1, target.height, target.width, 3]
    expected = {
        'input': {card.input.name: [1, source.height, source.width, 3]},
        'output': {card.outputs.wide.name: wide_shape,
                   card.outputs.confidence.name: wide_shape[:3]},
    }
    for kind, found in (('input', onnx_file.inputs), ('output', onnx_file.outputs)):
        wanted = {name: f'tensor(uint8) {shape}' for name, shape in expected[kind].items()}
        if found != wanted:
            raise ModelError(
                f'{path}: the model card does not agree with the graph: expected {kind} '
                f'{wanted}, got {found}; export the model again')
