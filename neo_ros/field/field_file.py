"""The file of a field: written whole, and checked before kernels trust it."""
import math
from pathlib import Path
from typing import Any

from neo_ros.errors import SceneError
from neo_ros.machine.files import whole_file
import numpy as np


def write_field(path: Path, **arrays: Any) -> None:
    """Write arrays as .npz; a kill or a full disk in between leaves the old file whole."""
    try:
        with whole_file(path) as partial, partial.open('wb') as file:
            np.savez(file, **arrays)
    except OSError as error:
        raise SceneError(f'{path}: cannot write the field: {error.strerror}') from error


def check_shapes(arrays: dict[str, np.ndarray]) -> None:
    """Raise ValueError where arrays of a file do not fit: kernels would read beyond their ends."""
    shape = arrays['shape'].tolist()
    if np.shape(shape) != (3,) or min(shape) < 2:
        raise ValueError(f'shape: expected three numbers, 2 or more, got {shape}')
    points = math.prod(shape)
    rows = int(np.unpackbits(arrays['kept'])[:points].sum())
    bits = math.ceil(points / 8)
    shapes: dict[str, list[tuple[int, ...]]] = {
        'kept': [(bits,)], 'seen': [(bits,)], 'centre': [(3,)], 'half_extent': [(3,)],
        'settings': [(4,)], 'grid': [(rows, 1 + 3 * terms) for terms in (1, 4, 9)]}
    for name, fitting in shapes.items():
        if arrays[name].shape not in fitting:
            raise ValueError(f'{name}: expected the shape {" or ".join(map(str, fitting))}, got '
                             f'{arrays[name].shape}')
