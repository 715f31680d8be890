"""Figures 6.3 to 6.6: the beam model's densities, and readings with the densities learned from them."""

from __future__ import annotations

from collections.abc import Callable

from matplotlib.figure import Figure

from beamfield.calibration.calibrate import Calibration
from beamfield.figures.world import FigureWorld
from beamfield.report.density_figures import draw_histogram, draw_readings
from beamfield.report.drawing import NARROW, WIDE, new_figure
from beamfield.report.mixture_figure import draw_components, draw_mixture
from beamfield.report.range_bins import FEWEST_READINGS, RangeBin, bin_at, telling_bin, typical_bins

LETTERS = "abcdefgh"
# The expected range of Figure 6.5, metres.
CHAPTER_RANGE = 3.0


def components_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.3: the four densities of the first sensor, at a typical expected range."""
    return _drawn(draw_components, new_figure(7.2, 5.0), world)


def mixture_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.4: their mixture."""
    return _drawn(draw_mixture, new_figure(7.2, 4.2), world)


def _drawn(draw: Callable[..., None], figure: Figure, world: FigureWorld) -> Figure:
    """Draw the model of the first sensor at a typical expected range."""
    calibration = next(iter(world.calibrations.values()))
    centre, table = _group(calibration).centre, calibration.table
    draw(figure, centre, calibration.parameters, table.max_range, min_range=table.min_range)
    return figure


def readings_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.5: readings one after the other for one expected range, the same for each sensor."""
    groups = _groups_at_one_range(list(world.calibrations.values()))
    figure = new_figure(WIDE, 3.2 * len(world.calibrations))
    parts = figure.subfigures(len(world.calibrations), 1, squeeze=False)[:, 0]
    sensors = zip(LETTERS, parts, world.calibrations.items(), groups, strict=False)
    for letter, part, (name, calibration), group in sensors:
        part.suptitle(_panel_name(letter, name, world), fontsize=11, fontweight="bold", x=0.01, ha="left")
        draw_readings(part.add_subplot(), calibration, group)
    return figure


def histograms_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.6: readings and learned densities for a near and a far expected range, for each sensor."""
    figure = new_figure(2 * NARROW, 4.6 * len(world.calibrations))
    rows = figure.subfigures(len(world.calibrations), 1, squeeze=False)[:, 0]
    for letter, row, (name, calibration) in zip(LETTERS, rows, world.calibrations.items(), strict=False):
        row.suptitle(_panel_name(letter, name, world), fontsize=11, fontweight="bold", x=0.01, ha="left")
        near_and_far = _near_and_far(calibration)
        for part, group in zip(row.subfigures(1, 2), near_and_far, strict=False):
            draw_histogram(part, calibration, group)
    return figure


def _panel_name(letter: str, sensor: str, world: FigureWorld) -> str:
    return f"({letter}) {sensor}" if len(world.calibrations) > 1 else sensor


def _group(calibration: Calibration) -> RangeBin:
    return telling_bin(typical_bins(calibration.table))


def _groups_at_one_range(calibrations: list[Calibration]) -> list[RangeBin]:
    """Return a group of each sensor at one expected range, as near 3 m as all have readings; else each its own."""
    own = [_group(calibration) for calibration in calibrations]
    centres = {CHAPTER_RANGE, *(group.centre for group in own)}
    for centre in sorted(centres, key=lambda centre: abs(centre - CHAPTER_RANGE)):
        groups = [bin_at(calibration.table, centre) for calibration in calibrations]
        if all(len(group.rows) >= FEWEST_READINGS for group in groups):
            return groups
    return own


def _near_and_far(calibration: Calibration) -> list[RangeBin]:
    """Return a near and a far group; the same one only if there are no two."""
    bins = typical_bins(calibration.table)
    far = telling_bin(bins)
    nearer = [group for group in bins if group.centre < far.centre]
    return [nearer[0], far] if nearer else [far]
