"""The gallery: which figures of the chapter there are, their captions, and writing them to files."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.errors import InvalidInputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from beamfield.figures.world import FigureWorld

# Dots per inch of the parts of an SVG or PDF that are pictures, and of PNG.
DPI = 130
FORMATS = ("svg", "png", "pdf")


@dataclass(frozen=True)
class ChapterFigure:
    """One figure of the chapter.

    Parameters
    ----------
    number
        As in the chapter: "6.7".
    section
        Where it belongs.
    function
        What draws it, "module.function" of this package.
    title
        What it shows.
    caption
        What to see in it.
    """

    number: str
    section: str
    function: str
    title: str
    caption: str

    @property
    def stem(self) -> str:
        """File name without its suffix."""
        return f"figure_{self.number.replace('.', '_')}"

    @property
    def name(self) -> str:
        """How the chapter calls it: Figure 6.7."""
        return f"Figure {self.number}"

    def draw(self, world: FigureWorld) -> Figure:
        """Draw it from a world; only now its module, and with it the numerical libraries, is loaded."""
        module, name = self.function.split(".")
        figure: Figure = getattr(importlib.import_module(f"beamfield.figures.{module}"), name)(world)
        return figure


_ALL = (
    ChapterFigure(
        "6.1", "6.1", "sonar_figures.sonar_figure", "A sonar scan, and how sonars misread",
        "(a) A ring of sonars simulated in the map; of 30 scans the first with the most kinds of readings. Cones end "
        "where something was heard: most at the nearest thing in them, some too far or too near, and the dashed ones "
        "heard nothing although there is a wall. (b) A smooth wall mirrors the pulse: if the angle to its normal "
        "exceeds half the opening angle, the echo goes elsewhere. (c) What the log's "
        "own sensor measured at the same pose.",
    ),
    ChapterFigure(
        "6.3", "6.3.1", "beam_model_figures.components_figure", "Components of the range finder sensor model",
        "Each cause of a reading alone, for one expected range z* (dashed): (a) a hit with noise, (b) an "
        "unexpected object before it, (c) no return, which is a probability and no density, (d) an unexplained "
        "reading.",
    ),
    ChapterFigure(
        "6.4", "6.3.1", "beam_model_figures.mixture_figure", "A typical mixture distribution p(z | x, m)",
        "The densities of Figure 6.3 times their weights, and in grey their sum, on a logarithmic scale. The "
        "probability of no return has an axis of its own.",
    ),
    ChapterFigure(
        "6.5", "6.3.2", "beam_model_figures.readings_figure", "Readings for one expected range",
        "Every reading whose expected range lies near one value (dashed; 3 m as in the chapter if the log has such "
        "readings), in the order of the log, coloured by its most likely cause. Where a sonar is beside a laser "
        "scanner, it has much more noise and far more readings without return.",
    ),
    ChapterFigure(
        "6.6", "6.3.2", "beam_model_figures.histograms_figure", "Learned beam models and the data",
        "Histograms of readings for a near and a far expected range, and the density that was learned from all "
        "data. Above the hits on a linear scale, below all ranges on a logarithmic one.",
    ),
    ChapterFigure(
        "6.7", "6.3.2", "scan_figures.likelihood_over_map_figure", "A scan, and its likelihood over the map",
        "(a) A range scan at its reference pose in the map: the one asked for, or one with far and near readings, if "
        "possible one that is likeliest there. (b) The likelihood of this scan at every free place, with the heading "
        "that suits it best: the darker, the more likely. The scan alone leaves several places possible.",
    ),
    ChapterFigure(
        "6.8", "6.4.1", "field_figures.obstacles_figure", "Obstacles and their likelihood field",
        "(a) A robot, obstacles (grey) and the axis of one beam (dashed). (b) The likelihood field: the darker a "
        "place, the less likely is an end point there. Obstacles are outlined.",
    ),
    ChapterFigure(
        "6.9", "6.4.1", "field_figures.beam_profile_figure", "What one beam sees of a likelihood field",
        "(a) The field along the beam of Figure 6.8, normalised: p_hit has a peak where the beam passes an "
        "obstacle's nearest point. It does not know that the first obstacle would hide the others. (b) With the "
        "two uniform parts of (6.34); no return is a probability at z_max.",
    ),
    ChapterFigure(
        "6.10", "6.4.2", "field_figures.map_field_figure", "A map and its likelihood field",
        "(a) An occupancy grid map. (b) The likelihood of an end point: bright near obstacles, dark in free "
        "space, constant where nothing is known.",
    ),
    ChapterFigure(
        "6.11", "6.4.2", "scan_figures.scan_field_figure", "A scan and its own likelihood field",
        "(a) The end points of one scan. (b) The field it makes for other scans: the darker, the less likely is "
        "an end point there. Space that beams passed is dark; what is hidden behind surfaces is white and costs "
        "nothing.",
    ),
    ChapterFigure(
        "6.12", "6.5", "scan_figures.local_map_figure", "A local map for map matching",
        "(a) A local map from at most 10 scans with the last of them: free white, occupied dark, "
        "unknown grey. (b) Its correlation with the global map, moved around the reference pose without turning.",
    ),
    ChapterFigure(
        "6.13", "6.6.4", "landmark_figures.poses_of_detection_figure", "Where a robot can be that sees one landmark",
        "A landmark (star) was seen at a range of 5 m and a bearing of 30 degrees. (a) The posterior over "
        "positions is a ring: nothing tells from which side it was seen. (b) Poses drawn from it: each has a "
        "heading that puts the landmark 30 degrees to its left, so that in x, y and theta the ring is a spiral.",
    ),
)  # fmt: skip

FIGURES: Mapping[str, ChapterFigure] = {figure.number: figure for figure in _ALL}
"""Every figure that can be drawn, by number, in the chapter's order."""


