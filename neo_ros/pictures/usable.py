"""Masks of photos: which pixels show the scene, and which a person, a car or the robot itself."""
from pathlib import Path

import cv2
from neo_ros.errors import SceneError
from neo_ros.machine.files import write_bytes
from neo_ros.pictures.depth import nearest, read_numbers
import numpy as np


def read_usable(path: Path, width: int, height: int) -> np.ndarray:
    """
    Read a mask: bool (height, width), False where it is black, whose pixels are left out.

    A pixel of a smaller size is usable where all that it was made of is. Raises SceneError for
    what is no picture.
    """
    numbers = read_numbers(path)
    if numbers is None:
        raise SceneError(f'{path}: expected a mask, there is no picture that can be read')
    return shrunk(_any_channel(numbers), width, height)


def read_ignored(path: Path) -> np.ndarray | None:
    """Read a mask that is white where pixels are left out: bool (H, W), False there."""
    numbers = read_numbers(path)
    return None if numbers is None else ~_any_channel(numbers)


def shrunk(usable: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return bool (height, width) of a mask (h, w); a smaller one keeps what is usable in full."""
    if usable.shape[0] <= height or usable.shape[1] <= width:
        return nearest(usable.astype(np.uint8), width, height) > 0
    left_out = cv2.resize((~usable).astype(np.float32), (width, height),
                          interpolation=cv2.INTER_AREA)
    return left_out == 0


def write_usable(path: Path, usable: np.ndarray) -> None:
    """Write bool (H, W) as a picture: white is used, black is left out."""
    write_bytes(path, cv2.imencode('.png', usable.astype(np.uint8) * 255)[1].tobytes())


def draw_usable(random: np.random.Generator, count: int, shape: tuple[int, ...],
                usable: np.ndarray | None, shares: np.ndarray | None = None,
                listed: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
    """
    Draw photo, row and column (count,) of pixels that show the scene.

    shape: number of photos, their height and width; usable: bool of this shape, None: all are.
    shares: how often each photo is drawn, their sum is 1; None: all alike. listed: the numbers of
    all usable pixels, int (N,), drawn alike: where they are few, chance hardly meets one.
    """
    if listed is not None:
        return np.unravel_index(listed[random.integers(len(listed), size=count)], shape)

    def draw(wanted: int) -> tuple[np.ndarray, ...]:
        drawn = tuple(random.integers(size, size=wanted) for size in shape)
        return drawn if shares is None else (
            random.choice(shape[0], wanted, p=shares), *drawn[1:])

    drawn = draw(count)
    if usable is not None:
        # Another one each for those that are left out.
        while len(left_out := np.flatnonzero(~usable[drawn])):
            for numbers, again in zip(drawn, draw(len(left_out))):
                numbers[left_out] = again
    return drawn


def _any_channel(numbers: np.ndarray) -> np.ndarray:
    """Return where a picture is not black; an alpha channel says nothing of that."""
    colours = numbers[..., :3] if numbers.ndim == 3 else numbers
    return colours.any(-1) if colours.ndim == 3 else colours > 0
