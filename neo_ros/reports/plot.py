"""Plots of a report, drawn by matplotlib as SVG."""
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Literal

import numpy as np

INCHES = (6.0, 3.4)
FEW = 10  # So few points of a line are marked.
SHORT = 18  # Three names of so many letters lie side by side.
# One file for light and dark pages: what is not a series is grey on nothing.
GREY = '#808995'
COLOURS = ('#2f7fdc', '#dd6b20', '#249a63', '#a855c7', '#a8860a', '#1595a8', '#d9365e', '#7b8794',
           '#6b9e10', '#7c62e6')
STYLE: dict[Any, Any] = {
    'font.size': 9, 'axes.axisbelow': True, 'axes.edgecolor': GREY, 'axes.labelcolor': GREY,
    'axes.spines.right': False, 'axes.spines.top': False, 'axes.grid': True,
    'grid.alpha': 0.35, 'grid.color': GREY, 'legend.labelcolor': GREY, 'text.color': GREY,
    'xtick.color': GREY, 'ytick.color': GREY,
    'text.parse_math': False,     # A name may hold dollars.
    'svg.fonttype': 'none',       # Text stays text.
    'svg.hashsalt': 'neo_ros',    # The same plot is the same file.
}


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


def plot_svg(plot: Plot) -> bytes:
    """Return the plot as an SVG file; several series get a legend."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    with rc_context(STYLE):
        figure = Figure(INCHES, layout='constrained')
        axes = figure.subplots()
        for i, series in enumerate(plot.series):
            points = np.array([series.x, series.y], float)
            points = points[:, np.isfinite(points).all(axis=0)]
            axes.plot(*points, linestyle='-' if plot.kind == 'line' else '',
                      marker='o' if plot.kind == 'points' or points.shape[1] <= FEW else '',
                      label=series.name, color=COLOURS[i % len(COLOURS)], gid=f'series_{i}')
        if all(isinstance(x, int) for series in plot.series for x in series.x):
            axes.xaxis.set_major_locator(MaxNLocator('auto', integer=True, steps=(1, 2, 5, 10)))
        axes.set_xlabel(plot.x_label)
        axes.set_ylabel(plot.y_label)
        if len(plot.series) > 1:
            # Above the axes: `outside` came with matplotlib 3.7, Ubuntu 24.04 has 3.6.
            columns = 3 if max(len(series.name) for series in plot.series) <= SHORT else 2
            axes.legend(loc='lower left', bbox_to_anchor=(0, 1), ncols=columns, frameon=False)
        file = BytesIO()
        figure.savefig(file, format='svg', transparent=True, metadata=dict.fromkeys(
            ('Creator', 'Date', 'Format', 'Type')))
    return file.getvalue()
