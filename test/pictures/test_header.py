"""How a picture is stored is told as OpenCV turns it."""
import struct

import cv2
from encoded_images import turned_tiff
from neo_ros.captures.turned_lens import shown_pixels, TURNS
from neo_ros.pictures.header import stored_orientation
from neo_ros.pictures.photo import decode_photo
import numpy as np
import pytest

ENTRY, TEXT = 0x112, 2


def exif(orientation: int, order: str = '<', kind: int = 3, before: bytes = b'') -> bytes:
    start = b'II' if order == '<' else b'MM'
    return b'Exif\0\0' + struct.pack(f'{order}2sHIH', start, 42, 8, 1 + len(before) // 12) + (
        before + struct.pack(f'{order}HHIHHI', ENTRY, kind, 1, orientation, 0, 0))


# Of the segments before the picture.
SEGMENTS: dict[str, tuple[bytes, ...]] = {
    'nothing': (), **{f'{number}': (exif(number),) for number in range(10)},
    'big endian': (exif(8, '>'),), 'long': (exif(6, kind=4),),
    'behind XMP': (b'http://ns.adobe.com/xap/1.0/\0<x/>', exif(6)),
    'the first counts': (exif(6), exif(1)), 'upright first': (exif(1), exif(6)),
    'behind a text': (exif(5, before=struct.pack('<HHII', 0x10f, TEXT, 4, 0)),),
    'cut off': (exif(6)[:21],), 'no TIFF': (b'Exif\0\0XX',), 'empty': (b'Exif\0\0',),
}


@pytest.mark.parametrize('segments', SEGMENTS.values(), ids=SEGMENTS.keys())
def test_a_jpeg_lies_on_its_side_where_opencv_turns_it(segments: tuple[bytes, ...]) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (8, 16, 3), np.uint8)
    jpeg = cv2.imencode('.jpg', picture)[1].tobytes()
    data = jpeg[:2] + b''.join(b'\xff\xe1' + struct.pack('>H', len(one) + 2) + one
                               for one in segments) + jpeg[2:]
    stored, shown = decode_photo(data), decode_photo(data, upright=True)
    assert stored is not None and shown is not None
    orientation = stored_orientation(data)
    assert (orientation > 1) == (not np.array_equal(stored, shown))
    assert (orientation > 4) == (stored.shape != shown.shape)


@pytest.mark.parametrize('order', ['<', '>'])
@pytest.mark.parametrize('orientation', TURNS)
def test_a_tiff_stays_as_stored_unless_it_is_to_be_upright(orientation: int, order: str) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (8, 16, 3), np.uint8)
    data = turned_tiff(picture, orientation, order)
    stored, shown = decode_photo(data), decode_photo(data, upright=True)
    assert stored is not None and shown is not None
    np.testing.assert_array_equal(stored, picture)
    assert stored_orientation(data) == orientation
    np.testing.assert_array_equal(shown, shown_pixels(picture, orientation))
