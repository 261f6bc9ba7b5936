"""JPEG and PNG messages become RGB; damage and bombs are refused before they are unpacked."""
import array
import struct
from types import SimpleNamespace
import zlib

import cv2
from encoded_images import BAYER, encoded, turned_tiff
from neo_ros.errors import ImageRejected
from neo_ros.messages.compressed_image import read_compressed_image
from neo_ros.pictures.header import compressed_image_size, read_header
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


def _tiff_of_size(width: int, height: int, tile: int = 0) -> bytes:
    """Write a TIFF of one directory that promises much."""
    tags = [(256, width), (257, height), (258, 8), (259, 1), (262, 1), (277, 1)]
    tags += [(322, tile), (323, tile)] if tile else []
    return (b'II*\0' + struct.pack('<IH', 8, len(tags))
            + b''.join(struct.pack('<HHII', tag, 4, 1, value) for tag, value in tags) + bytes(99))


def _webp_of_size(width: int, height: int) -> bytes:
    content = b'VP8L' + struct.pack('<IBI', 50, 0x2f, width - 1 | height - 1 << 14) + bytes(45)
    return b'RIFF' + struct.pack('<I', 4 + len(content)) + b'WEBP' + content


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
    (_encode('.png', IMAGE[..., 0].astype(np.uint16)), '16UC1; png compressed', 'encoding'),
    (_encode('.tiff', IMAGE[..., 0].astype(np.float32)), '32FC1; tiff compressed', 'encoding'),
    (b'\0\0\0\1g', 'h264', 'encoding'),
    (_encode('.webp')[:-5], 'webp', 'data'),
    (_encode('.tiff')[:9], 'tiff', 'data'),
    (b'II*\0\x08\0\0\0\xff\xff' + bytes(50), 'tiff', 'data'),
    (_tiff_of_size(60_000, 60_000), 'tiff', 'size'),
    (_tiff_of_size(40, 40, tile=60_000), 'tiff', 'size'),
    (_webp_of_size(16_000, 16_000), 'webp', 'size'),
    (_encode('.png'), '16UC1; compressedDepth png', 'encoding'),
    (_encode('.png', IMAGE[:2, :2, 0]), 'bayer_rggb8; png compressed bayer_rggb8', 'size'),
    (_encode('.jpg')[:200], 'jpeg', 'data'),
    (_encode('.jpg')[:-10], 'jpeg', 'data'),
    (_encode('.jpg')[:-10] + bytes(range(200)), 'jpeg', 'data'),
    (_encode('.png')[:-20], 'png', 'data'),
    (b'\xff\xd8\xff', 'jpeg', 'data'),
    (_png_of_size(500, 500), 'png', 'data'),
], ids=['nothing', 'gif', 'bomb', 'no width', 'depth as png', 'tiff of floats', 'video',
        'webp cut', 'tiff cut', 'tiff of many tags', 'tiff bomb', 'tiff tile bomb', 'webp bomb',
        'depth', 'small bayer', 'jpeg header only', 'jpeg cut', 'jpeg cut with a tail', 'png cut',
        'three bytes', 'png with too few pixels'])
def test_what_cannot_be_used_is_refused_by_reason(data: bytes, form: str, reason: str) -> None:
    with pytest.raises(ImageRejected) as refused:
        read_compressed_image(_message(data, form))
    assert refused.value.reason == reason


@pytest.mark.parametrize('extension', ['.jpg', '.png', '.webp'])
def test_what_lies_behind_the_end_of_a_picture_is_left_alone(extension: str) -> None:
    data = _encode(extension)
    right = read_compressed_image(_message(data))
    # An MJPEG driver's buffer holds the end of an earlier, longer picture.
    for tail in (bytes(100), bytes(range(256)) * 9, _encode(extension)[50:]):
        assert read_header(data + tail).end == len(data)
        np.testing.assert_array_equal(read_compressed_image(_message(data + tail)), right)


@pytest.mark.parametrize(('extension', 'options', 'worst'), [
    ('.webp', (cv2.IMWRITE_WEBP_QUALITY, 101), 0), ('.webp', (cv2.IMWRITE_WEBP_QUALITY, 90), 25),
    ('.tiff', (), 0), ('.tiff', (cv2.IMWRITE_TIFF_COMPRESSION, 1), 0)],
    ids=['webp', 'webp with loss', 'tiff', 'plain tiff'])
def test_webp_and_tiff_come_back(extension: str, options: tuple[int, ...], worst: int) -> None:
    data = _encode(extension, IMAGE, *options)
    assert read_header(data)[:4] == ('WebP' if 'webp' in extension else 'TIFF', 32, 24, 8)
    found = read_compressed_image(_message(data))
    assert np.abs(found.astype(int) - IMAGE).max() <= worst


@pytest.mark.parametrize('orientation', [3, 6])
def test_an_orientation_of_a_tiff_is_ignored(orientation: int) -> None:
    found = read_compressed_image(_message(turned_tiff(IMAGE, orientation), 'tiff'))
    np.testing.assert_array_equal(found, IMAGE)


@pytest.mark.parametrize('extension', ['.png', '.tiff'])
@pytest.mark.parametrize('form', ['mono16; {} compressed', 'rgb16; {} compressed bgr16', '{}'])
def test_16_bits_are_scaled_as_those_of_raw_images(extension: str, form: str) -> None:
    image = IMAGE[..., 1] if 'mono' in form else IMAGE
    data = _encode(extension, image.astype(np.uint16) * 257 + 100)
    assert read_header(data).bits == 16
    found = read_compressed_image(_message(data, form.format(extension[1:])))
    np.testing.assert_array_equal(found, np.atleast_3d(image) * np.ones(3, np.uint8))


def test_a_16_bit_depth_is_grey_only_where_that_is_asked() -> None:
    data = _encode('.png', IMAGE[..., 1].astype(np.uint16) * 257)
    found = read_compressed_image(_message(data, '16UC1; png compressed'), depth_as_grey=True)
    np.testing.assert_array_equal(found, np.repeat(IMAGE[..., 1:2], 3, axis=2))


@pytest.mark.parametrize('bits', [8, 16])
@pytest.mark.parametrize('name', BAYER)
@pytest.mark.parametrize('target', ['', ' mono8', ' {}'])
def test_a_mosaic_that_was_compressed_becomes_colour(name: str, bits: int, target: str) -> None:
    flat = np.broadcast_to(np.array([200, 100, 30], np.uint8), (8, 6, 3))
    rows = encoded(flat, f'{name}{bits}')
    data = _encode('.png', rows.view('<u2') if bits == 16 else rows)
    form = f'{name}{bits}; png compressed{target.format(f"{name}{bits}")}'
    np.testing.assert_array_equal(read_compressed_image(_message(data, form)), flat)


def test_a_mosaic_that_became_colour_before_is_left_as_it_is() -> None:
    sent = _message(_encode('.png'), 'bayer_rggb8; png compressed bgr8')
    np.testing.assert_array_equal(read_compressed_image(sent), IMAGE)


def test_a_jpeg_that_claims_gigapixels_is_refused_by_its_header() -> None:
    data = bytearray(_encode('.jpg'))
    frame = data.index(b'\xff\xc0')
    data[frame + 5:frame + 9] = b'\xff\xff\xff\xff'
    with pytest.raises(ImageRejected) as refused:
        read_compressed_image(_message(bytes(data)))
    assert refused.value.reason == 'size'
