"""How every figure of the report looks.

Only Figure objects are used, no pyplot and no rcParams, so that a report may be drawn in any thread of any program.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator
from numpy.typing import ArrayLike

from beamfield.report.colours import GRID, QUIET
from beamfield.report.text_room import TextRoom

NARROW = 4.7  # inches: two such panels stand side by side on a screen, one fills a phone
WIDE = 9.4
LEGEND_LINE = 15.0  # points


def new_figure(width: float, height: float) -> Figure:
    """Return an empty white figure of this size in inches."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="white", edgecolor="white")


def new_panel(width: float, height: float, *, above: float = 0.0) -> Figure:
    """Return an empty white figure for a panel of the report, which has many.

    Width and height are in inches; `above` is room above the axes for a legend or a colour bar, in lines of a legend.
    """
    return Figure(figsize=(width, height), layout=TextRoom(above * LEGEND_LINE), facecolor="white", edgecolor="white")


def new_axes(width: float, height: float, *, above: float = 0.0, **look: Any) -> tuple[Figure, Axes]:
    """Return a new panel and its only axes in the report's look; the rest as for `new_panel` and `style`."""
    figure = new_panel(width, height, above=above)
    axes = figure.add_subplot()
    style(axes, **look)
    return figure, axes


def style(axes: Axes, *, title: str = "", x: str = "", y: str = "", grid: str = "both", wrap: bool = False) -> None:
    """Give axes the report's look; labels carry units, and the grid is "both", "x", "y" or "none".

    A title that does not fit may wrap where the layout measures it (`new_figure`, not `new_panel`).
    """
    axes.set_facecolor("white")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set(color=QUIET, linewidth=0.8)
    axes.tick_params(which="both", labelsize=9, labelcolor="#222222", color=QUIET, width=0.8)
    axes.set_axisbelow(True)
    axes.grid(False)
    if grid != "none":
        axes.grid(True, axis=grid, color=GRID, linewidth=0.7, linestyle="-", alpha=1.0)  # type: ignore[arg-type]
    if title:
        # With y, matplotlib does not measure the axes to see whether something is in the title's way.
        axes.set_title(title, fontsize=10, loc="left", color="#111111", fontweight="bold", y=1.0, wrap=wrap)
    axes.set_xlabel(x, fontsize=9, color="#222222")
    axes.set_ylabel(y, fontsize=9, color="#222222")


def filled_steps(
    axes: Axes, heights: ArrayLike, edges: ArrayLike, *, base: ArrayLike = 0.0, linewidth: float = 0.0, **look: Any
) -> None:
    """Fill under a histogram; `Axes.stairs` and `hist` look at every bin by itself to find the limits.

    Heights and base (n,) are top and bottom of each bin, or one base of all; edges are (n + 1,). `look` is for
    `Axes.fill_between`.
    """
    tops = np.asarray(heights, np.float64)
    low = np.broadcast_to(np.asarray(base, np.float64), tops.shape)
    below, above = (np.append(values, values[-1]) for values in (low, tops))
    axes.fill_between(np.asarray(edges, np.float64), below, above, step="post", linewidth=linewidth, **look)


def log_scale(axes: Axes) -> None:
    """Make the y axis logarithmic, with ticks at powers of ten alone: those between take long to draw."""
    axes.set_yscale("log")
    # Matplotlib's own labels go through its formula parser: slow, and state shared by all threads.
    axes.yaxis.set_major_formatter(FuncFormatter(_power_of_ten))
    axes.yaxis.set_minor_locator(NullLocator())


def _power_of_ten(value: float, _position: int | None = None) -> str:
    exponent = round(math.log10(value)) if value > 0 else 0
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def legend(axes: Axes, **where: Any) -> None:
    """Add a legend in the report's look; nothing if no artist has a label."""
    if axes.get_legend_handles_labels()[0]:
        look: dict[str, Any] = {"framealpha": 0.9, "edgecolor": GRID, "facecolor": "white", "fancybox": False}
        axes.legend(fontsize=8, frameon=True, **look, **where)


def legend_above(axes: Axes, ncols: int = 6) -> None:
    """Add a legend in one line, or in so many columns, above the axes, where it hides nothing."""
    gaps = {"handletextpad": 0.4, "columnspacing": 1.2, "borderaxespad": 0.2}
    axes.legend(fontsize=8.5, frameon=False, ncols=ncols, loc="lower left", bbox_to_anchor=(0.0, 1.0), **gaps)
