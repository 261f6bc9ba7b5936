"""What a compressed picture says of itself before it is decoded: its size, and its end."""
from collections.abc import Collection, Iterator
import re
from typing import Literal, NamedTuple

from neo_ros.errors import ImageRejected

# Far above any camera or view of ours: what is larger would only fill a robot's memory.
MAX_PIXELS = 64 * 1024 * 1024
JPEG_START, JPEG_END = b'\xff\xd8', b'\xff\xd9'
PNG_START, PNG_END = b'\x89PNG\r\n\x1a\n', b'IEND\xaeB`\x82'
TIFF_STARTS: dict[bytes, Literal['little', 'big']] = {b'II*\0': 'little', b'MM\0*': 'big'}
# Each scan of a progressive JPEG costs a pass over the whole picture; cameras send one, ten are
# usual, a few kilobytes could hold thousands.
MAX_SCANS = 64
# Start-of-frame markers; the other codes of their range are tables.
JPEG_FRAMES = frozenset(range(0xc0, 0xd0)) - {0xc4, 0xc8, 0xcc}
JPEG_SCAN = 0xda
# Where cameras write how they were held: a TIFF of its own without a picture.
JPEG_EXIF, EXIF_START = 0xe1, b'Exif\0\0'
# In the data of a scan: what is neither a stuffed byte, a fill byte, nor a restart.
JPEG_MARKER = re.compile(rb'\xff[^\x00\xff\xd0-\xd7]')
# TIFF: tags of the first directory that say how much memory the pixels take.
TIFF_WIDTH, TIFF_HEIGHT, TIFF_BITS, TIFF_SAMPLES, TIFF_TILE = 256, 257, 258, 277, (322, 323)
TIFF_FORMAT, TIFF_ORIENTATION = 339, 274
TIFF_SHORT = 3  # Type of a tag's numbers.
MAX_TIFF_TAGS = 256
MAX_TIFF_SAMPLES = 4


class PictureHeader(NamedTuple):
    """
    What a compressed picture is.

    kind: 'JPEG', 'PNG', 'WebP' or 'TIFF'. width, height: pixels. bits: of a sample, up to 16.
    end: bytes up to its end; drivers leave old bytes of their buffer behind it.
    """

    kind: str
    width: int
    height: int
    bits: int
    end: int


def read_header(data: bytes, most: int = MAX_PIXELS,
                kinds: Collection[str] = ('JPEG', 'PNG', 'WebP', 'TIFF')) -> PictureHeader:
    """
    Return what the header of a picture of one of these kinds says.

    Raises ImageRejected with the reason 'empty', 'encoding' (another kind, or samples that are
    not of 8 or 16 bits), 'size' (zero or above `most` pixels) or 'data' (no header, no end, or
    far too many scans).
    """
    wanted = ' or '.join(kinds)
    if not data:
        raise ImageRejected('empty', f'data: expected a {wanted}, got no bytes')
    if data.startswith(JPEG_START) and 'JPEG' in kinds:
        header = _jpeg_header(data)
    elif data.startswith(PNG_START) and 'PNG' in kinds:
        header = _png_header(data)
    elif data[:4] == b'RIFF' and data[8:12] == b'WEBP' and 'WebP' in kinds:
        header = _webp_header(data)
    elif data[:4] in TIFF_STARTS and 'TIFF' in kinds:
        header = _tiff_header(data, most)
    else:
        raise ImageRejected(
            'encoding', f'data: expected a {wanted}, got bytes that start with {data[:8]!r}')
    if min(header.width, header.height) < 1 or header.width * header.height > most:
        raise ImageRejected('size', f'size: expected 1x1 to {most} pixels, '
                            f'got {header.width}x{header.height}')
    return header


def compressed_image_size(data: bytes, most: int = MAX_PIXELS) -> tuple[int, int]:
    """
    Return (width, height) of a JPEG or a PNG of 8 bits: what memories hold and browsers show.

    Raises ImageRejected as `read_header` does.
    """
    header = read_header(data, most, ('JPEG', 'PNG'))
    if header.bits > 8:
        raise ImageRejected('encoding', f'data: expected a PNG of 8 bits, got {header.bits}')
    return header.width, header.height


