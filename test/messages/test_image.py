"""Images of every encoding come back as they were; anything else is refused with its reason."""
import array
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from encoded_images import (
    ALL, BAYER, COLOURS_16, COLOURS_8, encoded_message, flat_quarters, GREYS, seen_as, YUV)
from hypothesis import given, strategies as st
from neo_ros.errors import ImageRejected
from neo_ros.messages import image_fields, read_image
from neo_ros.messages.image_encodings import ENCODINGS
import numpy as np
import pytest

DATA_TYPES: dict[str, Callable[[bytes], Any]] = {
    'bytes': bytes,
    'array': lambda data: array.array('B', data),
    'ndarray': lambda data: np.frombuffer(data, np.uint8),
}


def message(image, encoding, as_data=bytes, **changes):
    """Return a good message of this encoding, with some fields changed."""
    sent = encoded_message(image, encoding)
    return SimpleNamespace(**(vars(sent) | {'data': as_data(sent.data.tobytes())} | changes))


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 7), st.integers(0, 2**32 - 1),
       st.sampled_from([*COLOURS_8, *COLOURS_16, *GREYS]), st.booleans(),
       st.sampled_from(sorted(DATA_TYPES)))
def test_every_encoding_comes_back_also_with_padding(
        height, width, padding, seed, encoding, big_endian, data_type):
    rgb = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    padding -= padding % 2 if '16' in encoding else 0
    sent = encoded_message(rgb, encoding, padding, big_endian)
    sent.data = DATA_TYPES[data_type](sent.data.tobytes())
    result = read_image(sent, depth_as_grey=True)
    assert result.dtype == np.uint8 and result.flags.c_contiguous
    np.testing.assert_array_equal(result, seen_as(rgb, encoding))


def test_the_table_and_its_test_know_the_same_encodings():
    assert set(ENCODINGS) == set(ALL)


@pytest.mark.parametrize('bits', [8, 16])
@pytest.mark.parametrize('name', BAYER)
@pytest.mark.parametrize('size', [(4, 6), (5, 7)], ids=['even', 'odd'])
@pytest.mark.parametrize('padding, big_endian', [(0, False), (4, True)], ids=['', 'padded'])
def test_flat_colour_survives_its_bayer_mosaic(name, bits, size, padding, big_endian):
    flat = np.broadcast_to(np.array([200, 100, 30], np.uint8), size + (3,))
    result = read_image(encoded_message(flat, f'{name}{bits}', padding, big_endian))
    np.testing.assert_array_equal(result, flat)


@pytest.mark.parametrize('encoding', YUV)
@pytest.mark.parametrize('padding', [0, 6])
def test_luminance_and_colour_become_rgb(encoding, padding):
    rgb = flat_quarters(8, 12)
    result = read_image(encoded_message(rgb, encoding, padding))
    assert result.flags.c_contiguous
    # Both are rounded to 8 bits on the way.
    assert np.abs(result.astype(int) - rgb).max() <= 3


@pytest.mark.parametrize('encoding, step', [('nv12', 18), ('nv21', 24), ('nv24', 36)])
def test_planes_that_just_fit_have_no_padding_whatever_their_step_says(encoding, step):
    sent = encoded_message(flat_quarters(8, 12), encoding)
    right = read_image(sent)
    sent.step = step
    np.testing.assert_array_equal(read_image(sent), right)


@pytest.mark.parametrize('value, expected', [
    (65535, 255), (0, 0), (257, 1), (128, 0), (129, 1), (32768, 128), (4095, 16)])
def test_16_bits_keep_their_full_scale_and_are_rounded(value, expected):
    samples = np.full((3, 4), value, '<u2')
    for encoding in ('mono16', 'bayer_rggb16'):
        found = read_image(SimpleNamespace(
            height=3, width=4, step=8, encoding=encoding, is_bigendian=0, data=samples.tobytes()))
        assert (found == expected).all()


def test_depth_is_grey_only_where_that_is_asked():
    sent = encoded_message(flat_quarters(4, 4), '16UC1')
    with pytest.raises(ImageRejected, match='16UC1, which is depth') as refusal:
        read_image(sent)
    assert refusal.value.reason == 'encoding'
    np.testing.assert_array_equal(
        read_image(sent, depth_as_grey=True), read_image(encoded_message(
            flat_quarters(4, 4), 'mono16')))


def test_unpadded_rgb_is_a_view_of_the_message():
    rgb = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    sent = message(rgb, 'rgb8', as_data=DATA_TYPES['array'])
    assert np.shares_memory(read_image(sent), np.frombuffer(sent.data, np.uint8))


def test_big_endian_flag_does_not_touch_8_bit_samples():
    rgb = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    np.testing.assert_array_equal(read_image(message(rgb, 'rgb8', is_bigendian=1)), rgb)


@pytest.mark.parametrize('changes, reason', [
    ({'encoding': '32FC1'}, 'encoding'),
    ({'encoding': 'rgb16'}, 'step'),
    ({'encoding': 'yuyv', 'width': 5}, 'size'),
    ({'encoding': 'nv12', 'height': 5}, 'size'),
    ({'encoding': 'nv24', 'step': 6, 'height': 5}, 'data'),
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
        read_image(SimpleNamespace(**(vars(message(good, 'rgb8')) | changes)))
    assert refusal.value.reason == reason


sizes = st.one_of(st.integers(0, 12), st.integers(0, 2**32 - 1))


@pytest.mark.slow
@given(sizes, sizes, sizes, st.one_of(st.sampled_from(sorted(ENCODINGS)), st.text(max_size=12)),
       st.binary(max_size=600), st.integers(0, 255))
def test_any_fields_give_an_image_or_a_refusal(height, width, step, encoding, data, endian):
    sent = SimpleNamespace(height=height, width=width, step=step, encoding=encoding,
                           data=data, is_bigendian=endian)
    try:
        image = read_image(sent, depth_as_grey=endian > 9)
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
