"""Lays RGB images out as any encoding of a `sensor_msgs/Image` has them, by numpy alone."""
import struct
from types import SimpleNamespace
from typing import Any

from camera_messages import header_without_a_clock
import numpy as np

BAYER = [f'bayer_{pattern}' for pattern in ('rggb', 'bggr', 'gbrg', 'grbg')]
COLOURS_8 = ['rgb8', 'bgr8', 'rgba8', 'bgra8', '8UC3', '8UC4']
COLOURS_16 = ['rgb16', 'bgr16', 'rgba16', 'bgra16']
GREYS = ['mono8', 'mono16', '8UC1', '16UC1']
YUV = ['yuv422', 'uyvy', 'yuv422_yuy2', 'yuyv', 'nv12', 'nv21', 'nv24']
ALL = [*COLOURS_8, *COLOURS_16, *GREYS, *YUV, *(
    f'{name}{bits}' for name in BAYER for bits in (8, 16))]


def flat_quarters(height: int, width: int) -> np.ndarray:
    """Return red, green, blue and grey in the four quarters, uint8 (H, W, 3)."""
    image = np.empty((height, width, 3), np.uint8)
    image[:height // 2, :width // 2] = 230, 20, 40
    image[:height // 2, width // 2:] = 20, 200, 60
    image[height // 2:, :width // 2] = 30, 50, 220
    image[height // 2:, width // 2:] = 128, 128, 128
    return image


def seen_as(rgb: np.ndarray, encoding: str) -> np.ndarray:
    """Return what is left of an image: grey encodings keep its green."""
    return np.repeat(rgb[..., 1:2], 3, axis=2) if encoding in GREYS else rgb


def encoded(rgb: np.ndarray, encoding: str) -> np.ndarray:
    """Return the rows of an image, uint8 (rows, bytes), 16-bit samples little-endian."""
    height, width = rgb.shape[:2]
    if encoding in YUV:
        return _yuv(rgb, encoding)
    if encoding.startswith('bayer'):
        pattern = encoding[len('bayer_'):].rstrip('0123456789')
        rows, columns = np.indices((height, width))
        channel = np.array(['rgb'.index(colour) for colour in pattern])[
            rows % 2 * 2 + columns % 2]
        samples = np.take_along_axis(rgb, channel[..., None], 2)
    elif encoding in GREYS:
        samples = rgb[..., 1:2]
    else:
        order = {'8UC3': 'bgr', '8UC4': 'bgra'}.get(encoding, encoding.rstrip('0123456789'))
        with_alpha = np.dstack([rgb, np.full((height, width), 77, np.uint8)])
        samples = with_alpha[..., ['rgba'.index(letter) for letter in order]]
    if encoding.endswith('16') or encoding.startswith('16'):
        # Repeating the byte is what full scale for full scale means.
        samples = samples.astype('<u2') * 257
    return np.ascontiguousarray(samples).view(np.uint8).reshape(height, -1)


def encoded_message(rgb: np.ndarray, encoding: str, padding: int = 0,
                    big_endian: bool = False, **changes: Any) -> SimpleNamespace:
    """Return something with the fields of sensor_msgs/Image; padding is bytes a row of 255."""
    rows = encoded(rgb, encoding)
    if big_endian and '16' in encoding:
        rows = rows.view('<u2').byteswap().view(np.uint8)
    row_bytes = rows.shape[1]
    if encoding == 'nv24':  # Its rows of colours are twice as long, and so is their padding.
        height = rgb.shape[0]
        colour = np.pad(rows[height:].reshape(height, -1), ((0, 0), (0, 2 * padding)),
                        constant_values=255)
        luminance = np.pad(rows[:height], ((0, 0), (0, padding)), constant_values=255)
        data = np.concatenate([luminance.reshape(-1), colour.reshape(-1)])
    else:
        data = np.pad(rows, ((0, 0), (0, padding)), constant_values=255).reshape(-1)
    fields = {'height': rgb.shape[0], 'width': rgb.shape[1], 'encoding': encoding,
              'is_bigendian': int(big_endian), 'step': row_bytes + padding, 'data': data}
    return SimpleNamespace(header=header_without_a_clock(), **(fields | changes))


def _yuv(rgb: np.ndarray, encoding: str) -> np.ndarray:
    """BT.601, as cameras send it: luminance 16 to 235, colours 16 to 240."""
    height, width = rgb.shape[:2]
    red, green, blue = np.moveaxis(rgb.astype(float) / 255, 2, 0)
    luminance = 0.299 * red + 0.587 * green + 0.114 * blue
    y, u, v = (np.rint(plane).astype(np.uint8) for plane in (
        16 + 219 * luminance, 128 + 224 * (blue - luminance) / 1.772,
        128 + 224 * (red - luminance) / 1.402))
    if encoding == 'nv24':
        return np.concatenate([y, np.stack([u, v], -1).reshape(2 * height, width)])
    if encoding in ('nv12', 'nv21'):
        pair = (u, v) if encoding == 'nv12' else (v, u)
        return np.concatenate(
            [y, np.stack([plane[::2, ::2] for plane in pair], -1).reshape(height // 2, width)])
    colour = np.empty_like(y)
    colour[:, ::2], colour[:, 1::2] = u[:, ::2], v[:, ::2]
    pair = (y, colour) if encoding in ('yuv422_yuy2', 'yuyv') else (colour, y)
    return np.stack(pair, -1).reshape(height, 2 * width)


def turned_tiff(image: np.ndarray, orientation: int, order: str = '<') -> bytes:
    """Return a TIFF of RGB uint8 that viewers are told to turn; order as `struct` has it."""
    height, width = image.shape[:2]
    tags = [(256, width), (257, height), (258, 8), (259, 1), (262, 2), (273, 0),
            (274, orientation), (277, 3), (278, height), (279, image.nbytes)]
    ends = 8 + 2 + 12 * len(tags) + 4
    tags[2], tags[5] = (258, ends), (273, ends + 6)  # Places of three numbers, and of the pixels.

    def entry(tag: int, value: int) -> bytes:
        if tag in (258, 273, 279):
            many, kind = (3, 3) if tag == 258 else (1, 4)
            return struct.pack(f'{order}HHII', tag, kind, many, value)
        return struct.pack(f'{order}HHIHH', tag, 3, 1, value, 0)

    return (struct.pack(f'{order}2sHIH', b'II' if order == '<' else b'MM', 42, 8, len(tags))
            + b''.join(entry(*tag) for tag in tags) + bytes(4)
            + struct.pack(f'{order}3H', 8, 8, 8) + image.tobytes())
