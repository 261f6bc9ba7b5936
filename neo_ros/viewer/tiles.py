"""Several cameras in one picture."""
from collections.abc import Mapping
import math
from typing import Any, NamedTuple

import cv2
import numpy as np

HEIGHT, MOST_COLUMNS = 180, 3


class Tiles(NamedTuple):
    """
    A picture of several, uint8 RGB (H, W, 3).

    places: name, left, top, width and height of each, in shares of the picture.
    """

    image: np.ndarray
    places: list[tuple[str, float, float, float, float]]

    def describe(self) -> list[dict[str, Any]]:
        """Return the places as the page takes them."""
        return [dict(zip(('name', 'x', 'y', 'width', 'height'), place)) for place in self.places]


def draw_tiles(images: Mapping[str, np.ndarray | None]) -> Tiles | None:
    """Put images, uint8 RGB (H, W, 3), side by side; black where one is missing."""
    known = [image for image in images.values() if image is not None]
    if not known:
        return None
    width = max(round(HEIGHT * image.shape[1] / image.shape[0]) for image in known)
    columns = min(len(images), MOST_COLUMNS)
    rows = math.ceil(len(images) / columns)
    whole = np.zeros((rows * HEIGHT, columns * width, 3), np.uint8)
    places = []
    for number, (name, image) in enumerate(images.items()):
        row, column = divmod(number, columns)
        top, left = row * HEIGHT, column * width
        if image is not None:
            w = round(HEIGHT * image.shape[1] / image.shape[0])
            whole[top:top + HEIGHT, left:left + w] = cv2.resize(
                image, (w, HEIGHT), interpolation=cv2.INTER_AREA)
        places.append((name, column / columns, row / rows, 1 / columns, 1 / rows))
    return Tiles(whole, places)