def broken_picture(words: str) -> ImageRejected:
    """Make the error of a picture that cannot be decoded."""
    return ImageRejected('data', f'data: {words}; is the message truncated?')


def _png_header(data: bytes) -> PictureHeader:
    if data[12:16] != b'IHDR' or len(data) < 33:
        raise broken_picture('a PNG without a header')
    end = data.find(PNG_END)
    if end < 0:
        raise broken_picture('a PNG without an end')
    return PictureHeader('PNG', int.from_bytes(data[16:20], 'big'),
                         int.from_bytes(data[20:24], 'big'), data[24], end + len(PNG_END))


def _webp_header(data: bytes) -> PictureHeader:
    end = 8 + int.from_bytes(data[4:8], 'little')
    form, content = data[12:16], data[20:30]
    if len(data) < max(end, 30):
        raise broken_picture('a WebP without an end')
    if form == b'VP8X':
        width, height = (1 + int.from_bytes(content[at:at + 3], 'little') for at in (4, 7))
    elif form == b'VP8L' and content[0] == 0x2f:
        sides = int.from_bytes(content[1:5], 'little')
        width, height = 1 + (sides & 0x3fff), 1 + (sides >> 14 & 0x3fff)
    elif form == b'VP8 ' and content[3:6] == b'\x9d\x01\x2a':
        width, height = (int.from_bytes(content[at:at + 2], 'little') & 0x3fff for at in (6, 8))
    else:
        raise broken_picture('a WebP without a header')
    return PictureHeader('WebP', width, height, 8, end)


def _tiff_header(data: bytes, most: int) -> PictureHeader:
    """Read the first directory; a TIFF has no end of its own."""
    tags = _tiff_tags(data)
    try:
        width, height = tags[TIFF_WIDTH][0], tags[TIFF_HEIGHT][0]
    except (KeyError, IndexError):
        raise broken_picture('a TIFF without a size') from None
    bits = tags.get(TIFF_BITS) or [1]
    samples = (tags.get(TIFF_SAMPLES) or [1])[0]
    form = (tags.get(TIFF_FORMAT) or [1])[0]
    if set(bits) not in ({8}, {16}) or form != 1 or not 1 <= samples <= MAX_TIFF_SAMPLES:
        raise ImageRejected(
            'encoding', f'data: expected a TIFF of 1 to {MAX_TIFF_SAMPLES} samples of 8 or 16 '
            f'bits, got {samples} of {bits[:MAX_TIFF_SAMPLES]} in format {form}')
    across, down = ((tags.get(tag) or [1])[0] for tag in TIFF_TILE)
    if across * down > most:
        raise ImageRejected('size', f'size: expected tiles of at most {most} pixels, '
                            f'got {across}x{down}')
    return PictureHeader('TIFF', width, height, bits[0], len(data))


def _tiff_tags(data: bytes) -> dict[int, list[int]]:
    """Return the first values of the integer tags of the first directory of a TIFF."""
    order = TIFF_STARTS[data[:4]]

    def number(at: int, size: int) -> int:
        if at + size > len(data):
            raise broken_picture('a TIFF whose directory lies outside')
        return int.from_bytes(data[at:at + size], order)

    start = number(4, 4)
    count = number(start, 2)
    if count > MAX_TIFF_TAGS:
        raise broken_picture(f'a TIFF with {count} tags')
    tags: dict[int, list[int]] = {}
    for entry in range(start + 2, start + 2 + 12 * count, 12):
        size = {TIFF_SHORT: 2, 4: 4}.get(number(entry + 2, 2))
        if size is None:
            continue
        many = number(entry + 4, 4)
        at = entry + 8 if many * size <= 4 else number(entry + 8, 4)
        # More than the samples of a pixel are places of strips.
        tags[number(entry, 2)] = [
            number(at + index * size, size) for index in range(min(many, MAX_TIFF_SAMPLES))]
    return tags