# Figures of the chapter that are drawn beside another.
PANELS = {"6.2": "(c) of 6.1"}


def chosen_figures(numbers: Sequence[str] | None = None) -> list[ChapterFigure]:
    """Return the figures of these numbers in the chapter's order, all if None; refuse unknown numbers."""
    if numbers is None:
        return list(FIGURES.values())
    unknown = [number for number in numbers if number not in FIGURES]
    if unknown:
        part = f": it is part {PANELS[unknown[0]]}" if unknown[0] in PANELS else ""
        raise InvalidInputError(f"figure: expected one of {', '.join(FIGURES)}, got {unknown[0]!r}{part}")
    return [figure for number, figure in FIGURES.items() if number in numbers]


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure to a file that ends in .svg, .png or .pdf, the same bytes on every run."""
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise InvalidInputError(f"picture: expected a name ending in .svg, .png or .pdf, got {path.name!r}")
    without_date = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}[kind]
    import matplotlib

    # Ids in an SVG are random without a salt.
    with matplotlib.rc_context({"svg.hashsalt": "beamfield"}):
        figure.savefig(path, dpi=DPI, format=kind, metadata=without_date, facecolor="white")


def gallery_page(
    figures: Sequence[ChapterFigure],
    world_name: str,
    folder: str = ".",
    suffix: str = "svg",
    *,
    missing: Mapping[ChapterFigure, str] | None = None,
) -> str:
    """Return the gallery as Markdown, with what the figures are drawn from, and why some could not be drawn.

    The folder is where the pictures are, seen from the page; the suffix is theirs.
    """
    again = "`beamfield figures` draws them; `beamfield figures LOG --map MAP` from a log and a map of your own."
    lines = ["# Figures of the chapter", "", f"Drawn from: {world_name}. {again}", ""]
    for figure in figures:
        caption = _plain(figure.caption)
        lines += [
            f"## {figure.name}: {figure.title}",
            "",
            f"![{figure.name}: {figure.title}]({folder}/{figure.stem}.{suffix})",
            "",
            f"{caption} (section {figure.section})",
            "",
        ]
    if missing:
        lines += ["## Not drawn", ""]
        lines += [f"- {figure.name}, {figure.title}: {_plain(reason)}" for figure, reason in missing.items()]
        lines.append("")
    return "\n".join(lines)


def _plain(text: str) -> str:
    """Two of z* would make what is between them italic."""
    return text.replace("*", r"\*")
