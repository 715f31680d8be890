"""The picture and the table of the places where the world differs from the map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from beamfield.calibration.pose_windows import REFERENCE_LEVER
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report.colours import CAUSE_COLOURS, MODEL, THROUGH
from beamfield.report.drawing import WIDE, legend_above, new_axes
from beamfield.report.map_figures import draw_map, figure_height, frame, limits_around, number_place, squares_at
from beamfield.report.page import finding_list, table
from beamfield.report.panel import Panel, ReportFigure, png_panel
from beamfield.scan_fit.changed_places import KINDS, LASTING, MOST_LISTED, ChangedPlaces, Kind
from beamfield.scan_fit.place_visits import FEWEST_BEAMS

NAME, TITLE = "changed-places", "Where does the world differ from the map?"
SOURCE = "Section 6.3.1 (unexpected objects); 6.3.3 (the cause of a reading)"
COLOURS: Mapping[Kind, str] = {
    "new obstacle": CAUSE_COLOURS[1],
    "missing wall": THROUGH,
    "no return (glass?)": CAUSE_COLOURS[2],
    "passing (people)": "#56B4E9",
}
# Undecided places have the colour of what they may be, as pale as this.
PALE = 0.35
# Told apart without colour, too.
HATCHES: Mapping[Kind, str] = {"missing wall": "////", "no return (glass?)": "...."}
COLUMNS = ("", "kind", "x [m]", "y [m]", "size [m]", "rate", "95% interval", "visits")


def places_figure(found: ChangedPlaces, grid: OccupancyGrid, path: FloatArray) -> ReportFigure:
    """Draw the places on the map, with the robot's path (t, 2); a caption without picture where there is none."""
    path = path[np.isfinite(path).all(axis=1)]
    if not found.places:
        return ReportFigure(NAME, TITLE, (), "Nowhere: every place is as mapped, as far as the beams tell.", SOURCE)
    limits = limits_around(np.concatenate([path, *(place.corners for place in found.places)]))
    listed = found.lasting[:MOST_LISTED]
    figure, axes = new_axes(WIDE, figure_height(limits, rest=1.1, least=3.0), above=2)
    draw_map(axes, grid, limits)
    axes.plot(path[:, 0], path[:, 1], color=MODEL, linewidth=0.8, alpha=0.7, label="robot's path", zorder=2.5)
    _draw(axes, found)
    for number, place in enumerate(listed, start=1):
        number_place(axes, number, place.x, place.y)
    frame(axes, limits)
    legend_above(axes, ncols=3)
    alt = "Map with the places where readings differ from it: " + ", ".join(
        f"{len(found.of_kind(kind))} {kind}" for kind in KINDS
    )
    panels = [png_panel(figure, f"{alt}.")]
    if listed:
        panels.append(Panel(table(COLUMNS, _rows(found), right=(2, 3, 5)), wide=True))
    if found.findings:
        panels.append(Panel(finding_list(found.findings), wide=True))
    return ReportFigure(NAME, TITLE, tuple(panels), _caption(found), SOURCE)


def _rows(found: ChangedPlaces) -> list[tuple[str, ...]]:
    """The worst places, numbered as in the picture."""
    return [
        (
            str(number),
            place.kind,
            f"{place.x:.2f}",
            f"{place.y:.2f}",
            f"{place.width:.1f} x {place.height:.1f}",
            f"{place.rate:.0%}",
            f"{place.interval[0]:.0%} to {place.interval[1]:.0%}",
            f"{place.visits_changed} of {place.visits}",
        )
        for number, place in enumerate(found.lasting[:MOST_LISTED], start=1)
    ]


def _draw(axes: Axes, found: ChangedPlaces) -> None:
    """Draw the squares of each place; the legend says how many places there are of each kind."""
    for number, kind in enumerate(KINDS):
        places, pale = found.of_kind(kind), kind == "undecided"
        for colour_of in LASTING.values() if pale else (kind,):
            mine = [p for p in places if not pale or LASTING[p.reading] == colour_of]
            if mine:
                corners = np.concatenate([place.corners for place in mine])
                patches = PolyCollection(squares_at(corners, found.side), zorder=3.0 - 0.1 * number)
                patches.set(**_look(kind, colour_of))
                axes.add_collection(patches)
        if places:
            label = f"{kind}: {len(places)}" + (" (pale)" if pale else "")
            look = _look(kind, LASTING[places[0].reading] if pale else kind)
            axes.scatter([], [], s=70, marker="s", label=label, **look)


def _look(kind: Kind, colour_of: Kind) -> dict[str, Any]:
    alpha = PALE if kind == "undecided" else 0.85
    return {"facecolor": COLOURS[colour_of], "hatch": HATCHES.get(kind, ""), "edgecolor": "white", "linewidth": 0.0,
            "alpha": alpha}  # fmt: skip


def _caption(found: ChangedPlaces) -> str:
    numbers = f" Numbers are those of the table; {len(found.lasting)} places differ for good." if found.lasting else ""
    return (
        f"Squares of {found.side:g} m in which readings differ from the map. Orange: they end before the mapped "
        "obstacle in most visits, as at new furniture. Purple: they go beyond a mapped wall (it is gone, a door is "
        "open, or glass lets beams through). Green: nothing returns from a mapped wall (glass, black or shiny "
        "surfaces). Light blue: short readings in few of the visits, as of people. Pale: the same, but only at times, "
        f"or in too few visits to tell. A visit is a block of {found.visit_s:.3g} s in which at least "
        f"{FEWEST_BEAMS} beams could tell; the rate is that of readings that differ, of these beams. What a pose error "
        f"of {found.reference_error * 100:g} cm and {np.degrees(found.reference_error / REFERENCE_LEVER):.2g} degrees "
        f"explains is not shown.{numbers}"
    )
