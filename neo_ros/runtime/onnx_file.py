"""What can be told of an ONNX file without a runtime: metadata, operators, inputs and outputs."""
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from neo_ros.errors import ModelError
from neo_ros.machine.regular_file import read_model_bytes

# The parts of onnx.proto3 on the way from a model to its tensors: message -> field -> message.
_CHILDREN: dict[str, dict[int, str]] = {
    'model': {7: 'graph', 14: 'metadata', 20: 'training', 25: 'function'},
    'graph': {1: 'node', 5: 'tensor', 11: 'value', 12: 'value', 13: 'value', 15: 'sparse_tensor'},
    'training': {1: 'graph', 2: 'graph'},
    'function': {7: 'node', 11: 'attribute', 12: 'value'},
    'node': {5: 'attribute'},
    'attribute': {5: 'tensor', 6: 'graph', 10: 'tensor', 11: 'graph',
                  22: 'sparse_tensor', 23: 'sparse_tensor'},
    'sparse_tensor': {1: 'tensor', 2: 'tensor'},
}
_MODEL_IR_VERSION, _MODEL_GRAPH = 1, 7
_GRAPH_INPUT, _GRAPH_OUTPUT = 11, 12
_NODE_OPERATOR, _NODE_DOMAIN = 4, 7
_VALUE_NAME, _VALUE_TYPE = 1, 2
_TENSOR_NAME, _TENSOR_EXTERNAL_DATA, _TENSOR_DATA_LOCATION = 8, 13, 14
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
# TensorProto.DataType of the images.
_ELEMENT_TYPES = {1: 'float', 2: 'uint8', 3: 'int8', 6: 'int32', 7: 'int64', 10: 'float16'}

# Small fields could keep the scan busy for hours and fill the memory; our models have thousands.
MAX_PARTS = 200_000


@dataclass
class OnnxFile:
    """
    What an ONNX file consists of.

    content: the whole file, read once, so that what was checked is what runs. metadata: its
    metadata_props. external_tensors: names of the tensors kept in other files. operators: of all
    graphs, those outside the standard domain with their domain before them. inputs, outputs: of
    the main graph, by name, such as 'tensor(uint8) [1, 128, 128, 3]'. graphs: how many there are
    with branches and loop bodies; functions: how many operators it defines itself.
    """

    content: bytes = b''
    metadata: dict[str, str] = field(default_factory=dict)
    external_tensors: list[str] = field(default_factory=list)
    operators: set[str] = field(default_factory=set)
    inputs: dict[str, str] = field(default_factory=dict)
    outputs: dict[str, str] = field(default_factory=dict)
    graphs: int = 0
    functions: int = 0


def scan_onnx_file(path: Path | str) -> OnnxFile:
    """
    Read an ONNX file and walk through its protobuf messages.

    ONNX Runtime would open whatever file an external tensor names while it builds the session,
    so this has to be known before; and the onnx package is no dependency of a robot.
    Raises ModelError as `read_model_bytes` does, and for files that are truncated or not ONNX.
    """
    path = Path(path)
    content = read_model_bytes(path)
    try:
        result = _scan_model(_Reader(memoryview(content)))
    except ValueError as error:
        raise ModelError(f'{path}: not an ONNX model, or a truncated one ({error})') from None
    result.content = content
    return result


class _Reader:
    """Reads the fields of a file's messages and counts them, so that each scan ends."""

    def __init__(self, data: memoryview) -> None:
        self.data = data
        self.parts = 0

    def fields(self, start: int, stop: int) -> Iterator[tuple[int, int | tuple[int, int]]]:
        """Yield (field number, varint value or (start, stop) of the bytes) of one message."""
        while start < stop:
            self.parts += 1
            if self.parts > MAX_PARTS:
                raise ValueError(f'more than {MAX_PARTS} parts')
            tag, start = self._varint(start, stop)
            if tag >= 1 << 32:  # ONNX Runtime's parser would cut it, and see another field.
                raise ValueError(f'a tag of more than 32 bits at byte {start}')
            number, wire_type = tag >> 3, tag & 7
            value: int | tuple[int, int]
            if wire_type == _VARINT:
                value, start = self._varint(start, stop)
            else:
                if wire_type == _BYTES:
                    length, start = self._varint(start, stop)
                elif wire_type in (_FIXED64, _FIXED32):
                    length = 8 if wire_type == _FIXED64 else 4
                else:
                    raise ValueError(f'wire type {wire_type} at byte {start}')
                value = (start, start + length)
                start += length
            if number == 0 or start > stop:
                raise ValueError(f'a field runs past the end at byte {stop}' if number
                                 else f'field number 0 at byte {start}')
            yield number, value

    def _varint(self, start: int, stop: int) -> tuple[int, int]:
        value = 0
        for index in range(start, min(start + 10, stop)):
            value |= (self.data[index] & 0x7f) << 7 * (index - start)
            if self.data[index] < 0x80 and value < 1 << 64:
                return value, index + 1
        raise ValueError(f'a number does not end at byte {start}')


