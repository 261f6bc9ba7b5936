"""JPEG and PNG messages become RGB; damage and bombs are refused before they are unpacked."""
import array
import struct
from types import SimpleNamespace
import zlib

import cv2
from neo_ros.errors import ImageRejected
from neo_ros.messages.compressed_image import read_compressed_image
from neo_ros.pictures.header import compressed_image_size
import numpy as np
import pytest

ROWS, COLUMNS = np.indices((24, 32))
IMAGE = np.stack([ROWS * 9, COLUMNS * 7, (ROWS + COLUMNS) * 3], -1).astype(np.uint8)


def _encode(extension: str, image: np.ndarray = IMAGE, *options: int) -> bytes:
    shown = image[..., ::-1] if image.ndim == 3 else image
    return cv2.imencode(extension, shown, options)[1].tobytes()


def _message(data: bytes, form: str = '') -> SimpleNamespace:
    return SimpleNamespace(format=form, data=array.array('B', data))


def _png_of_size(width: int, height: int) -> bytes:
    """Write a PNG header that promises much, with next to nothing behind it."""
    def chunk(kind: bytes, content: bytes) -> bytes:
        return (struct.pack('>I', len(content)) + kind + content
                + struct.pack('>I', zlib.crc32(kind + content)))
    return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', width, height, 8, 2, 0,
                                                              0, 0))
            + chunk(b'IDAT', zlib.compress(bytes(1000))) + chunk(b'IEND', b''))


@pytest.mark.parametrize('form', ['png', 'rgb8; png compressed bgr8', ''])
def test_png_comes_back_to_the_bit(form: str) -> None:
    np.testing.assert_array_equal(read_compressed_image(_message(_encode('.png'), form)), IMAGE)


def test_what_image_transport_calls_compressed_rgb_is_not_swapped() -> None:
    swapped = _encode('.png', IMAGE[..., ::-1])
    found = read_compressed_image(_message(swapped, 'rgb8; png compressed rgb8'))
    np.testing.assert_array_equal(found, IMAGE)


@pytest.mark.parametrize('options', [
    (), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1), (cv2.IMWRITE_JPEG_RST_INTERVAL, 1)],
    ids=['baseline', 'progressive', 'restart markers'])
def test_jpeg_comes_back_nearly(options: tuple[int, ...]) -> None:
    data = _encode('.jpg', IMAGE, cv2.IMWRITE_JPEG_QUALITY, 100, *options)
    assert compressed_image_size(data) == (32, 24)
    found = read_compressed_image(_message(data, 'jpeg'))
    assert np.abs(found.astype(int) - IMAGE).mean() < 2
    # Cameras pad to a multiple of their transfer size.
    np.testing.assert_array_equal(read_compressed_image(_message(data + bytes(500))), found)


@pytest.mark.parametrize(('image', 'form'), [
    (IMAGE, 'bgr8; png compressed bgr8'), (IMAGE[..., ::-1], 'rgb8; png compressed rgb8'),
    (np.dstack([np.full_like(IMAGE[..., 0], 9), IMAGE])[..., [1, 2, 3, 0]], ''),
], ids=['colour', 'swapped', 'alpha'])
def test_an_opencv_that_decodes_to_bgr_only_gives_the_same(
        monkeypatch: pytest.MonkeyPatch, image: np.ndarray, form: str) -> None:
    monkeypatch.delattr(cv2, 'IMREAD_COLOR_RGB', raising=False)
    order = [2, 1, 0, 3][:image.shape[2]]
    data = cv2.imencode('.png', np.ascontiguousarray(image[..., order]))[1].tobytes()
    found = read_compressed_image(_message(data, form))
    assert found.flags['C_CONTIGUOUS']
    np.testing.assert_array_equal(found, IMAGE)


def test_grey_has_three_equal_channels() -> None:
    grey = _message(_encode('.png', IMAGE[..., 0]), 'mono8; png compressed ')
    found = read_compressed_image(grey)
    np.testing.assert_array_equal(found, np.repeat(IMAGE[..., :1], 3, axis=2))


@pytest.mark.parametrize(('data', 'form', 'reason'), [
    (b'', 'jpeg', 'empty'),
    (b'GIF89a' + bytes(100), 'gif', 'encoding'),
    (_png_of_size(60_000, 60_000), 'png', 'size'),
    (_png_of_size(0, 10), 'png', 'size'),
    (_encode('.png', IMAGE[..., 0].astype(np.uint16)), 'mono16; png compressed', 'encoding'),
    (_encode('.png'), '16UC1; compressedDepth png', 'encoding'),
    (_encode('.png', IMAGE[..., 0]), 'bayer_rggb8; png compressed bayer_rggb8', 'encoding'),
    (_encode('.jpg')[:200], 'jpeg', 'data'),
    (_encode('.jpg')[:-10], 'jpeg', 'data'),
    (_encode('.png')[:-20], 'png', 'data'),
    (b'\xff\xd8\xff', 'jpeg', 'data'),
    (_png_of_size(500, 500), 'png', 'data'),
], ids=['nothing', 'gif', 'bomb', 'no width', '16 bits', 'depth', 'bayer', 'jpeg header only',
        'jpeg cut', 'png cut', 'three bytes', 'png with too few pixels'])
def test_what_cannot_be_used_is_refused_by_reason(data: bytes, form: str, reason: str) -> None:
    with pytest.raises(ImageRejected) as refused:
        read_compressed_image(_message(data, form))
    assert refused.value.reason == reason


def test_a_jpeg_that_claims_gigapixels_is_refused_by_its_header() -> None:
    data = bytearray(_encode('.jpg'))
    frame = data.index(b'\xff\xc0')
    data[frame + 5:frame + 9] = b'\xff\xff\xff\xff'
    with pytest.raises(ImageRejected) as refused:
        read_compressed_image(_message(bytes(data)))
    assert refused.value.reason == 'size'
