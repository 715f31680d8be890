"""The ticks, labels and grid lines of a panel's axes, drawn with few artists."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist, allow_rasterization
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import TICKDOWN, TICKLEFT
from matplotlib.text import Text

from beamfield.geometry import FloatArray
from beamfield.report.colours import GRID, QUIET
from beamfield.report.text_room import LABEL_GAP, TICK, TextRoom, shows_labels, tick_size

# A tick in points; TICK has the gap to its label, too.
TICK_LENGTH, TICK_WIDTH, GRID_WIDTH = 3.5, 0.8, 0.7
LABEL_COLOUR = "#222222"


def use_rulers(figure: Figure) -> None:
    """Let rulers draw the axes of a panel, in the report's look, instead of matplotlib's `Axis`.

    That has five artists for each tick, and measures every label. Figures that are no panel, with another layout engine
    than `TextRoom`, stay as they are.
    """
    if isinstance(figure.get_layout_engine(), TextRoom):
        for axes in figure.axes:
            if axes.get_subplotspec() is not None and axes.xaxis.get_visible():
                axes.add_artist(_Ruler(axes))
                axes.xaxis.set_visible(False)
                axes.yaxis.set_visible(False)


class _Ruler(Artist):
    """Both axes, below and left, with major ticks alone."""

    def __init__(self, axes: Axes) -> None:
        super().__init__()
        # Below the data, as matplotlib's own axes are in the report's look.
        self.set_zorder(0.5)
        self._axes = axes

    @property
    def _pixels(self) -> float:
        """Pixels per point."""
        figure = self._axes.get_figure()
        return 1.0 if figure is None else float(figure.dpi) / 72.0

    @allow_rasterization  # type: ignore[untyped-decorator]
    def draw(self, renderer: RendererBase) -> None:
        """Draw grid lines, ticks, tick labels and the axis labels."""
        for axis in (self._axes.xaxis, self._axes.yaxis):
            is_below = axis is self._axes.xaxis
            places, labels = _ticks(axis)
            for line in _lines(self._axes, places, is_below=is_below, grid=axis.get_tick_params().get("gridOn", False)):
                self._draw(line, renderer)
            room = TICK_LENGTH
            if shows_labels(axis) and labels:
                room = TICK + self._draw_tick_labels(axis, places, labels, renderer, is_below=is_below)
            self._draw_label(axis, room + LABEL_GAP, renderer, is_below=is_below)

    def _draw(self, artist: Artist, renderer: RendererBase) -> None:
        if (figure := self._axes.get_figure()) is not None:
            artist.set_figure(figure)
            artist.draw(renderer)

    def _draw_tick_labels(
        self, axis: Axis, places: FloatArray, labels: list[str], renderer: RendererBase, *, is_below: bool
    ) -> float:
        """Draw the labels; return how much room they take beside the ticks, points."""
        text1_transform = self._axes.get_xaxis_text1_transform if is_below else self._axes.get_yaxis_text1_transform
        transform, vertical, horizontal = text1_transform(TICK)
        text = Text(
            fontsize=tick_size(axis), color=LABEL_COLOUR, transform=transform,
            verticalalignment=vertical, horizontalalignment=horizontal,
        )  # fmt: skip
        for place, label in zip(places.tolist(), labels, strict=True):
            text.set(position=(place, 0.0) if is_below else (0.0, place), text=label)
            self._draw(text, renderer)
        text.set_text(max(labels, key=len))
        extent = text.get_window_extent(renderer)
        return float(extent.height if is_below else extent.width) / self._pixels

    def _draw_label(self, axis: Axis, room: float, renderer: RendererBase, *, is_below: bool) -> None:
        box, room = self._axes.bbox, room * self._pixels
        axis.label.set_position((0.5, box.y0 - room) if is_below else (box.x0 - room, 0.5))
        axis.label.draw(renderer)
        # What matplotlib takes out of large numbers, such as 1e6.
        axis.offsetText.set_text(axis.get_major_formatter().get_offset())
        axis.offsetText.set_position((1.0, box.y0 - room) if is_below else (0.0, box.y1 + LABEL_GAP))
        axis.offsetText.draw(renderer)


def _ticks(axis: Axis) -> tuple[FloatArray, list[str]]:
    """Return places and labels of the major ticks in view."""
    places = np.asarray(axis.get_majorticklocs(), np.float64)
    labels = axis.get_major_formatter().format_ticks(places.tolist())
    low, high = sorted(axis.get_view_interval())
    margin = 1e-9 * (high - low)
    shown = (places >= low - margin) & (places <= high + margin)
    return places[shown], [label for label, is_shown in zip(labels, shown, strict=True) if is_shown]


def _lines(axes: Axes, places: FloatArray, *, is_below: bool, grid: bool) -> list[Line2D]:
    """Return the grid's lines, if there is one, as one artist, and the ticks as one."""
    transform = axes.get_xaxis_transform if is_below else axes.get_yaxis_transform
    order = slice(None) if is_below else slice(None, None, -1)
    lines = []
    if grid:
        across = (np.repeat(places, 3), np.tile([0.0, 1.0, np.nan], len(places)))
        lines.append(Line2D(*across[order], color=GRID, linewidth=GRID_WIDTH, transform=transform("grid")))
    ticks = Line2D(*(places, np.zeros(len(places)))[order], linestyle="none", color=QUIET, transform=transform("tick1"))
    ticks.set(marker=TICKDOWN if is_below else TICKLEFT, markersize=TICK_LENGTH, markeredgewidth=TICK_WIDTH)
    return [*lines, ticks]
