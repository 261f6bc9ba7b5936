"""Write a report: one HTML file that needs nothing else, from texts, tables, strips and plots."""
import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import jinja2
from neo_ros.machine.files import write_bytes
from neo_ros.reports.page import PAGE
from neo_ros.reports.plot import Plot, plot_svg, Series
from neo_ros.reports.strips import Strip
import numpy as np

__all__ = ['Picture', 'Plot', 'Series', 'Strip', 'Table', 'Text', 'write_report']

_PNG_UP_TO_PIXELS = 160 * 160  # JPEG saves nothing on pictures this small


@dataclass(frozen=True)
class Text:
    """A paragraph, with a heading if `title` is not empty. Line breaks are kept."""

    text: str
    title: str = ''


@dataclass(frozen=True)
class Table:
    """Rows of ready-made cells; the first column names the row, `strong_row` is marked."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ''
    note: str = ''
    strong_row: int | None = None


@dataclass(frozen=True, eq=False)
class Picture:
    """One large picture, RGB uint8 (H, W, 3), with a heading."""

    title: str
    image: np.ndarray
    note: str = ''


Section = Text | Table | Strip | Plot | Picture


def write_report(path: Path, title: str, sections: Sequence[Section]) -> None:
    """
    Write the sections in their order as one self-contained HTML page.

    All text is escaped, pictures are embedded. Raises NeoError when the file cannot be written.
    """
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True,
                                     undefined=jinja2.StrictUndefined)
    environment.filters['picture_uri'] = picture_uri
    environment.filters['plot_uri'] = lambda plot: data_uri('svg+xml', plot_svg(plot))
    page = environment.from_string(PAGE).render(
        title=title, sections=[(type(section).__name__, section) for section in sections])
    write_bytes(Path(path), page.encode())


def picture_uri(image: np.ndarray) -> str:
    """Encode an RGB uint8 (H, W, 3) picture as a data URI: PNG if small, else JPEG."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    if image.shape[0] * image.shape[1] <= _PNG_UP_TO_PIXELS:
        kind, encoded = 'png', cv2.imencode('.png', bgr)[1]
    else:
        # Full colour resolution, so that the thin outline stays crisp.
        kind, encoded = 'jpeg', cv2.imencode('.jpg', bgr, [
            cv2.IMWRITE_JPEG_QUALITY, 90,
            cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444])[1]
    return data_uri(kind, encoded.tobytes())


def data_uri(kind: str, content: bytes) -> str:
    """Return an image file, png, jpeg or svg+xml, as a data URI."""
    return f'data:image/{kind};base64,{base64.b64encode(content).decode()}'
