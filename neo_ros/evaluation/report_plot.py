"""Small plots as inline SVG, coloured by the page's style sheet: no plotting library needed."""
from dataclasses import dataclass
from html import escape
import math
from typing import Literal, Sequence

_WIDTH, _HEIGHT = 720, 300
# Room for labels that the style sheet enlarges on a phone.
_LEFT, _RIGHT, _TOP, _BOTTOM = 72, 20, 14, 56
N_COLOURS = 10


@dataclass(frozen=True)
class Series:
    """One named line or cloud of points; values that are not finite are left out."""

    name: str
    x: Sequence[float]
    y: Sequence[float]


@dataclass(frozen=True)
class Plot:
    """A plot of some series over common axes, as lines or as points."""

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    kind: Literal['line', 'points'] = 'line'
    note: str = ''


def plot_svg(plot: Plot) -> str:
    """Return the plot as an `<svg>` element; its classes are styled by the report's page."""
    points = [_finite(series) for series in plot.series]
    x_ticks = ticks([x for line in points for x, _ in line])
    y_ticks = ticks([y for line in points for _, y in line])

    def place(x: float, y: float) -> tuple[float, float]:
        across = (x - x_ticks[0]) / (x_ticks[-1] - x_ticks[0])
        up = (y - y_ticks[0]) / (y_ticks[-1] - y_ticks[0])
        return (_LEFT + across * (_WIDTH - _LEFT - _RIGHT),
                _HEIGHT - _BOTTOM - up * (_HEIGHT - _TOP - _BOTTOM))

    parts = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" '
             f'aria-label="{escape(plot.title)}">']
    for x in x_ticks:
        px = place(x, y_ticks[0])[0]
        parts.append(f'<text x="{px:.1f}" y="{_HEIGHT - _BOTTOM + 20}" '
                     f'text-anchor="middle">{x:g}</text>')
    for y in y_ticks:
        py = place(x_ticks[0], y)[1]
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" '
                     f'y1="{py:.1f}" y2="{py:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 8}" y="{py + 4:.1f}" text-anchor="end">{y:g}</text>')
    parts.append(f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{_HEIGHT - 8}" '
                 f'text-anchor="middle">{escape(plot.x_label)}</text>')
    middle = (_TOP + _HEIGHT - _BOTTOM) / 2
    parts.append(f'<text transform="translate(18 {middle}) rotate(-90)" '
                 f'text-anchor="middle">{escape(plot.y_label)}</text>')
    for i, line in enumerate(points):
        placed = [place(x, y) for x, y in line]
        if plot.kind == 'line' and len(placed) > 1:
            path = ' '.join(f'{x:.1f},{y:.1f}' for x, y in placed)
            parts.append(f'<polyline class="line c{i % N_COLOURS}" points="{path}"/>')
        else:
            parts += [f'<circle class="dot c{i % N_COLOURS}" cx="{x:.1f}" cy="{y:.1f}" r="5"/>'
                      for x, y in placed]
    return ''.join(parts) + '</svg>'


def ticks(values: Sequence[float], most: int = 6) -> list[float]:
    """Return two to about `most` round numbers that enclose all values, in rising order."""
    low, high = (min(values), max(values)) if values else (0.0, 1.0)
    if high == low:
        low, high = low - abs(low) / 2 - 0.5, high + abs(high) / 2 + 0.5
    rough = (high - low) / (most - 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(i * step, 12) for i in range(first, last + 1)]


def _finite(series: Series) -> list[tuple[float, float]]:
    return [(x, y) for x, y in zip(series.x, series.y)
            if math.isfinite(x) and math.isfinite(y)]
