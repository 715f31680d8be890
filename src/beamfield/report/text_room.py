"""Leave room for the text around axes, estimated from its length."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import LayoutEngine

# All in points.
PAD = 3.0
TICK = 7.0  # the tick, and the gap to its label
LABEL_GAP = 4.0
TITLE_GAP = 7.0
# Of a line of text, and of a character, by the size of the font: a digit of matplotlib's font has 0.636 of it.
LINE, CHARACTER = 1.25, 0.62


class TextRoom(LayoutEngine):
    """Give each side of the axes as much room as its text may take.

    Matplotlib's own engines draw all text twice more to measure it, which takes longer than to draw a panel. A panel's
    fonts and the kinds of its text are known.

    Parameters
    ----------
    above
        Room above the axes for a legend or a colour bar, points.
    """

    _adjust_compatible = True
    _colorbar_gridspec = False

    def __init__(self, above: float = 0.0) -> None:
        super().__init__()
        self._above = above

    def execute(self, fig: Figure) -> None:
        """Set the margins of the figure, and the gaps between its rows and columns of axes."""
        places = [(ax, place) for ax in fig.axes if (place := ax.get_subplotspec()) is not None]
        if not places:
            return
        rows, columns = places[0][1].get_gridspec().get_geometry()
        # Room below and above each row, left and right of each column.
        below, above, left, right = np.zeros(rows), np.zeros(rows), np.zeros(columns), np.zeros(columns)
        for ax, place in places:
            row, column = place.rowspan.start, place.colspan.start
            below[row], above[row] = max(below[row], _below(ax)), max(above[row], _above(ax))
            left[column], right[column] = max(left[column], _left(ax)), max(right[column], _right(ax))
        above[0] += self._above
        width, height = (72.0 * side for side in fig.get_size_inches())
        across = float(np.max(right[:-1] + left[1:], initial=0.0))
        down = float(np.max(below[:-1] + above[1:], initial=0.0))
        fig.subplots_adjust(
            left=left[0] / width,
            right=1.0 - right[-1] / width,
            bottom=below[-1] / height,
            top=1.0 - above[0] / height,
            # Shares of the mean width and height of the axes.
            wspace=across / ((width - left[0] - right[-1] - (columns - 1) * across) / columns),
            hspace=down / ((height - below[-1] - above[0] - (rows - 1) * down) / rows),
        )


def _left(ax: Axes) -> float:
    return PAD + _beside(ax.yaxis, CHARACTER * _longest(ax.yaxis)) + _label(ax.yaxis)


def _below(ax: Axes) -> float:
    return PAD + _beside(ax.xaxis, LINE) + _label(ax.xaxis)


def _right(ax: Axes) -> float:
    # Half of the last label below stands out.
    return PAD + 0.5 * CHARACTER * _longest(ax.xaxis) * _tick_size(ax.xaxis)


def _above(ax: Axes) -> float:
    title = max((ax.get_title(loc=place) for place in ("left", "center", "right")), key=len)
    if title:
        return PAD + TITLE_GAP + _height(title, float(ax.title.get_fontsize()))
    return PAD + 0.5 * LINE * _tick_size(ax.yaxis)


def _beside(axis: Axis, tick_label: float) -> float:
    """Room for ticks and their labels of so many times the size of the font; for ticks alone where they have none."""
    return TICK + (tick_label * _tick_size(axis) if _has_labels(axis) else 0.0)


def _label(axis: Axis) -> float:
    text = axis.label.get_text()
    return LABEL_GAP + _height(text, float(axis.label.get_fontsize())) if text else 0.0


def _longest(axis: Axis) -> int:
    """Characters of the longest tick label."""
    labels = axis.get_major_formatter().format_ticks(axis.get_majorticklocs().tolist())
    return max(map(len, labels), default=0)


def _has_labels(axis: Axis) -> bool:
    sides = ("labelbottom", "labelleft")
    return any(axis.get_tick_params().get(side, False) for side in sides)


def _tick_size(axis: Axis) -> float:
    return float(axis.get_tick_params().get("labelsize", 9.0))


def _height(text: str, size: float) -> float:
    return (text.count("\n") + 1) * LINE * size
