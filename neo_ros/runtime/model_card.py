"""The model card: everything a user of a model file must know, inside the ONNX metadata."""
from dataclasses import asdict, dataclass, field, fields
from functools import partial
import json
from pathlib import Path
from typing import Any

from neo_ros.errors import ModelError, NeoError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.files import what_to_do, whole_file
from neo_ros.runtime.card_fields import (
    check_number, check_part, check_same, check_text, check_whole, read_part)
from neo_ros.runtime.onnx_file import OnnxFile, scan_onnx_file
from neo_ros.runtime.scene_check import SceneReference

CARD_KEY = 'neo_ros.model_card'
SCHEMA_VERSION = 1
MASK_POLARITY = '255 = extrapolated, 0 = seen by the camera'
_IN_NAME = r'[^/\\\x00-\x1f\x7f-\x9f]'  # No separators, no control characters.


@dataclass(frozen=True, kw_only=True)
class _Constant:
    """A tensor of the graph, of which only the name may differ."""

    name: str

    def __post_init__(self) -> None:
        check_text('name', self.name)
        for constant in fields(self):
            if constant.name != 'name':
                check_same(constant.name, getattr(self, constant.name), constant.default)


@dataclass(frozen=True, kw_only=True)
class InputTensor(_Constant):
    """The camera image, uint8 (1, h, w, 3)."""

    name: str = 'image'
    dtype: str = 'uint8'
    layout: str = 'NHWC'
    colour_order: str = 'RGB'


@dataclass(frozen=True, kw_only=True)
class WideTensor(InputTensor):
    """The wide image, uint8 (1, H, W, 3), with the camera's pixels pasted in."""

    name: str = 'wide'


@dataclass(frozen=True, kw_only=True)
class ConfidenceTensor(_Constant):
    """How sure the model is of each pixel, uint8 (1, H, W); 255 = sure."""

    name: str = 'confidence'
    dtype: str = 'uint8'
    layout: str = 'NHW'


@dataclass(frozen=True, kw_only=True)
class OutputTensors:
    """The two outputs of the graph."""

    wide: WideTensor = WideTensor()
    confidence: ConfidenceTensor = ConfidenceTensor()

    def __post_init__(self) -> None:
        check_part('wide', self.wide, WideTensor)
        check_part('confidence', self.confidence, ConfidenceTensor)


@dataclass(frozen=True, kw_only=True)
class Parity:
    """How far ONNX Runtime and the trained torch module are apart, in steps of 1/255."""

    max_abs_error: int      # largest difference of a value
    share_within_1: float   # share of the values that differ by 1 at most

    def __post_init__(self) -> None:
        check_whole('max_abs_error', self.max_abs_error, 0, 255)
        check_number('share_within_1', self.share_within_1, 0, 1)


@dataclass(frozen=True, kw_only=True)
class MemoryFile:
    """The scene memory that belongs to a model: a file beside it."""

    # Name of a file beside the model, never a folder.
    file: str  # noqa: A003
    sha256: str     # of its bytes

    def __post_init__(self) -> None:
        # Any name of a file, never a folder: no separators, and at least one character is no dot.
        check_text('file', self.file, rf'\.*(?!\.){_IN_NAME}+')
        check_text('sha256', self.sha256, '[0-9a-f]{64}')


@dataclass(frozen=True, kw_only=True)
class Update:
    """What `neo update` made a scene memory of."""

    memory: str     # sha256 of the memory before
    bag: str        # its name
    photos: int     # of the bag, that were looked at
    at: str         # when: date and time, UTC

    def __post_init__(self) -> None:
        check_text('memory', self.memory, '[0-9a-f]{64}')
        check_text('bag', self.bag)
        check_whole('photos', self.photos)
        check_text('at', self.at)


