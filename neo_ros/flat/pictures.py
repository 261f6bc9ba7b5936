"""Bitmaps of the demo flat, drawn by formula: paintings, rugs, screens, the view outside."""
from functools import lru_cache

import cv2
from neo_ros.flat.shapes import srgb
import numpy as np

NOISE_SIZE = 256


@lru_cache(maxsize=None)
def draw_picture(name: str) -> np.ndarray:
    """Draw the bitmap `name`: linear RGB float32 (h, w, 3), first row at the top."""
    kind, _, variant = name.partition('_')
    draw = {'landscape': _landscape, 'abstract': _abstract, 'portrait': _portrait,
            'rug': _rug, 'screen': _screen, 'desktop': _desktop, 'canvas': _canvas,
            'sign': _sign}[kind]
    image = draw(variant)
    image.setflags(write=False)
    return image


@lru_cache(maxsize=None)
def noise_bitmap(grain: float) -> np.ndarray:
    """Draw smooth periodic noise (256, 256, 1), mean 0, deviation 1; features of `grain` px."""
    rng = np.random.default_rng(12345)
    frequency = np.fft.fftfreq(NOISE_SIZE)
    radius = np.hypot(frequency[:, None], frequency[None, :])
    white = np.fft.fft2(rng.random((NOISE_SIZE, NOISE_SIZE)) - 0.5)
    smooth = np.fft.ifft2(white * np.exp(-(radius * grain) ** 2 * 4)).real
    return (smooth / smooth.std()).astype(np.float32)[..., None]


@lru_cache(maxsize=1)
def panorama() -> np.ndarray:
    """
    Draw the world outside, float32 (192, 1024, 3): all azimuths, elevation +60 to -60 degrees.

    Columns run counter-clockwise from +x; brightness is that of daylight seen from a room.
    """
    height, width = 192, 1024
    azimuth = (np.arange(width) + 0.5) / width * 2 * np.pi
    elevation = np.radians(60 - (np.arange(height) + 0.5) / height * 120)[:, None]
    t = np.clip(elevation / 1.0, 0, 1)[..., None]
    image = _mix(_c('dfeaf2'), _c('6fa3dc'), t ** 0.6) * 2.6 * np.ones((1, width, 1))
    cloud = _waves(azimuth[None, :] * 2, elevation * 9, 5)
    image = _mix(image, 3.0 * _c('ffffff'), (np.clip(cloud - 0.15, 0, 0.5) * 1.2
                                             * np.clip(elevation * 4, 0, 1))[..., None])
    for low, swing, code, seed in ((0.07, 0.05, '8fa6b8', 1), (0.02, 0.045, '6d8f7c', 2)):
        ridge = low + swing * _ridge(azimuth, seed)
        image = np.where((elevation < ridge)[..., None], 1.5 * _c(code), image)
    _houses(image, azimuth, elevation)
    trees = -0.13 + 0.05 * np.abs(_ridge(azimuth * 7, 4)) + 0.03 * _ridge(azimuth * 3, 5)
    leaf = _mix(_c('3f6b32'), _c('6f9c4a'), 0.5 + 0.5 * _waves(azimuth * 40, elevation * 60, 6)
                [..., None])
    image = np.where((elevation < trees)[..., None], 1.2 * leaf, image)
    meadow = _mix(_c('7fa352'), _c('a9bb6c'), 0.5 + 0.5 * _waves(azimuth * 9, elevation * 14, 7)
                  [..., None])
    image = np.where((elevation < -0.2)[..., None], 1.3 * meadow, image)
    return image.astype(np.float32)


def _houses(image: np.ndarray, azimuth: np.ndarray, elevation: np.ndarray) -> None:
    rng = np.random.default_rng(9)
    at = 0.0
    while at < 2 * np.pi - 0.2:
        wide, tall = rng.uniform(0.07, 0.16), rng.uniform(0.0, 0.11)
        wall = 1.9 * _c(('e8d9bd', 'd7b899', 'e5e0d5', 'c98f6b', 'cfd6d8')[rng.integers(5)])
        across = (azimuth - at) / wide
        inside = (across > 0) & (across < 1)
        roof = tall + 0.045 * (1 - np.abs(2 * across - 1))
        image[(elevation < roof) & inside[None]] = 1.5 * _c('9a4a36')
        image[(elevation < tall) & inside[None]] = wall
        pane = ((across * 5 % 1 > 0.35) & (across * 5 % 1 < 0.72))[None]
        pane = pane & ((elevation - tall) / 0.035 % 1 > 0.45) & (elevation < tall - 0.008)
        image[pane & inside[None]] = 0.9 * _c('52606c')
        at += wide + (rng.uniform(0.02, 0.25) if rng.random() < 0.5 else 0.0)


def _c(code: str) -> np.ndarray:
    return np.array(srgb(code), np.float32)


