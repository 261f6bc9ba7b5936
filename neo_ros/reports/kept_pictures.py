"""The wide images of the best, the median and the worst frame, kept while a method is scored."""
from collections.abc import Sequence
from pathlib import Path
import shutil
from typing import Any

import cv2
from neo_ros.errors import NeoError
from neo_ros.geometry import Intrinsics
from neo_ros.machine.files import write_bytes
from neo_ros.pictures.photo import read_photo
import numpy as np


class KeptPictures:
    """
    Keep every wide image in a folder, which is emptied first; a watcher of `score_frames`.

    Only at the end it is known which frames are the best and the worst, and a method that goes by
    the frames before would not show the same again.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)

    def __call__(self, index: int, wide_image: np.ndarray) -> dict[str, float]:
        """Write the wide image (H, W, 3) RGB uint8 of a frame; it has no score to add."""
        bgr = cv2.cvtColor(wide_image, cv2.COLOR_RGB2BGR)
        write_bytes(_path(self.folder, index), cv2.imencode('.png', bgr)[1].tobytes())
        return {}

    def drop_others(self, frames: Sequence[dict[str, Any]]) -> None:
        """Remove all but the best, the median and the worst of these frames."""
        picked = set(pick_frames(frames).values())
        for index in set(range(len(frames))) - picked:
            _path(self.folder, index).unlink()


def pick_frames(frames: Sequence[dict[str, Any]], score: str = 'ring_psnr') -> dict[str, int]:
    """Return the indices of the best, the median and the worst frame by a score."""
    order = sorted(range(len(frames)), key=lambda i: frames[i][score])
    return {'best': order[-1], 'median': order[len(order) // 2], 'worst': order[0]}


def read_picture(folder: Path, index: int, target: Intrinsics) -> np.ndarray:
    """Read a kept wide image, RGB uint8 (H, W, 3); raises NeoError where it is not there."""
    path = _path(folder, index)
    image = read_photo(path)
    if image is None or image.shape[:2] != (target.height, target.width):
        raise NeoError(f'{path}: expected a picture of {target.width}x{target.height} that was '
                       'kept while scoring; score again')
    return image


def _path(folder: Path, index: int) -> Path:
    return folder / f'{index:05d}.png'
