"""What can be told of an ONNX file without a runtime: its metadata and where its weights lie."""
from collections.abc import Iterator
from dataclasses import dataclass, field
import mmap
import os
from pathlib import Path

from neo_ros.errors import ModelError

# The parts of onnx.proto3 on the way from a model to its tensors: message -> field -> message.
_CHILDREN: dict[str, dict[int, str]] = {
    'model': {7: 'graph', 14: 'metadata', 20: 'training', 25: 'function'},
    'graph': {1: 'node', 5: 'tensor', 15: 'sparse_tensor'},
    'training': {1: 'graph', 2: 'graph'},
    'function': {7: 'node', 11: 'attribute'},
    'node': {5: 'attribute'},
    'attribute': {5: 'tensor', 6: 'graph', 10: 'tensor', 11: 'graph',
                  22: 'sparse_tensor', 23: 'sparse_tensor'},
    'sparse_tensor': {1: 'tensor', 2: 'tensor'},
}
_MODEL_IR_VERSION, _MODEL_GRAPH = 1, 7
_TENSOR_NAME, _TENSOR_EXTERNAL_DATA, _TENSOR_DATA_LOCATION = 8, 13, 14
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


@dataclass
class OnnxFile:
    """The metadata_props of a model and the names of its tensors kept in other files."""

    metadata: dict[str, str] = field(default_factory=dict)
    external_tensors: list[str] = field(default_factory=list)


def scan_onnx_file(path: Path | str) -> OnnxFile:
    """
    Walk through the protobuf messages of an ONNX file.

    ONNX Runtime would open whatever file an external tensor names while it builds the session,
    so this has to be known before; and the onnx package is no dependency of a robot.
    Raises ModelError for files that are missing, empty, truncated or not ONNX.
    """
    path = Path(path)
    try:
        with path.open('rb') as file:
            if os.fstat(file.fileno()).st_size == 0:
                raise ModelError(f'{path}: expected an ONNX model, the file is empty')
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
                with memoryview(mapped) as data:
                    return _scan_model(data)
    except FileNotFoundError:
        raise ModelError(f'{path}: no such model file') from None
    except OSError as error:
        raise ModelError(f'{path}: cannot read the model: {error.strerror}') from error
    except ValueError as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f'{path}: not an ONNX model, or a truncated one ({error})') from None


def _scan_model(data: memoryview) -> OnnxFile:
    result = OnnxFile()
    seen = {number for number, _ in _fields(data, 0, len(data))}
    if not {_MODEL_IR_VERSION, _MODEL_GRAPH} <= seen:
        raise ValueError('no graph in it')
    pending = [('model', 0, len(data))]
    while pending:
        message, start, stop = pending.pop()
        if message == 'metadata':
            entry = {number: bytes(data[slice(*value)]).decode()
                     for number, value in _fields(data, start, stop)
                     if isinstance(value, tuple)}
            result.metadata[entry.get(1, '')] = entry.get(2, '')
        elif message == 'tensor':
            name = _external_tensor(data, start, stop)
            if name is not None:
                result.external_tensors.append(name)
        else:
            children = _CHILDREN[message]
            for number, value in _fields(data, start, stop):
                if number in children and isinstance(value, tuple):
                    pending.append((children[number], *value))
    return result


def _external_tensor(data: memoryview, start: int, stop: int) -> str | None:
    """Return the name of a tensor whose values lie in another file, else None."""
    name, external = '', False
    for number, value in _fields(data, start, stop):
        if number == _TENSOR_NAME and isinstance(value, tuple):
            name = bytes(data[slice(*value)]).decode()
        external |= number == _TENSOR_EXTERNAL_DATA or (
            number == _TENSOR_DATA_LOCATION and value == 1)
    return name if external else None


def _fields(data: memoryview, start: int,
            stop: int) -> Iterator[tuple[int, int | tuple[int, int]]]:
    """Yield (field number, varint value or (start, stop) of the bytes) of one message."""
    while start < stop:
        tag, start = _varint(data, start, stop)
        number, wire_type = tag >> 3, tag & 7
        value: int | tuple[int, int]
        if wire_type == _VARINT:
            value, start = _varint(data, start, stop)
        else:
            if wire_type == _BYTES:
                length, start = _varint(data, start, stop)
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


def _varint(data: memoryview, start: int, stop: int) -> tuple[int, int]:
    value = 0
    for index in range(start, min(start + 10, stop)):
        value |= (data[index] & 0x7f) << 7 * (index - start)
        if data[index] < 0x80:
            return value, index + 1
    raise ValueError(f'a number does not end at byte {start}')
