"""How every figure of the report is drawn: one look, and markup that is small, offline and the same on every run.

Only Figure objects are used, no pyplot and no rcParams, so that a report may be drawn in any thread of any program.
"""

from __future__ import annotations

import base64
import io
import math
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from PIL import Image

from beamfield.report.escape import escaped

# Okabe and Ito's palette: told apart by colour-blind readers, and in grey by their lightness.
CAUSE_NAMES = ("hit", "short", "max", "rand")
CAUSE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
THROUGH = "#7A0177"
DATA = "#B9C2CC"
MODEL = "#111111"
FIT = "#0072B2"
HELD_OUT = "#D55E00"
QUIET = "#5B6570"
GRID = "#E3E7EB"

NARROW = 4.7  # inches: two such panels stand side by side on a screen, one fills a phone
WIDE = 9.4

# What a palette of 256 colours must keep, also as thin and as faint as figures draw it: median cut would give a few
# pixels of one cause the colour of another.
KEPT_COLOURS = (*CAUSE_COLOURS, THROUGH, MODEL)
KEPT_SHARES = (1.0, 0.8, 0.6, 0.45, 0.35, 0.25, 0.15, 0.0)

# Matplotlib's text layout shares caches between figures.
_DRAWING = threading.Lock()


@dataclass(frozen=True)
class Panel:
    """One picture.

    Parameters
    ----------
    markup
        HTML: an inline SVG or an image with its data.
    wide
        Whether it takes the full width of the page.
    """

    markup: str
    wide: bool = False


@dataclass(frozen=True)
class ReportFigure:
    """One figure of the report: pictures under one title, with what to see in them.

    Parameters
    ----------
    name
        Anchor in the page, in kebab-case.
    title
        What it shows.
    panels
        The pictures.
    caption
        What to look for; plain text.
    source
        The figure, section or equation of the chapter that it belongs to; plain text.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    caption: str
    source: str


def new_figure(width: float, height: float) -> Figure:
    """Return an empty white figure of this size in inches."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="white", edgecolor="white")


def new_axes(width: float, height: float) -> tuple[Figure, Axes]:
    """Return a new figure of this size in inches and its only axes."""
    figure = new_figure(width, height)
    return figure, figure.add_subplot()


def style(axes: Axes, *, title: str = "", x: str = "", y: str = "", grid: str = "both") -> None:
    """Give axes the report's look.

    Parameters
    ----------
    axes
        The axes.
    title, x, y
        Title and axis labels; the labels carry units.
    grid
        "both", "x", "y" or "none".
    """
    axes.set_facecolor("white")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set(color=QUIET, linewidth=0.8)
    axes.tick_params(which="both", labelsize=9, labelcolor="#222222", color=QUIET, width=0.8)
    axes.set_axisbelow(True)
    if grid != "none":
        axes.grid(True, axis=grid, color=GRID, linewidth=0.7, linestyle="-", alpha=1.0)  # type: ignore[arg-type]
    if title:
        axes.set_title(title, fontsize=10, loc="left", color="#111111", fontweight="bold")
    axes.set_xlabel(x, fontsize=9, color="#222222")
    axes.set_ylabel(y, fontsize=9, color="#222222")