@dataclass(frozen=True, kw_only=True)
class ModelCard:
    """
    What a model file says of itself.

    Raises ModelError for fields of wrong types or out of range.
    """

    schema_version: int = SCHEMA_VERSION
    scene_id: str               # name of the scene folder
    # Source intrinsics (pixels, the image's corner at (0, 0)), and pixels added at each side.
    expansion: ViewExpansion
    # The camera image, uint8 RGB (1, h, w, 3).
    input: InputTensor = InputTensor()  # noqa: A003
    # The wide image, uint8 RGB (1, H, W, 3), and the confidence, uint8 (1, H, W).
    outputs: OutputTensors = OutputTensors()
    mask_polarity: str = MASK_POLARITY
    network: str                # neo_fast, mat or lama
    config_hash: str            # of all settings of the experiment
    # Means over the test frames, or, of what `neo export` wrote, over held-out photos.
    scores: dict[str, float] = field(default_factory=dict)
    parity: Parity              # how far ONNX Runtime and torch are apart
    trained_seconds: float
    gflop: float | None = None  # arithmetic of one image; None in files that do not say
    neo_ros_version: str
    # What images of the scene look like; None: the model cannot tell other scenes apart.
    scene_reference: SceneReference | None = None
    memory: MemoryFile | None = None    # the scene memory; None: the network works alone
    arbitrary_scale: bool = False       # nobody knows how long a unit of the scene is
    updates: tuple[Update, ...] = ()    # of the memory since the training, the oldest first

    def __post_init__(self) -> None:
        check_same('schema_version', self.schema_version, SCHEMA_VERSION)
        check_same('mask_polarity', self.mask_polarity, MASK_POLARITY)
        for name in ('scene_id', 'network', 'config_hash', 'neo_ros_version'):
            check_text(name, getattr(self, name))
        for name, kind in (('expansion', ViewExpansion), ('input', InputTensor),
                           ('outputs', OutputTensors), ('scores', dict), ('parity', Parity)):
            check_part(name, getattr(self, name), kind)
        for name, value in self.scores.items():
            check_text('scores', name)
            check_number(f'scores.{name}', value)
        check_number('trained_seconds', self.trained_seconds, 0)
        if self.gflop is not None:
            check_number('gflop', self.gflop)
        if self.scene_reference is not None:
            check_part('scene_reference', self.scene_reference, SceneReference)
        check_part('arbitrary_scale', self.arbitrary_scale, bool)
        if self.memory is not None:
            check_part('memory', self.memory, MemoryFile)
        check_part('updates', self.updates, tuple)
        for update in self.updates:
            check_part('updates', update, Update)

    @classmethod
    def from_json(cls, text: str) -> 'ModelCard':
        """Read a card; raises ModelError that names the field, also for newer schemas."""
        try:
            found = json.loads(text)
            version = found['schema_version']
        except (ValueError, TypeError, KeyError, RecursionError):
            raise ModelError(
                f'model card: expected a JSON object with schema_version, got {text[:80]!r}'
            ) from None
        if isinstance(version, int) and version > SCHEMA_VERSION:
            raise ModelError(
                f'model card: schema_version {version} is newer than {SCHEMA_VERSION}, the '
                'newest this neo_ros knows; install a newer neo_ros or export the model again')
        try:
            card: ModelCard = read_part(cls, found, **_READERS)
        except NeoError as error:
            raise ModelError(f'model card: {error}') from None
        return card

    def to_json(self) -> str:
        """Return the card as it stands in the metadata of the model file."""
        return json.dumps(asdict(self), indent=1, ensure_ascii=False, allow_nan=False)


_READERS: dict[str, Any] = {
    'expansion': partial(read_part, ViewExpansion, source=partial(read_part, Intrinsics)),
    'input': partial(read_part, InputTensor),
    'outputs': partial(read_part, OutputTensors, wide=partial(read_part, WideTensor),
                       confidence=partial(read_part, ConfidenceTensor)),
    'parity': partial(read_part, Parity),
    'scene_reference': partial(read_part, SceneReference),
    'memory': partial(read_part, MemoryFile),
    'updates': partial(read_part, Update),
}


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
        raise ModelError(f'{path}: cannot write: {error.strerror}; '
                         + what_to_do(error, 'choose another output folder')) from error
