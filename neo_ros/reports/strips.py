"""Strips of pictures: camera view in place, widened view, truth, error; for pages and as PNG."""
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.files import write_bytes
import numpy as np

ERROR_FULL = 96  # a mean error of so many grey levels is drawn in the brightest colour
_OUTLINE = (255, 196, 0)
_PAPER, _INK, _PALE_INK = (255, 255, 255), (24, 24, 27), (113, 113, 122)
_CELL, _GAP, _TITLE, _LABEL = 320, 8, 30, 24


@dataclass(frozen=True)
class Strip:
    """Pictures that belong together: (label, RGB uint8 image) pairs under one title."""

    title: str
    images: Sequence[tuple[str, np.ndarray]]
    note: str = ''


def frame_strip(title: str, expansion: ViewExpansion, narrow_image: np.ndarray,
                wide_image: np.ndarray, truth: np.ndarray | None = None,
                note: str = '') -> Strip:
    """
    Show one frame: the camera's view in place, the widened view, and truth and error if known.

    narrow_image (h, w, 3), wide_image and truth (H, W, 3), all RGB uint8.
    """
    placed = expansion.paste(narrow_image, _nothing_seen(expansion))
    images = [('camera view', outlined(placed, expansion)),
              ('widened view', outlined(wide_image, expansion))]
    if truth is not None:
        images += [('truth', truth), (error_label(), error_map(truth, wide_image))]
    return Strip(title, images, note)


def outlined(wide_image: np.ndarray, expansion: ViewExpansion) -> np.ndarray:
    """Return a copy of (H, W, 3) uint8 with a line around, not over, the observed window."""
    result = np.ascontiguousarray(wide_image).copy()
    rows, columns = expansion.observed
    for step in range(max(1, wide_image.shape[1] // 256)):
        cv2.rectangle(result, (columns.start - 1 - step, rows.start - 1 - step),
                      (columns.stop + step, rows.stop + step), _OUTLINE, 1)
    return result


def error_map(truth: np.ndarray, prediction: np.ndarray) -> np.ndarray:
    """Draw the mean absolute error over the channels of two uint8 images, RGB uint8."""
    error = cv2.absdiff(truth, prediction).mean(axis=2)
    levels = np.clip(error * (255 / ERROR_FULL), 0, 255).astype(np.uint8)
    return cv2.cvtColor(cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)


def error_label() -> str:
    """Say what the colours of `error_map` mean."""
    return f'error: black 0, yellow {ERROR_FULL}/255'


def write_strip_png(path: Path, strips: Sequence[Strip]) -> None:
    """
    Write one PNG with a strip per row, titles and labels drawn.

    Raises NeoError when the file cannot be written.
    """
    rows = [_drawn(strip) for strip in strips]
    width = max(row.shape[1] for row in rows)
    sheet = np.vstack([cv2.copyMakeBorder(row, 0, 0, 0, width - row.shape[1],
                                          cv2.BORDER_CONSTANT, value=_PAPER) for row in rows])
    encoded = cv2.imencode('.png', cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1]
    write_bytes(path, encoded.tobytes())


def _nothing_seen(expansion: ViewExpansion) -> np.ndarray:
    """Draw the chequered grey that stands for what no camera saw."""
    height, width = expansion.target.height, expansion.target.width
    cell = max(2, width // 32)
    rows, columns = np.indices((height, width)) // cell
    grey = np.where((rows + columns) % 2, 176, 196).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _drawn(strip: Strip) -> np.ndarray:
    cells = []
    for label, image in strip.images:
        height = round(_CELL * image.shape[0] / image.shape[1])
        shrink = image.shape[1] > _CELL
        picture = cv2.resize(image, (_CELL, height),
                             interpolation=cv2.INTER_AREA if shrink else cv2.INTER_LINEAR)
        cell = cv2.copyMakeBorder(picture, 0, _LABEL, _GAP, _GAP, cv2.BORDER_CONSTANT,
                                  value=_PAPER)
        _write(cell, label, (_GAP, height + 17), 0.42, _PALE_INK)
        cells.append(cell)
    height = max(cell.shape[0] for cell in cells)
    row = np.hstack([cv2.copyMakeBorder(cell, _TITLE, height - cell.shape[0], 0, 0,
                                        cv2.BORDER_CONSTANT, value=_PAPER) for cell in cells])
    text = f'{strip.title}   {strip.note}' if strip.note else strip.title
    _write(row, text, (_GAP, 20), 0.5, _INK)
    return row


def _write(image: np.ndarray, text: str, position: tuple[int, int], size: float,
           colour: tuple[int, int, int]) -> None:
    # OpenCV's built-in font knows ASCII only.
    cv2.putText(image, text.encode('ascii', 'replace').decode(), position,
                cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
