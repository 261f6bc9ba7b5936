"""What a compressed picture says of itself before it is decoded: its size, and its end."""
from collections.abc import Iterator

from neo_ros.errors import ImageRejected

# Far above any camera or view of ours: what is larger would only fill a robot's memory.
MAX_PIXELS = 64 * 1024 * 1024
JPEG_START, JPEG_END = b'\xff\xd8', b'\xff\xd9'
PNG_START, PNG_END = b'\x89PNG\r\n\x1a\n', b'IEND\xaeB`\x82'
# Each scan of a progressive JPEG costs a pass over the whole picture; cameras send one, ten are
# usual, a few kilobytes could hold thousands.
MAX_SCANS = 64
# Start-of-frame markers; the other codes of their range are tables.
JPEG_FRAMES = frozenset(range(0xc0, 0xd0)) - {0xc4, 0xc8, 0xcc}
JPEG_SCAN = 0xda


def compressed_image_size(data: bytes, most: int = MAX_PIXELS) -> tuple[int, int]:
    """
    Return (width, height) as the header of a JPEG or PNG has them.

    Raises ImageRejected with the reason 'empty', 'encoding' (no JPEG or PNG of 8 bits), 'size'
    (zero or above `most` pixels) or 'data' (no header, no end, or far too many scans).
    """
    if not data:
        raise ImageRejected('empty', 'data: expected a JPEG or PNG, got no bytes')
    if data.startswith(JPEG_START):
        width, height = _jpeg_size(data)
    elif data.startswith(PNG_START):
        width, height = _png_size(data)
    else:
        raise ImageRejected(
            'encoding', 'data: expected a JPEG or PNG, got bytes that start with '
            f'{data[:8]!r}')
    if min(width, height) < 1 or width * height > most:
        raise ImageRejected('size', f'size: expected 1x1 to {most} pixels, '
                            f'got {width}x{height}')
    return width, height


def broken_picture(words: str) -> ImageRejected:
    """Make the error of a picture that cannot be decoded."""
    return ImageRejected('data', f'data: {words}; is the message truncated?')


def _png_size(data: bytes) -> tuple[int, int]:
    if data[12:16] != b'IHDR' or len(data) < 33:
        raise broken_picture('a PNG without a header')
    if data[24] > 8:
        raise ImageRejected('encoding', f'data: expected a PNG of 8 bits, got {data[24]}')
    if not data.rstrip(b'\0').endswith(PNG_END):
        raise broken_picture('a PNG without an end')
    return int.from_bytes(data[16:20], 'big'), int.from_bytes(data[20:24], 'big')


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Walk from marker to marker up to the first scan; the size lies in between."""
    # Some drivers fill their buffer up behind the end.
    if not data.rstrip(b'\0').endswith(JPEG_END):
        raise broken_picture('a JPEG without an end')
    if data.count(bytes([0xff, JPEG_SCAN])) > MAX_SCANS:
        raise broken_picture(f'a JPEG of more than {MAX_SCANS} scans')
    sizes = set()
    for marker, place in _jpeg_segments(data):
        if marker in JPEG_FRAMES:
            length = int.from_bytes(data[place + 2:place + 4], 'big')
            segment = data[place + 4:place + 2 + length]
            if len(segment) < 6 or segment[0] != 8:
                raise ImageRejected('encoding', 'data: expected a JPEG of 8 bits')
            sizes.add((int.from_bytes(segment[3:5], 'big'), int.from_bytes(segment[1:3], 'big')))
    if len(sizes) != 1:
        raise broken_picture('a JPEG without one size')
    return sizes.pop()


def jpeg_is_whole(data: bytes) -> bool:
    """
    Tell whether the picture of a JPEG file comes to its end.

    Cameras write other things behind it, and a small picture of its own into its head.
    """
    return all(data.find(JPEG_END, place) > 0
               for marker, place in _jpeg_segments(data) if marker == JPEG_SCAN)


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield each marker and its place up to the first scan, that included."""
    place = 2
    while place + 4 <= len(data) and data[place] == 0xff:
        marker = data[place + 1]
        if marker == 0xff:  # A fill byte.
            place += 1
            continue
        yield marker, place
        if marker == JPEG_SCAN:
            return
        place += 2 + max(int.from_bytes(data[place + 2:place + 4], 'big'), 2)
