"""The model card: everything a user of a model file must know, inside the ONNX metadata."""
import json
from pathlib import Path
from typing import Literal

from neo_ros.errors import ModelError
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.files import whole_file
from neo_ros.runtime.onnx_file import OnnxFile, scan_onnx_file
from neo_ros.runtime.scene_check import SceneReference
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

CARD_KEY = 'neo_ros.model_card'
SCHEMA_VERSION = 1


class _Part(BaseModel):
    model_config = ConfigDict(extra='forbid', frozen=True)


class InputTensor(_Part):
    """The camera image, uint8 (1, h, w, 3)."""

    name: str = 'image'
    dtype: Literal['uint8'] = 'uint8'
    layout: Literal['NHWC'] = 'NHWC'
    colour_order: Literal['RGB'] = 'RGB'


class WideTensor(InputTensor):
    """The wide image, uint8 (1, H, W, 3), with the camera's pixels pasted in."""

    name: str = 'wide'


class ConfidenceTensor(_Part):
    """How sure the model is of each pixel, uint8 (1, H, W); 255 = sure."""

    name: str = 'confidence'
    dtype: Literal['uint8'] = 'uint8'
    layout: Literal['NHW'] = 'NHW'


class OutputTensors(_Part):
    """The two outputs of the graph."""

    wide: WideTensor = WideTensor()
    confidence: ConfidenceTensor = ConfidenceTensor()


class Parity(_Part):
    """How far ONNX Runtime and the trained torch module are apart, in steps of 1/255."""

    max_abs_error: int = Field(ge=0, le=255)
    share_within_1: float = Field(ge=0, le=1)


class MemoryFile(_Part):
    """The scene memory that belongs to a model: a file beside it."""

    # Any name of a file, never a folder: no separators, and at least one character is no dot.
    file: str = Field(  # noqa: A003
        pattern=r'^[^/\\\p{Cc}]*[^/\\.\p{Cc}][^/\\\p{Cc}]*$')
    sha256: str = Field(pattern=r'^[0-9a-f]{64}$')


class ModelCard(_Part):
    """
    What a model file says of itself.

    `expansion` holds the source intrinsics (pixels, corner at (0, 0)) and the growth at each
    side; `scores` are means over the test views, or, of what `neo export` wrote, over photos held
    out of the training; `config_hash` names the experiment;
    `gflop` is the arithmetic of one image, None in files that do not say; `scene_reference`
    tells images of other scenes apart, None: the model cannot. `memory` is None for a network
    that works alone.
    """

    schema_version: Literal[1] = 1
    scene_id: str
    expansion: ViewExpansion
    input: InputTensor = InputTensor()  # noqa: A003
    outputs: OutputTensors = OutputTensors()
    mask_polarity: Literal['255 = extrapolated, 0 = seen by the camera'] = (
        '255 = extrapolated, 0 = seen by the camera')
    network: str
    config_hash: str
    scores: dict[str, FiniteFloat] = {}
    parity: Parity
    trained_seconds: float = Field(ge=0)
    gflop: FiniteFloat | None = None
    neo_ros_version: str
    scene_reference: SceneReference | None = None
    memory: MemoryFile | None = None

    @classmethod
    def from_json(cls, text: str) -> 'ModelCard':
        """Read a card; raises ModelError that names the field, also for newer schemas."""
        try:
            fields = json.loads(text)
            version = fields['schema_version']
        except (ValueError, TypeError, KeyError):
            raise ModelError(
                f'model card: expected a JSON object with schema_version, got {text[:80]!r}'
            ) from None
        if isinstance(version, int) and version > SCHEMA_VERSION:
            raise ModelError(
                f'model card: schema_version {version} is newer than {SCHEMA_VERSION}, the '
                'newest this neo_ros knows; install a newer neo_ros or export the model again')
        try:
            return cls.model_validate(fields)
        except ValidationError as error:
            first = error.errors()[0]
            place = '.'.join(str(part) for part in first['loc'])
            raise ModelError(
                f'model card: {place}: {first["msg"]}, got {first["input"]!r:.80}') from None

    def to_json(self) -> str:
        """Return the card as it stands in the metadata of the model file."""
        return self.model_dump_json(indent=1)


def read_model_card(path: Path | str) -> ModelCard:
    """
    Return the card of a self-contained model file.

    Raises ModelError for a file that is missing, empty, truncated, not ONNX, keeps weights in
    other files, or has no card, a card of a newer schema or a wrong one.
    """
    return card_of(path, scan_onnx_file(path))


def card_of(path: Path | str, onnx_file: OnnxFile) -> ModelCard:
    """Return the card in a scanned model file; raises ModelError as `read_model_card` does."""
    if onnx_file.external_tensors:
        raise ModelError(
            f'{path}: expected one self-contained file, but {len(onnx_file.external_tensors)} '
            f'tensors are external data (first: {onnx_file.external_tensors[0]!r}); '
            'export the model again without external data')
    if CARD_KEY not in onnx_file.metadata:
        raise ModelError(
            f'{path}: no model card ({CARD_KEY}) in the metadata; expected a model that '
            '"neo train" exported')
    try:
        return ModelCard.from_json(onnx_file.metadata[CARD_KEY])
    except ModelError as error:
        raise ModelError(f'{path}: {error}') from None


def write_model_card(path: Path | str, card: ModelCard) -> None:
    """
    Put a card into an existing ONNX file, in place of the one that may be there.

    The file is replaced once the new one is whole. Raises ModelError where it cannot be written.
    """
    import onnx  # An exporter's dependency: a robot reads cards without it.

    model = onnx.load(str(path), load_external_data=False)
    kept = {entry.key: entry.value for entry in model.metadata_props}
    onnx.helper.set_model_props(model, {**kept, CARD_KEY: card.to_json()})
    try:
        with whole_file(Path(path)) as partial:
            onnx.save_model(model, str(partial))
    except OSError as error:
        raise ModelError(f'{path}: cannot write: {error.strerror}; choose another output '
                         'folder') from error
