"""Images of every encoding come back as they were; anything else is refused with its reason."""
import array
from types import SimpleNamespace

from hypothesis import given, strategies as st
from neo_ros.errors import ImageRejected
from neo_ros.messages import image_fields, read_image
from neo_ros.messages.image import ENCODINGS
import numpy as np
import pytest

FLAT = np.array([200, 100, 30], np.uint8)  # R, G, B
BAYER = [name for name in ENCODINGS if name.startswith('bayer')]
DATA_TYPES = {
    'bytes': bytes,
    'array': lambda data: array.array('B', data),
    'ndarray': lambda data: np.frombuffer(data, np.uint8),
}


def message(image, encoding, padding=0, as_data=bytes, **changes):
    """Lay out (H, W) or (H, W, C) as a message with `padding` bytes of 255 per row."""
    rows = image.reshape(image.shape[0], -1)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    fields = {
        'height': image.shape[0], 'width': image.shape[1], 'encoding': encoding,
        'is_bigendian': 0, 'step': padded.shape[1], 'data': as_data(padded.tobytes())}
    return SimpleNamespace(**(fields | changes))


def encoded(rgb, encoding):
    """Write an RGB image the way an encoding lays it out (not Bayer)."""
    alpha = np.full(rgb.shape[:2] + (1,), 77, np.uint8)
    return {
        'rgb8': rgb,
        'bgr8': rgb[..., ::-1],
        'rgba8': np.concatenate([rgb, alpha], axis=2),
        'bgra8': np.concatenate([rgb[..., ::-1], alpha], axis=2),
        'mono8': rgb[..., 0],
    }[encoding]


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 7), st.integers(0, 2**32 - 1),
       st.sampled_from(['rgb8', 'bgr8', 'rgba8', 'bgra8', 'mono8']),
       st.sampled_from(sorted(DATA_TYPES)))
def test_every_encoding_comes_back_also_with_padding(
        height, width, padding, seed, encoding, data_type):
    rgb = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    if encoding == 'mono8':
        rgb = np.repeat(rgb[..., :1], 3, axis=2)
    result = read_image(message(encoded(rgb, encoding), encoding, padding, DATA_TYPES[data_type]))
    assert result.dtype == np.uint8 and result.flags.c_contiguous
    np.testing.assert_array_equal(result, rgb)


@pytest.mark.parametrize('encoding', BAYER)
@pytest.mark.parametrize('size', [(4, 6), (5, 7)], ids=['even', 'odd'])
@pytest.mark.parametrize('padding', [0, 3])
def test_flat_colour_survives_its_bayer_mosaic(encoding, size, padding):
    pattern = encoding[len('bayer_'):-1]  # colours of pixels (0,0), (0,1), (1,0), (1,1)
    rows, columns = np.indices(size)
    channel = np.array(['rgb'.index(colour) for colour in pattern])[rows % 2 * 2 + columns % 2]
    result = read_image(message(FLAT[channel], encoding, padding))
    np.testing.assert_array_equal(result, np.broadcast_to(FLAT, size + (3,)))


def test_unpadded_rgb_is_a_view_of_the_message():
    rgb = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    sent = message(rgb, 'rgb8', as_data=DATA_TYPES['array'])
    assert np.shares_memory(read_image(sent), np.frombuffer(sent.data, np.uint8))


def test_big_endian_flag_does_not_touch_8_bit_samples():
    rgb = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    np.testing.assert_array_equal(read_image(message(rgb, 'rgb8', is_bigendian=1)), rgb)


@pytest.mark.parametrize('changes, reason', [
    ({'encoding': 'mono16'}, 'encoding'),
    ({'encoding': '16UC1', 'is_bigendian': 1}, 'encoding'),
    ({'encoding': ''}, 'encoding'),
    ({'encoding': 'RGB8'}, 'encoding'),
    ({'height': 0}, 'size'),
    ({'width': 0}, 'size'),
    ({'height': 2**32 - 1, 'width': 2**32 - 1}, 'size'),
    ({'encoding': 'bayer_rggb8', 'height': 2}, 'size'),
    ({'step': 0}, 'step'),
    ({'step': 17}, 'step'),
    ({'data': b''}, 'empty'),
    ({'data': bytes(71)}, 'data'),
    ({'step': 2**32 - 1}, 'data'),
], ids=lambda value: str(value).replace(' ', ''))
def test_bad_images_are_refused_with_a_stable_reason(changes, reason):
    good = np.zeros((4, 6, 3), np.uint8)
    read_image(message(good, 'rgb8'))
    with pytest.raises(ImageRejected) as refusal:
        read_image(message(good, **({'encoding': 'rgb8'} | changes)))
    assert refusal.value.reason == reason


sizes = st.one_of(st.integers(0, 12), st.integers(0, 2**32 - 1))


@given(sizes, sizes, sizes, st.one_of(st.sampled_from(sorted(ENCODINGS)), st.text(max_size=12)),
       st.binary(max_size=600), st.integers(0, 255))
def test_any_fields_give_an_image_or_a_refusal(height, width, step, encoding, data, endian):
    sent = SimpleNamespace(height=height, width=width, step=step, encoding=encoding,
                           data=data, is_bigendian=endian)
    try:
        image = read_image(sent)
    except ImageRejected as refusal:
        assert refusal.reason in {'encoding', 'size', 'step', 'empty', 'data'}
    else:
        assert image.shape == (height, width, 3) and image.dtype == np.uint8


@given(st.integers(1, 9), st.integers(1, 9), st.booleans(), st.integers(0, 2**32 - 1))
def test_written_fields_read_back(height, width, colour, seed):
    shape = (height, width, 3) if colour else (height, width)
    image = np.random.default_rng(seed).integers(0, 256, shape, np.uint8)
    fields = image_fields(image)
    assert fields['data'].shape == (fields['step'] * height,)
    expected = image if colour else np.repeat(image[..., None], 3, axis=2)
    np.testing.assert_array_equal(read_image(SimpleNamespace(**fields)), expected)


@pytest.mark.parametrize('image', [
    np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4, 3), np.float32), np.zeros(4, np.uint8)],
    ids=['four channels', 'float', 'flat'])
def test_only_rgb_and_mono_are_written(image):
    with pytest.raises(ImageRejected, match='expected uint8'):
        image_fields(image)
