"""The file beside a scene memory with the lights in which the scene was seen since."""
import logging
from pathlib import Path
import struct
from typing import Sequence
import zlib

from neo_ros.errors import ModelError
from neo_ros.machine.files import whole_file
from neo_ros.machine.regular_file import read_model_bytes
import numpy as np

# A light: sums by the size of cells, float32 (X, Y, Z, 4), see `light_kernels.look_up_light`.
Cells = list[np.ndarray]
logger = logging.getLogger(__name__)
SUFFIX = '.lights'
MAGIC = b'neo_ros lights 1\n'
# Behind them the SHA-256 of the memory, and the CRC-32 of the rest: numbers of two bytes, packed.
_CHECK = struct.Struct('<I')
HEADER_BYTES = len(MAGIC) + 32 + _CHECK.size
# Lights of before that are kept.
MOST_LIGHTS = 4
# Cells trust no more than this, whatever they have seen.
MOST_TRUST = 60.0
# Logarithms of brightness that can be: of 1 by 255, and the noise of two bytes.
MOST_LOG, NOISE = 6.0, 0.02


def lights_path(memory: Path) -> Path:
    """Return where the lights of a memory lie."""
    return memory.with_name(memory.name + SUFFIX)


def read_lights(path: Path, memory_sha256: str, empty: Cells) -> list[Cells]:
    """
    Return the lights in a file, in cells like the empty ones; nothing where there is none.

    A file that is damaged, or of another memory, is left aside; why is logged.
    """
    if not path.exists():
        return []
    try:
        content = read_model_bytes(path, 'lights')
        if not content.startswith(MAGIC + bytes.fromhex(memory_sha256)):
            raise ModelError(f'{path}: expected lights of the memory with sha256 {memory_sha256}')
        packed = content[HEADER_BYTES:]
        if len(content) < HEADER_BYTES or _CHECK.unpack_from(
                content, HEADER_BYTES - _CHECK.size)[0] != zlib.crc32(packed):
            raise ModelError(f'{path}: the checksum is wrong; the file is damaged')
        return _unpacked(path, packed, empty)
    except ModelError as error:
        logger.warning('%s; the memory works without it, neo memory forget deletes it', error)
        return []


def _unpacked(path: Path, packed: bytes, empty: Cells) -> list[Cells]:
    size = 2 * sum(cells.size for cells in empty)
    try:
        numbers = zlib.decompressobj().decompress(packed, MOST_LIGHTS * size + 1)
    except zlib.error as error:
        raise ModelError(f'{path}: {error}') from error
    if len(numbers) % size or len(numbers) > MOST_LIGHTS * size:
        raise ModelError(f'{path}: expected up to {MOST_LIGHTS} lights of {size} bytes each, got '
                         f'{len(numbers)} bytes')
    lights = []
    for one in np.frombuffer(numbers, np.float16).reshape(-1, size // 2).astype(np.float32):
        sums, trust = one.reshape(-1, 4)[:, :3], one.reshape(-1, 4)[:, 3:]
        with np.errstate(invalid='ignore'):
            fits = (trust >= 0) & (trust <= 1.01 * MOST_TRUST) & (
                np.abs(sums) <= MOST_LOG * trust + NOISE)
        if not fits.all():
            raise ModelError(f'{path}: expected logarithms of brightness, got other numbers')
        parts = np.split(one, np.cumsum([cells.size for cells in empty])[:-1])
        lights.append([part.reshape(cells.shape) for part, cells in zip(parts, empty)])
    return lights


def write_lights(path: Path, memory_sha256: str, lights: Sequence[Cells]) -> None:
    """Write lights, the newest of them, whole or not at all; raises ModelError."""
    packed = zlib.compress(b''.join(cells.astype('<f2').tobytes()
                                    for light in lights[-MOST_LIGHTS:] for cells in light), 6)
    try:
        with whole_file(path) as partial:
            partial.write_bytes(MAGIC + bytes.fromhex(memory_sha256)
                                + _CHECK.pack(zlib.crc32(packed)) + packed)
    except OSError as error:
        raise ModelError(f'{path}: cannot write: {error.strerror}; copy model and memory to a '
                         'folder that can be written') from error
