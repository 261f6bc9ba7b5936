"""Depth images as robots publish them: they come back, and what is broken is named."""
import struct
from types import SimpleNamespace

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.messages.depth_image import depth_encoding, read_depth_image
import numpy as np
import pytest

SIZE = (12, 17)


def millimetres() -> np.ndarray:
    """Return surfaces with holes, steps and the largest number."""
    random = np.random.default_rng(1)
    depth = random.integers(500, 4000) + random.integers(-30, 30, SIZE)
    depth[3:7, 4:9] = 0
    depth[0, 0], depth[-1, -1] = 65535, 0
    return depth.astype(np.uint16)


def image(numbers: np.ndarray, encoding: str, padding: int = 0, big: bool = False
          ) -> SimpleNamespace:
    raw = numbers.astype(numbers.dtype.newbyteorder('>' if big else '<'))
    rows = raw.view(np.uint8).reshape(len(numbers), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=9)
    return SimpleNamespace(height=SIZE[0], width=SIZE[1], encoding=encoding, is_bigendian=big,
                           step=rows.shape[1], data=rows.reshape(-1))


def compressed(picture: bytes, form: str, a: float = 0, b: float = 0) -> SimpleNamespace:
    return SimpleNamespace(format=form, data=struct.pack('<iff', 0, a, b) + picture)


def png(numbers: np.ndarray) -> bytes:
    return cv2.imencode('.png', numbers)[1].tobytes()


def claiming(side: int) -> bytes:
    """Return a PNG of some bytes that says it has this many pixels a side."""
    whole = png(millimetres())
    return whole[:16] + struct.pack('>II', side, side) + whole[24:]


def rvl(numbers: np.ndarray) -> bytes:
    """Encode as Wilson's program does, number by number."""
    nibbles: list[int] = []

    def write(value: int) -> None:
        while True:
            nibble, value = value & 7, value >> 3
            nibbles.append(nibble | (8 if value else 0))
            if not value:
                return

    flat, place, last = [int(n) for n in numbers.ravel()], 0, 0
    while place < len(flat):
        for wanted in (True, False):
            end = place
            while end < len(flat) and (flat[end] == 0) == wanted:
                end += 1
            write(end - place)
            for value in [] if wanted else flat[place:end]:
                delta, last = value - last, value
                write((delta << 1) ^ (delta >> 63))
            place = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = [sum(nibble << 28 - 4 * k for k, nibble in enumerate(nibbles[i:i + 8]))
             for i in range(0, len(nibbles), 8)]
    return struct.pack(f'<ii{len(words)}I', numbers.shape[1], numbers.shape[0], *words)


DEPTH = millimetres()
METRES = np.where(DEPTH > 0, DEPTH / np.float32(1000), np.float32(np.nan)).astype(np.float32)


@pytest.mark.parametrize('message, expected', [
    (image(DEPTH, '16UC1'), DEPTH),
    (image(DEPTH, '16UC1', padding=6, big=True), DEPTH),
    (image(METRES, '32FC1', padding=4), METRES),
    (image(METRES, '32FC1', big=True), METRES),
    (compressed(png(DEPTH), '16UC1; compressedDepth png'), DEPTH),
    (compressed(png(DEPTH), '16UC1; compressedDepth'), DEPTH),
    (compressed(rvl(DEPTH), '16UC1; compressedDepth rvl'), DEPTH),
    (SimpleNamespace(format='16UC1; png compressed ', data=png(DEPTH)), DEPTH),
], ids=['mm', 'mm, padded, big-endian', 'm, padded', 'm, big-endian', 'png', 'png, old words',
        'rvl', 'no parameters'])
def test_what_was_published_is_read(message: SimpleNamespace, expected: np.ndarray) -> None:
    np.testing.assert_array_equal(read_depth_image(message), expected)


@pytest.mark.parametrize('encode, form', [(png, 'png'), (rvl, 'rvl')])
def test_metres_come_back_from_steps_of_their_inverse(encode: object, form: str) -> None:
    assert callable(encode)
    # As compressed_depth_image_transport writes it: steps of 1/z, finer near by.
    a, b = 100.0 * 101.0, 1.0 - 101.0 / 10.0
    known = np.isfinite(METRES) & (METRES < 10)
    inverse = np.where(known, a / np.where(known, METRES, 1) + b, 0).astype(np.uint16)
    found = read_depth_image(compressed(encode(inverse), f'32FC1; compressedDepth {form}', a, b))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[known], METRES[known], rtol=2e-3)
    assert not found[~known].any()


@pytest.mark.parametrize('message, reason', [
    (image(DEPTH, 'mono16'), 'encoding'),
    (SimpleNamespace(**{**vars(image(DEPTH, '16UC1')), 'step': 33}), 'step'),
    (SimpleNamespace(**{**vars(image(DEPTH, '16UC1')), 'height': 13}), 'data'),
    (SimpleNamespace(**{**vars(image(DEPTH, '16UC1')), 'height': 0}), 'size'),
    (compressed(b'', '16UC1; compressedDepth png'), 'empty'),
    (compressed(claiming(1 << 20), '16UC1; compressedDepth png'), 'size'),
    (compressed(png(DEPTH.astype(np.uint8)), '16UC1; compressedDepth png'), 'data'),
    (compressed(rvl(DEPTH)[:40], '16UC1; compressedDepth rvl'), 'data'),
    (compressed(b'abc', '16UC1; compressedDepth rvl'), 'data'),
    (compressed(struct.pack('<iii', 1 << 20, 1 << 20, 0), '16UC1; compressedDepth rvl'), 'size'),
    (compressed(struct.pack('<iiI', 4, 4, 0xffffffff), '16UC1; compressedDepth rvl'), 'data'),
    (SimpleNamespace(format='32FC1; compressedDepth png', data=png(DEPTH)), 'data'),
])
def test_what_is_no_depth_image_is_rejected(message: SimpleNamespace, reason: str) -> None:
    with pytest.raises(ImageRejected) as rejection:
        read_depth_image(message)
    assert rejection.value.reason == reason


@pytest.mark.parametrize('seed', range(30))
def test_broken_rvl_never_crashes(seed: int) -> None:
    random = np.random.default_rng(seed)
    data = bytearray(rvl(DEPTH))
    for place in random.integers(0, len(data), 5):
        data[place] = random.integers(256)
    try:
        read_depth_image(compressed(bytes(data), '16UC1; compressedDepth rvl'))
    except ImageRejected as rejection:
        assert rejection.reason in ('data', 'size')


@pytest.mark.parametrize('form, expected', [
    ('16UC1', '16UC1'), ('32FC1', '32FC1'), ('mono16', None), ('rgb8', None)])
def test_the_encoding_alone_tells(form: str, expected: str | None) -> None:
    assert depth_encoding(SimpleNamespace(encoding=form)) == expected