def _mix(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    return a + (b - a) * t


def _waves(x: np.ndarray, y: np.ndarray, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    total = np.zeros(np.broadcast(x, y).shape)
    for octave in range(5):
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        k = 1.7 ** octave
        total += np.sin(k * (np.round(3 * np.cos(angle)) * x + 3 * np.sin(angle) * y) + phase
                        + 1.5 * np.sin(k * 0.7 * y + phase)) / (1 + octave)
    return total / 2


def _ridge(x: np.ndarray, seed: int) -> np.ndarray:
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 5)
    return sum(np.sin(k * x + p) / (1 + 0.4 * k) for k, p in zip((2, 5, 9, 17, 31), phase))


def _grid(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)


def _soft(value: np.ndarray, edge: float = 0.008) -> np.ndarray:
    return np.clip(0.5 - value / edge, 0, 1)[..., None]


def _landscape(variant: str) -> np.ndarray:
    x, y = _grid(96, 144)
    skies = {'screen': ('e8a0b0', '5a4a9a', '3f4a8c', '1f6f6a', '123f3f'),
             'a': ('f4c27a', 'd9665a', '7a4a5e', '3a3550', '27304a'),
             'b': ('cfe3ee', '7fb0d6', '5f86a8', '2f6f8c', 'e2cf9c'),
             'c': ('f2e6c0', 'a8cbd0', '7fa36a', '4f7f46', '8a9a3f')}
    low, high, far, middle, near = (_c(code) for code in skies[variant])
    image = _mix(high, low, y[..., None] ** 1.2 * 1.4)
    sun = np.hypot((x - 0.68) * 1.5, y - 0.3)
    image = _mix(image, _c('fff3cf'), _soft(sun - 0.085, 0.02))
    for k, (level, colour) in enumerate(((0.52, far), (0.66, middle), (0.82, near))):
        edge = level + 0.1 * _ridge(x * (2.2 + k) + ord(variant[0]), 20 + k)
        shade = 0.85 + 0.25 * _waves(x * 9, y * 9, 30 + k)[..., None]
        image = _mix(image, colour * shade, _soft(edge - y))
    return np.clip(image, 0.01, 0.95).astype(np.float32)


def _abstract(variant: str) -> np.ndarray:
    x, y = _grid(112, 96)
    rng = np.random.default_rng(40 + ord(variant))
    palettes = {'a': ('efe6d2', 'd9502e', '1f3f5f', 'e9b23c', '2c6a73'),
                'b': ('20344a', 'e9c04a', 'd97a5a', 'efe6d2', '6fa3a8'),
                'c': ('f2efe6', '15171a', 'c9302f', '2a55a5', 'efc12f'),
                'd': ('e8c7b8', 'a8323a', '4f3a52', 'f2e3c9', '7a8f6a'),
                'e': ('dfe6df', '2f5f4f', 'd98a2b', '8a9a8f', '1f2a2f')}
    colours = [_c(code) for code in palettes[variant]]
    image = colours[0] * np.ones((*x.shape, 1))
    if variant == 'c':  # a grid of blocks
        xs, ys = (0, 0.28, 0.62, 0.8, 1), (0, 0.22, 0.55, 0.85, 1)
        fill = ((0, 3, 0, 4), (2, 0, 0, 0), (0, 0, 4, 2), (3, 0, 0, 0))
        for j in range(4):
            for i in range(4):
                cell = (x >= xs[i]) & (x < xs[i + 1]) & (y >= ys[j]) & (y < ys[j + 1])
                image[cell] = colours[(0, 0, 2, 3, 4)[fill[j][i]]]
        for line in xs[1:-1]:
            image = _mix(image, colours[1], _soft(np.abs(x - line) - 0.018))
        for line in ys[1:-1]:
            image = _mix(image, colours[1], _soft(np.abs(y - line) - 0.018))
        return image.astype(np.float32)
    return _shapes(image, colours[1:], rng, x, y)


def _shapes(image: np.ndarray, colours: list[np.ndarray], rng: np.random.Generator,
            x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Paint discs, bars and rings over an image (h, w, 3)."""
    for k in range(7):
        cx, cy, r = rng.uniform(0.1, 0.9), rng.uniform(0.1, 0.9), rng.uniform(0.1, 0.3)
        angle = rng.uniform(0, np.pi)
        u = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
        v = (y - cy) * np.cos(angle) - (x - cx) * np.sin(angle)
        shape = (np.hypot(x - cx, y - cy) - r if k % 3 == 0
                 else np.maximum(np.abs(u) - r * 1.6, np.abs(v) - r * 0.28) if k % 3 == 1
                 else np.abs(np.hypot(x - cx, y - cy) - r) - 0.025)
        image = _mix(image, colours[k % 4], _soft(shape, 0.015))
    return (image * (0.94 + 0.06 * _waves(x * 20, y * 20, 3)[..., None])).astype(np.float32)


def _canvas(number: str) -> np.ndarray:
    """Paint one of as many abstract pictures as there are numbers."""
    x, y = _grid(112, 96)
    rng = np.random.default_rng([41, int(number)])
    colours = [rng.uniform(0.03, 0.85, 3).astype(np.float32) for _ in range(5)]
    return _shapes(colours[0] * np.ones((*x.shape, 1)), colours[1:], rng, x, y)


def _sign(text: str) -> np.ndarray:
    """Letter the plate beside a door."""
    plate = np.full((48, 96), 235, np.uint8)
    cv2.putText(plate, text, (6, 34), cv2.FONT_HERSHEY_SIMPLEX, 0.9, 20, 2, cv2.LINE_AA)
    return np.repeat(((plate / 255) ** 2.2)[..., None], 3, axis=2).astype(np.float32)


def _portrait(variant: str) -> np.ndarray:
    x, y = _grid(120, 90)
    wall, hair, skin, coat = (_c(code) for code in {
        'a': ('3f5a52', '3a2416', 'd9a07a', '7a2f2f'),
        'b': ('c9a24f', '14161c', 'a8704a', '2a4a7a'),
        'c': ('8fa3b8', 'c98a3f', 'e6bd9c', '3f6b4f')}[variant])
    image = wall * (1.15 - 0.5 * np.hypot(x - 0.4, y - 0.4))[..., None]
    image = _mix(image, coat, _soft(np.hypot((x - 0.5) / 0.42, (y - 1.05) / 0.38) - 1, 0.03))
    image = _mix(image, _c('efe6d2'), _soft(np.abs(x - 0.5) - 0.75 * (0.86 - y), 0.02)
                 * _soft(0.66 - y, 0.02) * _soft(y - 0.86, 0.02))
    image = _mix(image, hair, _soft(np.hypot((x - 0.5) / 0.235, (y - 0.4) / 0.26) - 1, 0.04))
    if variant != 'b':
        image = _mix(image, hair, _soft(np.abs(x - 0.5) - 0.22) * _soft(np.abs(y - 0.52) - 0.13))
    image = _mix(image, skin * 0.8, _soft(np.maximum(np.abs(x - 0.5) - 0.07,
                                                     np.abs(y - 0.64) - 0.08), 0.02))
    face = np.hypot((x - 0.5) / 0.165, (y - 0.45) / 0.2)
    image = _mix(image, skin * (1.12 - 0.5 * (x - 0.42))[..., None], _soft(face - 1, 0.05))
    for side in (-0.065, 0.065):
        image = _mix(image, _c('241a16'), _soft(np.hypot((x - 0.5 - side) / 0.026,
                                                         (y - 0.43) / 0.013) - 1, 0.3))
    image = _mix(image, _c('9a3f3a'), _soft(np.hypot((x - 0.5) / 0.055, (y - 0.555) / 0.014) - 1,
                                            0.3))
    return np.clip(image, 0.01, 0.95).astype(np.float32)


def _rug(variant: str) -> np.ndarray:
    x, y = _grid(96, 144)
    border, field, line, dot = (_c(code) for code in {
        'living': ('7a2630', 'b5483a', 'e8d3a5', '2b4a63'),
        'bedroom': ('e6dfd0', '5f7f94', 'f2ece0', 'c98f4f')}[variant])
    edge = np.minimum(np.minimum(x, 1 - x) * 1.5, np.minimum(y, 1 - y))
    image = _mix(border, field, _soft(0.13 - edge, 0.01))
    for level in (0.025, 0.11, 0.15):
        image = _mix(image, line, _soft(np.abs(edge - level) - 0.008))
    u, v = (x * 1.5 * 8) % 1 - 0.5, (y * 8) % 1 - 0.5
    diamond = np.abs(u) + np.abs(v)
    inner = _soft(0.17 - edge, 0.01)
    image = _mix(image, line, inner * _soft(np.abs(diamond - 0.36) - 0.05, 0.08))
    image = _mix(image, dot, inner * _soft(diamond - 0.2, 0.08))
    centre = np.abs(x - 0.5) * 1.5 / 0.42 + np.abs(y - 0.5) / 0.28
    image = _mix(image, border, _soft(centre - 1, 0.03))
    image = _mix(image, line, _soft(np.abs(centre - 0.86) - 0.05, 0.03))
    image = _mix(image, dot, _soft(centre - 0.5, 0.03))
    image = _mix(image, line, _soft(centre - 0.2, 0.03))
    return (image * (0.95 + 0.05 * _waves(x * 50, y * 50, 8)[..., None])).astype(np.float32)


def _screen(_variant: str) -> np.ndarray:
    return _landscape('screen')


def _desktop(_variant: str) -> np.ndarray:
    x, y = _grid(72, 128)
    image = _mix(_c('2a4a7a'), _c('6fa3c8'), y[..., None])
    for left, right, top, bottom, code in ((0.08, 0.58, 0.12, 0.8, 'f4f4f2'),
                                           (0.5, 0.92, 0.3, 0.9, '20262e')):
        inside = np.maximum(np.maximum(left - x, x - right), np.maximum(top - y, y - bottom))
        image = _mix(image, _c(code), _soft(inside))
        text = ((y * 22 % 1 > 0.55) & (x < left + (right - left)
                * (0.55 + 0.4 * np.sin(np.floor(y * 22) * 2.3))) & (inside < -0.03))
        image = np.where(text[..., None], _c('8a9aa8'), image)
    return image.astype(np.float32)