def _jpeg_header(data: bytes) -> PictureHeader:
    """Walk from marker to marker to the end; the size lies before the first scan."""
    sizes = set()
    end = None
    for marker, place in _jpeg_segments(data):
        if marker in JPEG_FRAMES:
            length = int.from_bytes(data[place + 2:place + 4], 'big')
            segment = data[place + 4:place + 2 + length]
            if len(segment) < 6 or segment[0] != 8:
                raise ImageRejected('encoding', 'data: expected a JPEG of 8 bits')
            sizes.add((int.from_bytes(segment[3:5], 'big'), int.from_bytes(segment[1:3], 'big')))
        if marker == JPEG_END[1]:
            end = place + 2
    # A byte that was damaged on the way may lead astray; decoders find back.
    if end is None and data.rstrip(b'\0').endswith(JPEG_END):
        end = len(data)
    if end is None:
        raise broken_picture('a JPEG without an end')
    # Counted without walking: a decoder may see more of them than we do, but none behind the end.
    if data.count(bytes([0xff, JPEG_SCAN]), 0, end) > MAX_SCANS:
        raise broken_picture(f'a JPEG of more than {MAX_SCANS} scans')
    if len(sizes) != 1:
        raise broken_picture('a JPEG without one size')
    return PictureHeader('JPEG', *sizes.pop(), 8, end)


def jpeg_is_whole(data: bytes) -> bool:
    """
    Tell whether the picture of a JPEG file comes to its end.

    Cameras write other things behind it, and a small picture of its own into its head.
    """
    return all(data.find(JPEG_END, place) > 0
               for marker, place in _jpeg_segments(data) if marker == JPEG_SCAN)


def stored_orientation(data: bytes) -> int:
    """
    Return how the picture of a JPEG or TIFF file is stored (EXIF).

    1 as it is shown, 2 to 4 mirrored or upside down, 5 to 8 on its side. 1 where nothing says it.
    """
    if data[:4] in TIFF_STARTS:
        return _orientation(data)
    for marker, place in _jpeg_segments(data):
        length = int.from_bytes(data[place + 2:place + 4], 'big')
        segment = data[place + 4:place + 2 + length]
        if marker == JPEG_EXIF and segment.startswith(EXIF_START):
            return _orientation(segment[len(EXIF_START):])
        if marker == JPEG_SCAN:
            break
    return 1


def as_stored(data: bytes) -> bytes:
    """Return a file whose pixels OpenCV leaves as stored: it turns a TIFF, whatever it is told."""
    place = _orientation_entry(data)
    if place is None:
        return data
    order = TIFF_STARTS[data[:4]]
    upright = b''.join(value.to_bytes(size, order) for value, size in (
        (TIFF_ORIENTATION, 2), (TIFF_SHORT, 2), (1, 4), (1, 2), (0, 2)))
    return data[:place] + upright + data[place + len(upright):]


def _orientation(exif: bytes) -> int:
    """Look into the first directory; other tags of it, and what is broken, do not matter."""
    place = _orientation_entry(exif)
    if place is None:
        return 1
    value = int.from_bytes(exif[place + 8:place + 10], TIFF_STARTS[exif[:4]])
    return value if 1 <= value <= 8 else 1


def _orientation_entry(exif: bytes) -> int | None:
    """Return where the first directory of a TIFF tells the orientation; None where it does not."""
    order = TIFF_STARTS.get(exif[:4])
    if order is None:
        return None
    start = int.from_bytes(exif[4:8], order)
    count = int.from_bytes(exif[start:start + 2], order)
    for entry in range(start + 2, min(start + 2 + 12 * count, len(exif) - 11), 12):
        if int.from_bytes(exif[entry:entry + 2], order) == TIFF_ORIENTATION:
            return entry
    return None


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield each marker and its place, up to the end of the picture, that included."""
    place = 2
    while place + 2 <= len(data) and data[place] == 0xff:
        marker = data[place + 1]
        if marker == 0xff:  # A fill byte.
            place += 1
            continue
        yield marker, place
        if marker == JPEG_END[1]:
            return
        place += 2 + max(int.from_bytes(data[place + 2:place + 4], 'big'), 2)
        if marker == JPEG_SCAN:
            found = JPEG_MARKER.search(data, place)
            if found is None:
                return
            place = found.start()
