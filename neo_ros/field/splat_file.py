"""Scenes of 3D Gaussian splatting, as gsplat, nerfstudio, PostShot and phones write them."""
from dataclasses import dataclass, replace
import math
from pathlib import Path

from neo_ros.errors import SceneError
import numpy as np

# Kerbl et al. (2023) add it to the zeroth band: colour = 0.5 + sum of basis times coefficient.
GREY = 0.5
_TYPES = {'char': 'i1', 'uchar': 'u1', 'short': '<i2', 'ushort': '<u2', 'int': '<i4',
          'uint': '<u4', 'float': '<f4', 'double': '<f8', 'int8': 'i1', 'uint8': 'u1',
          'int16': '<i2', 'uint16': '<u2', 'int32': '<i4', 'uint32': '<u4', 'float32': '<f4',
          'float64': '<f8'}


@dataclass(frozen=True, eq=False)
class Splats:
    """
    N Gaussians with opacity and colour.

    centres      float64 (N, 3)
    axes         float64 (N, 3, 3): columns are the principal axes, as long as the deviations
    opacity      float64 (N,) in (0, 1), in the middle
    harmonics    float32 (N, 3, K): coefficients of each channel, K = 1, 4 or 9
    """

    centres: np.ndarray
    axes: np.ndarray
    opacity: np.ndarray
    harmonics: np.ndarray

    def transformed(self, turn: np.ndarray) -> 'Splats':
        """Return the splats with each point x at turn (3, 3) @ x: a rotation times a scale."""
        rotation = turn / np.cbrt(np.linalg.det(turn))
        terms = self.harmonics.shape[-1]
        directions = np.random.default_rng(0).normal(size=(50, 3))
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        # Coefficients whose function of d is that of the old ones of the unturned direction.
        moved = np.linalg.pinv(basis(directions, terms)) @ basis(directions @ rotation, terms)
        return replace(self, centres=self.centres @ turn.T, axes=turn @ self.axes,
                       harmonics=(self.harmonics @ moved.T).astype(np.float32))


def basis(directions: np.ndarray, terms: int) -> np.ndarray:
    """Return what `kernels.sh_basis` fills, (N, terms), of unit directions (N, 3)."""
    x, y, z = directions.T
    return np.stack([
        np.full_like(x, 0.28209479), -0.48860251 * y, 0.48860251 * z, -0.48860251 * x,
        1.09254843 * x * y, -1.09254843 * y * z, 0.31539157 * (2 * z * z - x * x - y * y),
        -1.09254843 * x * z, 0.54627421 * (x * x - y * y)][:terms], -1)


def is_splat_file(path: Path) -> bool:
    """Tell a .ply of Gaussians from one of triangles; SceneError where it cannot be read."""
    return path.suffix.lower() == '.ply' and any(
        line.startswith(b'property') and line.endswith((b' f_dc_0', b' packed_position'))
        for line in _header(path)[0])


def read_splats(path: Path) -> Splats:
    """Read a .ply of Gaussians; raises SceneError for anything else."""
    lines, begins = _header(path)
    if b'format binary_little_endian 1.0' not in lines:
        raise SceneError(f'{path}: expected a binary .ply of splats (little endian), got '
                         f'{lines[1].decode(errors="replace")!r}; save it as such')
    fields, count = [], 0
    for line in lines:
        words = line.decode('ascii', errors='replace').split()
        if words[:2] == ['element', 'vertex']:
            count = int(words[2])
        elif words and words[0] == 'property' and count:
            fields.append((words[-1], _TYPES.get(words[1], '')))
        elif words and words[0] == 'element' and count:
            break
    names = [name for name, _ in fields]
    needed = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2', 'opacity', 'scale_0', 'scale_1',
              'rot_0', 'rot_1', 'rot_2', 'rot_3']
    missing = sorted(set(needed) - set(names))
    if missing or any(not kind for _, kind in fields):
        raise SceneError(f'{path}: expected the splats of 3D Gaussian splatting, without '
                         f'compression; it has no {", ".join(missing) or "numbers"}')
    with path.open('rb') as file:
        file.seek(begins)
        data = np.fromfile(file, np.dtype(fields), count)
    if len(data) < max(count, 1):
        raise SceneError(f'{path}: expected {max(count, 1)} splats, got {len(data)}; is the file '
                         'truncated?')
    return _splats({name: data[name].astype(np.float64) for name in names}, path)


def _splats(data: dict[str, np.ndarray], path: Path) -> Splats:
    centres = np.stack([data[name] for name in 'xyz'], -1)
    quaternion = np.stack([data[f'rot_{i}'] for i in range(4)], -1)  # w first
    # Surfels (2D Gaussian splatting) have no third scale: they are flat.
    scales = np.stack([data['scale_0'], data['scale_1'], data.get(
        'scale_2', np.full(len(centres), math.log(1e-6)))], -1)
    opacity = 1 / (1 + np.exp(-np.clip(data['opacity'], -50, 50)))
    rest = sum(name.startswith('f_rest_') for name in data) // 3
    terms = next(known for known in (9, 4, 1) if known <= rest + 1)
    harmonics = np.empty((len(centres), 3, terms), np.float32)
    for channel in range(3):
        harmonics[:, channel, 0] = data[f'f_dc_{channel}']
        for band in range(terms - 1):
            harmonics[:, channel, band + 1] = data[f'f_rest_{channel * rest + band}']
    whole = (np.isfinite(centres).all(-1) & np.isfinite(scales).all(-1)
             & np.isfinite(harmonics).all((1, 2)) & (np.linalg.norm(quaternion, axis=-1) > 0))
    if not whole.any():
        raise SceneError(f'{path}: expected splats with finite numbers, there are none')
    axes = _rotations(quaternion[whole]) * np.exp(np.minimum(scales[whole], 20))[:, None, :]
    return Splats(centres[whole], axes, opacity[whole], harmonics[whole])


def _rotations(quaternion: np.ndarray) -> np.ndarray:
    """Return rotations (N, 3, 3) of quaternions (N, 4), w first, of any length."""
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)).T
    return np.stack([
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1)], -2)


def _header(path: Path) -> tuple[list[bytes], int]:
    """Return the lines of a .ply file's header, and where what follows it begins."""
    try:
        with path.open('rb') as file:
            start = file.read(1 << 16)
    except OSError as error:
        raise SceneError(f'{path}: cannot read: {error.strerror}') from error
    end = start.find(b'end_header')
    if not start.startswith(b'ply') or end < 0:
        raise SceneError(f'{path}: expected a .ply file, it does not begin as one')
    return ([line.strip() for line in start[:end].splitlines()],
            start.find(b'\n', end) + 1)
