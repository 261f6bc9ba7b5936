"""Reflectance of the demo flat's surfaces; every pattern is filtered to the size of a sample."""
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

from neo_ros.flat.bilinear import neighbours
from neo_ros.flat.pictures import draw_picture, noise_bitmap
from neo_ros.flat.shapes import Material
from neo_ros.machine.compiled import njit
import numpy as np


class MipMap:
    """A bitmap with its halvings; looked up at the level that fits the size of a sample."""

    def __init__(self, bitmap: np.ndarray, wrap: bool) -> None:
        self._wrap = wrap
        self._levels = [bitmap]
        while min(bitmap.shape[:2]) >= 4:
            bitmap = bitmap[:bitmap.shape[0] // 2 * 2, :bitmap.shape[1] // 2 * 2]
            bitmap = (bitmap[::2, ::2] + bitmap[1::2, ::2]
                      + bitmap[::2, 1::2] + bitmap[1::2, 1::2]) / 4
            self._levels.append(bitmap)

    def look_up(self, x: np.ndarray, y: np.ndarray, footprint: np.ndarray) -> np.ndarray:
        """Take x right and y down in [0, 1] and a footprint, all (M,), to values (M, C)."""
        pixels = np.maximum(footprint * self._levels[0].shape[0], 1e-6)
        level = np.clip(np.rint(np.log2(pixels)), 0, len(self._levels) - 1).astype(np.int8)
        result = np.empty((len(x), self._levels[0].shape[2]), np.float32)
        for index in np.unique(level):
            _interpolate(self._levels[index], self._wrap, level == index, x, y, result)
        return result


@njit(error_model='numpy', nogil=True)
def _interpolate(bitmap, wrap, chosen, x, y, result):
    height, width = bitmap.shape[:2]
    one = np.float32(1)
    for m in range(len(x)):
        if not chosen[m]:
            continue
        i0, i1, u = neighbours(x[m], width, wrap)
        j0, j1, v = neighbours(y[m], height, wrap)
        for k in range(bitmap.shape[2]):
            upper = bitmap[j0, i0, k] * (one - u) + bitmap[j0, i1, k] * u
            lower = bitmap[j1, i0, k] * (one - u) + bitmap[j1, i1, k] * u
            result[m, k] = upper * (one - v) + lower * v


@dataclass(frozen=True)
class Patch:
    """
    M points on surfaces of one material, all arrays (M,) float32.

    u, v       metres along the surface, v upwards on walls
    across, up the same within the face, 0 to 1
    footprint  metres that one sample covers on the surface
    """

    u: np.ndarray
    v: np.ndarray
    across: np.ndarray
    up: np.ndarray
    footprint: np.ndarray


def reflectance(material: Material, patch: Patch) -> np.ndarray:
    """Evaluate a material at M points: linear RGB float32 (M, 3)."""
    return _PATTERNS[material.kind](material, patch)


def pulse(x: np.ndarray, period: float, width: float, footprint: np.ndarray) -> np.ndarray:
    """Return the share of [x - footprint/2, x + footprint/2] on bars [0, width] every period."""
    footprint = np.maximum(footprint, 1e-4)

    def covered(end: np.ndarray) -> np.ndarray:
        whole = np.floor(end / period)
        return whole * width + np.minimum(end - whole * period, width)
    return np.clip((covered(x + footprint / 2) - covered(x - footprint / 2)) / footprint, 0, 1)


def _noise(u: np.ndarray, v: np.ndarray, size: float, footprint: np.ndarray,
           grain: float = 4.0) -> np.ndarray:
    """Noise (M, 1) of deviation 1 whose features are about `size` metres."""
    period = size * 256 / grain
    return _noise_mips(grain).look_up(u / period, v / period, footprint / period)


@lru_cache(maxsize=None)
def _noise_mips(grain: float) -> MipMap:
    return MipMap(noise_bitmap(grain), wrap=True)


@lru_cache(maxsize=None)
def picture_mips(name: str) -> MipMap:
    """Return the filtered bitmap of a picture."""
    return MipMap(draw_picture(name), wrap=False)


def _colours(m: Material) -> tuple[np.ndarray, np.ndarray]:
    return np.array(m.colour, np.float32), np.array(m.accent, np.float32)


def _blend(m: Material, share: np.ndarray) -> np.ndarray:
    colour, accent = _colours(m)
    return colour + (accent - colour) * share[:, None]


def _hashed(i: np.ndarray, j: np.ndarray) -> np.ndarray:
    mixed = i.astype(np.int32) * 73856 + j.astype(np.int32) * 19349
    return ((mixed * mixed >> 7) % 1009 / 1009).astype(np.float32)


def _plain(m: Material, s: Patch) -> np.ndarray:
    return np.broadcast_to(_colours(m)[0], (len(s.u), 3))


def _plaster(m: Material, s: Patch) -> np.ndarray:
    stains = 0.022 * _noise(s.u, s.v, 0.35, s.footprint)
    return _colours(m)[0] * (1 + stains + 0.02 * _noise(s.v, s.u, 0.04, s.footprint))


def _fabric(m: Material, s: Patch) -> np.ndarray:
    return _colours(m)[0] * np.maximum(1 + 0.13 * _noise(s.u, s.v, m.scale, s.footprint), 0.3)


def _wood(m: Material, s: Patch) -> np.ndarray:
    share = 0.35 + 0.22 * _noise(s.u / 9, s.v, m.scale / 4, s.footprint)[:, 0]
    return _blend(m, np.clip(share, 0, 1)) * (1 + 0.05 * _noise(s.v, s.u / 4, 0.02, s.footprint))


def _planks(m: Material, s: Patch) -> np.ndarray:
    row = np.floor(s.v / m.scale)
    shift = (row * 0.618034 % 1) * 1.3
    board = np.floor((s.u + shift) / 1.3)
    tone = _hashed(row, board)
    share = 0.15 + 0.5 * tone + 0.14 * _noise(s.u / 8 + tone * 7, s.v, 0.025, s.footprint)[:, 0]
    gap = np.maximum(pulse(s.v, m.scale, 0.006, s.footprint),
                     pulse(s.u + shift, 1.3, 0.005, s.footprint))
    return _blend(m, np.clip(share, 0, 1)) * (1 - 0.6 * gap[:, None])


def _tiles(m: Material, s: Patch) -> np.ndarray:
    i, j = np.floor(s.u / m.scale), np.floor(s.v / m.scale)
    tone = _hashed(i, j)[:, None]
    odd = (2 * (pulse(s.u, 2 * m.scale, m.scale, s.footprint) - 0.5)
           * (pulse(s.v, 2 * m.scale, m.scale, s.footprint) - 0.5) + 0.5)
    gap = np.maximum(pulse(s.u, m.scale, 0.012, s.footprint),
                     pulse(s.v, m.scale, 0.012, s.footprint))[:, None]
    marble = 0.04 * _noise(s.u, s.v, 0.05, s.footprint)
    body = _blend(m, np.clip(odd, 0, 1)) * (0.9 + 0.16 * tone + marble)
    return body + (np.float32(0.42) - body) * gap * 0.7


def _stripes(m: Material, s: Patch) -> np.ndarray:
    bars = pulse(s.u, m.scale, m.scale * 0.42, s.footprint)
    return _blend(m, bars) * (1 + 0.02 * _noise(s.u, s.v, 0.04, s.footprint))


def _damask(m: Material, s: Patch) -> np.ndarray:
    x, y = s.u * (2 * np.pi / m.scale), s.v * (2 * np.pi / (m.scale * 1.5))
    fade = np.clip(m.scale / (4 * s.footprint) - 0.25, 0, 1)
    leaf = np.cos(x) * np.cos(y) + 0.5 * np.cos(2 * x) * np.cos(2 * y) + 0.3 * np.cos(3 * y)
    return _blend(m, 0.5 + fade * (np.clip(leaf * 2 + 0.5, 0, 1) - 0.5))


def _book(m: Material, s: Patch) -> np.ndarray:
    bands = pulse(s.up, 0.66, 0.07, s.footprint * 4) * (s.up > 0.04)
    return _blend(m, bands)


def _panel(m: Material, s: Patch) -> np.ndarray:
    edge = np.minimum(np.minimum(s.across, 1 - s.across) * 0.43, np.minimum(s.up, 1 - s.up) * 2.0)
    line = pulse(edge - 0.06, 9.0, 0.012, s.footprint) * (edge < 0.2)
    return _blend(m, line) * (1 - 0.25 * line[:, None])


def _picture(m: Material, s: Patch) -> np.ndarray:
    return picture_mips(m.picture).look_up(s.across, 1 - s.up, s.footprint / 0.8)


_PATTERNS: dict[str, Callable[[Material, Patch], np.ndarray]] = {
    'plain': _plain, 'plaster': _plaster, 'fabric': _fabric, 'wood': _wood, 'planks': _planks,
    'tiles': _tiles, 'stripes': _stripes, 'damask': _damask, 'book': _book, 'panel': _panel,
    'picture': _picture}