def _scan_model(reader: _Reader) -> OnnxFile:
    result = OnnxFile()
    whole = (0, len(reader.data))
    seen = {number for number, _ in reader.fields(*whole)}
    if not {_MODEL_IR_VERSION, _MODEL_GRAPH} <= seen:
        raise ValueError('no graph in it')
    pending = [('model', *whole)]
    while pending:
        message, start, stop = pending.pop()
        if message == 'metadata':
            entry = {number: _text(reader, value) for number, value in reader.fields(start, stop)}
            result.metadata[entry.get(1, '')] = entry.get(2, '')
        elif message == 'tensor':
            name = _external_tensor(reader, start, stop)
            if name is not None:
                result.external_tensors.append(name)
        elif message != 'value':
            result.graphs += message == 'graph'
            result.functions += message == 'function'
            if message == 'graph' and result.graphs == 1:
                result.inputs, result.outputs = _inputs_and_outputs(reader, start, stop)
            if message == 'node':
                result.operators.add(_operator(reader, start, stop))
            children = _CHILDREN[message]
            for number, value in reader.fields(start, stop):
                if number in children and isinstance(value, tuple):
                    pending.append((children[number], *value))
    return result


def _operator(reader: _Reader, start: int, stop: int) -> str:
    """Return the operator of a node, such as 'Conv' or 'com.microsoft.Gelu'."""
    parts = {number: _text(reader, value) for number, value in reader.fields(start, stop)
             if number in (_NODE_OPERATOR, _NODE_DOMAIN)}
    domain = parts.get(_NODE_DOMAIN, '')
    # 'ai.onnx' is another spelling of the standard domain.
    prefix = '' if domain in ('', 'ai.onnx') else f'{domain}.'
    return prefix + parts.get(_NODE_OPERATOR, '')


def _inputs_and_outputs(reader: _Reader, start: int,
                        stop: int) -> tuple[dict[str, str], dict[str, str]]:
    found: dict[int, dict[str, str]] = {_GRAPH_INPUT: {}, _GRAPH_OUTPUT: {}}
    for number, value in reader.fields(start, stop):
        if number in found and isinstance(value, tuple):
            name, kind = _describe_value(reader, *value)
            found[number][name] = kind
    return found[_GRAPH_INPUT], found[_GRAPH_OUTPUT]


def _describe_value(reader: _Reader, start: int, stop: int) -> tuple[str, str]:
    """Return name and type of a ValueInfoProto, such as 'tensor(uint8) [1, 4, 4, 3]'."""
    value = dict(reader.fields(start, stop))
    name = _text(reader, value.get(_VALUE_NAME, 0))
    tensor = _message(reader, _message(reader, value.get(_VALUE_TYPE)).get(1))
    shape = tensor.get(2)
    sizes = [_size(reader, dim) for _, dim in reader.fields(*shape)] if isinstance(
        shape, tuple) else '?'
    element = tensor.get(1, 0)
    kind = _ELEMENT_TYPES.get(element, str(element)) if isinstance(element, int) else '?'
    return name, f'tensor({kind}) {sizes}'


def _size(reader: _Reader, value: int | tuple[int, int]) -> object:
    """Return the number of a Dimension, or the name of one that is not fixed."""
    dimension = _message(reader, value)
    return dimension.get(1, _text(reader, dimension.get(2, 0)))


def _message(reader: _Reader, value: int | tuple[int, int] | None
             ) -> dict[int, int | tuple[int, int]]:
    """Return the fields of a part, the last of each number; nothing for no part."""
    return dict(reader.fields(*value)) if isinstance(value, tuple) else {}


def _text(reader: _Reader, value: int | tuple[int, int]) -> str:
    return bytes(reader.data[slice(*value)]).decode() if isinstance(value, tuple) else ''


def _external_tensor(reader: _Reader, start: int, stop: int) -> str | None:
    """Return the name of a tensor whose values lie in another file, else None."""
    name, external = '', False
    for number, value in reader.fields(start, stop):
        if number == _TENSOR_NAME and isinstance(value, tuple):
            name = _text(reader, value)
        # Anything but 0: a parser cuts the number to 32 bits.
        external |= number == _TENSOR_EXTERNAL_DATA or (
            number == _TENSOR_DATA_LOCATION and value != 0)
    return name if external else None