def log_scale(axes: Axes) -> None:
    """Make the y axis logarithmic, labelled at powers of ten."""
    axes.set_yscale("log")
    # Matplotlib's own labels go through its formula parser: slow, and state shared by all threads.
    axes.yaxis.set_major_formatter(FuncFormatter(_power_of_ten))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _power_of_ten(value: float, _position: int | None = None) -> str:
    exponent = round(math.log10(value)) if value > 0 else 0
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def legend(axes: Axes, **where: Any) -> None:
    """Add a legend in the report's look; nothing if no artist has a label."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            fontsize=8, frameon=True, framealpha=0.9, edgecolor=GRID, facecolor="white", fancybox=False, **where
        )


def legend_above(axes: Axes, ncols: int = 6) -> None:
    """Add a legend in one line, or in so many columns, above the axes, where it hides nothing."""
    axes.legend(
        fontsize=8.5,
        frameon=False,
        ncols=ncols,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        handletextpad=0.4,
        columnspacing=1.2,
        borderaxespad=0.2,
    )


def svg_panel(figure: Figure, name: str, alt: str, *, wide: bool = False) -> Panel:
    """Draw a figure as inline SVG: for lines and bars.

    Parameters
    ----------
    figure
        The figure.
    name
        Prefix of the ids in the SVG; unique in the page.
    alt
        What a reader who cannot see it should know.
    wide
        Whether it takes the full width of the page.
    """
    buffer = io.StringIO()
    with _DRAWING:
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})  # type: ignore[no-untyped-call]
    width, height = figure.get_size_inches() * 72.0
    return Panel(_inline_svg(buffer.getvalue(), name, alt, float(width), float(height)), wide)


def png_panel(figure: Figure, alt: str, *, wide: bool = False, dpi: int = 144) -> Panel:
    """Draw a figure as a PNG with 256 colours: for clouds of points.

    Parameters
    ----------
    figure
        The figure.
    alt
        What a reader who cannot see it should know.
    wide
        Whether it takes the full width of the page.
    dpi
        Pixels per inch.
    """
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    with _DRAWING:
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.array(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]
    image = Image.fromarray(np.ascontiguousarray(pixels))
    buffer = io.BytesIO()
    image.quantize(palette=_palette(image), dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    size = f'width="{image.width}" height="{image.height}"'
    return Panel(f'<img {size} alt="{escaped(alt)}" src="data:image/png;base64,{data}">', wide)


def _palette(image: Image.Image) -> Image.Image:
    """Return an image with the palette to draw in: the kept colours over white, and the most frequent of the image."""
    kept = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in KEPT_COLOURS])
    shades = np.concatenate([255 + share * (kept - 255) for share in KEPT_SHARES]).round().astype(np.uint8)
    shades = np.unique(shades, axis=0)
    rest = image.quantize(256 - len(shades), method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).getpalette()
    palette = Image.new("P", (1, 1))
    palette.putpalette([*shades.ravel().tolist(), *(rest or [])])
    return palette


def _inline_svg(text: str, name: str, alt: str, width: float, height: float) -> str:
    """Turn matplotlib's SVG file into markup for the middle of a page.

    Ids are random in matplotlib's output and those of two figures would clash in one page: referenced ones get names
    that are unique and the same on every run, the others go. What a page does not need (prolog, metadata, namespaces,
    a style sheet that would apply to the whole page, invisible digits) goes as well.
    """
    body = text[text.index("<svg") :]
    body = body[body.index(">") + 1 :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"<style.*?</style>", "", body, flags=re.DOTALL)
    body = re.sub(r"<!--.*?-->", "", body, flags=re.DOTALL)
    body = body.replace("xlink:href", "href")
    body = re.sub(r'(?<= d=")[^"]+', lambda match: _shorter(match.group()), body)
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', body))
    names: Mapping[str, str] = {
        old: f"{name}-{i}" for i, old in enumerate(i for i in re.findall(r' id="([^"]+)"', body) if i in used)
    }
    body = re.sub(r' id="([^"]+)"', lambda m: f' id="{names[m.group(1)]}"' if m.group(1) in names else "", body)
    body = re.sub(r'(href="#|url\(#)([^")]+)', lambda m: m.group(1) + names.get(m.group(2), m.group(2)), body)
    body = re.sub(r"\n\s*", "\n", body)
    return (
        f'<svg class="plot" role="img" aria-label="{escaped(alt)}" viewBox="0 0 {width:g} {height:g}">'
        f"<title>{escaped(alt)}</title>{body.strip()}"
    )


def _shorter(path: str) -> str:
    """Path data with two decimals, a hundredth of a point."""
    path = re.sub(r"-?\d+\.\d+", lambda m: f"{float(m.group()):.2f}".rstrip("0").rstrip("."), path)
    return re.sub(r"\s+", " ", path)
