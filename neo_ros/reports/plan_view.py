"""A drawing of a scene from above: world x to the right, y up, lines 1, 2, 5, ... metres apart."""
import cv2
import numpy as np

_PAPER, _GRID, _INK = (255, 255, 255), (214, 218, 224), (70, 74, 82)
_SIDE, _MARGIN = 800, 48
# Floor that a robot can be on.
FLOOR = (226, 236, 228)


class PlanView:
    """
    A sheet that shows the world between `low` and `high`, (2,) metres each.

    `image` is RGB uint8 (H, W, 3), at most 800 pixels a side; draw on it at `place`.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        self.low, self.high = low - 0.3, high + 0.3
        self.scale = (_SIDE - 2 * _MARGIN) / float((self.high - self.low).max())
        width, height = ((self.high - self.low) * self.scale).round().astype(int) + 2 * _MARGIN
        self.image = np.full((height, width, 3), _PAPER, np.uint8)

    def place(self, xy: np.ndarray) -> tuple[int, int]:
        """Return the pixel (column, row) of a point of the world."""
        across, up = (np.asarray(xy) - self.low) * self.scale + _MARGIN
        return round(float(across)), round(float(self.image.shape[0] - up))

    def shade(self, centre: np.ndarray, edge: float, colour: tuple[int, int, int]) -> None:
        """Fill a square of the world with this edge in metres."""
        left, bottom = self.place(centre - edge / 2)
        right, top = self.place(centre + edge / 2)
        cv2.rectangle(self.image, (left, top), (right, bottom), colour, -1)

    def draw_grid(self) -> None:
        """Draw the lines and write how many metres they stand for."""
        extent = float((self.high - self.low).max())
        step = next(factor for power in range(-3, 6) for factor in (
            10.0 ** power, 2 * 10.0 ** power, 5 * 10.0 ** power) if extent / factor <= 12)
        height, width = self.image.shape[:2]
        for axis in (0, 1):
            for value in np.arange(np.ceil(self.low[axis] / step), self.high[axis] / step) * step:
                point = self.low.copy()
                point[axis] = value
                x, y = self.place(point)
                ends = ((x, 0), (x, height)) if axis == 0 else ((0, y), (width, y))
                cv2.line(self.image, ends[0], ends[1], _GRID, 1)
                at = (x + 3, height - 8) if axis == 0 else (4, y - 4)
                cv2.putText(self.image, f'{value:g}', at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK,
                            1, cv2.LINE_AA)

    def draw_look(self, xy: np.ndarray, forward: np.ndarray, colour: tuple[int, int, int],
                  length: int) -> None:
        """Draw a dot and a tick of `length` pixels in the viewing direction."""
        start = self.place(xy)
        ahead = forward[:2] * (length, -length)
        end = (start[0] + round(float(ahead[0])), start[1] + round(float(ahead[1])))
        cv2.line(self.image, start, end, colour, 1, cv2.LINE_AA)
        cv2.circle(self.image, start, 3, colour, -1, cv2.LINE_AA)
