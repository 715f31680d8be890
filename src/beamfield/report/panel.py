"""Figures as markup that is small, offline and the same on every run."""

from __future__ import annotations

import base64
import io
import re
import threading
from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from PIL import Image

from beamfield.report.colours import CAUSE_COLOURS, MODEL, THROUGH
from beamfield.report.drawing import NARROW
from beamfield.report.escape import escaped

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
    wide: bool


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
        The figure, section or equation of the chapter that it belongs to; plain text, "" for none.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    caption: str
    source: str = ""


def one_picture(
    name: str, title: str, figure: Figure, alt: str, caption: str, source: str, *, cloud: bool = False
) -> ReportFigure:
    """Return a figure of one picture: a PNG of a cloud of points, or an SVG; parameters as for those and the figure."""
    panel = png_panel(figure, alt) if cloud else svg_panel(figure, name, alt)
    return ReportFigure(name, title, (panel,), caption, source)


def svg_panel(figure: Figure, name: str, alt: str) -> Panel:
    """Draw a figure as inline SVG: for lines and bars.

    The name begins the SVG's ids and is unique in the page; `alt` is for readers who cannot see it.
    """
    buffer = io.StringIO()
    with _DRAWING:
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})  # type: ignore[no-untyped-call]
    width, height = figure.get_size_inches() * 72.0
    return Panel(_inline_svg(buffer.getvalue(), name, alt, float(width), float(height)), _is_wide(figure))


def png_panel(figure: Figure, alt: str, *, dpi: int = 144) -> Panel:
    """Draw a figure as a PNG with 256 colours: for clouds of points; `alt` is for readers who cannot see it."""
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    with _DRAWING:
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.array(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]
    image = Image.fromarray(np.ascontiguousarray(pixels))
    buffer = io.BytesIO()
    image.quantize(palette=_palette(image), dither=Image.Dither.NONE).save(buffer, "PNG")
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    size = f'width="{image.width}" height="{image.height}"'
    return Panel(f'<img {size} alt="{escaped(alt)}" src="data:image/png;base64,{data}">', _is_wide(figure))


def _is_wide(figure: Figure) -> bool:
    return bool(figure.get_figwidth() > NARROW)


def _palette(image: Image.Image) -> Image.Image:
    """Return an image with the palette to draw in: the kept colours over white, and the most frequent of the image."""
    kept = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in KEPT_COLOURS])
    shades = np.concatenate([255 + share * (kept - 255) for share in KEPT_SHARES]).round().astype(np.uint8)
    shades = np.unique(shades, axis=0)
    # Every other pixel tells which colours are frequent.
    small = image.resize((max(1, image.width // 2), max(1, image.height // 2)), Image.Resampling.NEAREST)
    rest = small.quantize(256 - len(shades), method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).getpalette()
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
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", body, flags=re.DOTALL)
    body = body.replace("xlink:href", "href")
    body = re.sub(r'(?<= d=")[^"]+', lambda match: _shorter(match.group()), body)
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', body))
    referenced = [old for old in re.findall(r' id="([^"]+)"', body) if old in used]
    names = {old: f"{name}-{i}" for i, old in enumerate(referenced)}
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
