"""What to know of a calibration: too little data of use, a fit that learned nothing, readings taken as cones."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.evaluation import ModelScore
from beamfield.calibration.selection import Selection
from beamfield.finding import Finding
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import SensorLog
from beamfield.sensors.sectors import sectors

# A fit that gains less than this per held-out beam (nats) over a uniform has learned hardly anything from the map: with
# maps of other places the gain is 0 to 0.3, good fits on real logs gain 2 to 5.
LEAST_GAIN_OVER_UNIFORM = 0.5
# More readings without a measurement than this are worth a word: they may be meant as "no return".
NOTABLE_SHARE_LEFT_OUT = 0.03
# A beam is judged by so many readings, and blind where fewer than this share return.
FEWEST_OF_A_BEAM = 50
MOST_OF_A_BLIND_BEAM = 0.01
# Noise of a hit beyond this share of its range is of no range sensor: it is 0.14 in Wean Hall, whose walls are drawn
# worst of our maps, 0.33 there with mirrored scans, and 1.1 in the mirror image of the map.
WIDEST_NOISE = 0.25
# Scans from within so many metres of each other are of one place.
ONE_PLACE = 2.0


def selection_findings(selection: Selection) -> Iterator[Finding]:
    """Warn if many reference poses lie off the map."""
    off = selection.dropped.get("off the map", 0)
    share = off / len(selection.used)
    if share > 0.1:
        yield Finding(
            "poses-off-map",
            "warning",
            f"{off} of {len(selection.used)} reference poses ({share:.0%}) lie off the map.",
            {"n": float(off), "share": share},
            why="The map does not cover the log, or the poses are not in its frame.",
            do="Check the frame of the poses, and that the map is that of this drive.",
        )


def place_findings(log: SensorLog, selection: Selection) -> Iterator[Finding]:
    """Warn if all scans used are from about one place."""
    across = float(np.hypot(*np.ptp(log.poses[selection.used, :2], axis=0)))
    if across < ONE_PLACE:
        yield Finding(
            "one-place",
            "warning",
            f"All scans used are from one place, {across:.1f} m across.",
            {"across": across},
            why="The values hold for the walls and people that are seen from there; the intervals do not cover others.",
            do="Record a drive through all places where the robot will work.",
        )


def score_findings(scores: tuple[ModelScore, ...]) -> Iterator[Finding]:
    """Warn of a fit that is not better than the models it is compared with; the first score is the fit's."""
    for score in scores[1:]:
        if score.behind_fit <= 0:
            yield Finding(
                "fit-not-better",
                "warning",
                f"On held-out beams the fit is not better than {score.name}: {score.behind_fit:+.4f} nats per beam.",
                {"behind_fit": score.behind_fit},
                why="Fit and held-out blocks differ too much, or there is too little data.",
                do="Calibrate with a longer log of the places where the robot will drive.",
            )
        # Minus infinity says nothing of the map: the fit has no cause for some reading, as for the first "no return".
        if score.name == "uniform" and -math.inf < score.behind_fit < LEAST_GAIN_OVER_UNIFORM:
            yield Finding(
                "map-says-nothing",
                "warning",
                f"The fit is hardly better than a uniform density that ignores the map ({score.behind_fit:+.2f} nats "
                "per held-out beam).",
                {"behind_fit": score.behind_fit},
                why="Most likely the map is wrong, or the poses are not in its frame.",
                do="See the figure of causes on the map: hits should lie on its walls. Then correct the map or the "
                "poses.",
            )


def noise_findings(fit: BeamParameters, table: BeamTable) -> Iterator[Finding]:
    """Warn of hits that scatter around the walls by much of their range."""
    middle = float(np.median(table.expected_ranges))
    noise = math.hypot(fit.sigma_hit, fit.sigma_slope * middle)
    if noise > WIDEST_NOISE * middle:
        yield Finding(
            "hits-anywhere",
            "warning",
            f"Hits scatter around the walls of the map by {noise:.2f} m at a range of {middle:.2f} m.",
            {"noise": noise, "range": middle},
            why="No range sensor is so bad: the map, the poses or the sensor's mount is wrong or mirrored.",
            do="Look at the scans in the map with beamfield explore, and correct what is wrong.",
        )


def cone_findings(log: SensorLog) -> Iterator[Finding]:
    """Report that readings are treated as cones, if the sensor has an opening angle."""
    opening = log.finder.opening_angle
    if opening > 0.0:
        yield Finding(
            "cones",
            "info",
            f"The sensor's readings are taken as cones of {math.degrees(opening):.3g} degrees: the expected range is "
            "that of the nearest obstacle in the cone. Use the parameters with SonarModel.",
            {"opening_angle": opening},
        )


def left_out_findings(table: BeamTable, log: SensorLog) -> Iterator[Finding]:
    """Warn of many readings without a measurement: they count in no parameter, not even z_max."""
    total = table.n_readings
    # Beams that are NaN in all scans are masked.
    masked = float(np.isnan(log.ranges).all(axis=0).mean())
    nan, close = table.n_nan / total - masked, table.n_too_close / total
    if nan > NOTABLE_SHARE_LEFT_OUT:
        yield Finding(
            "nan-readings",
            "warning",
            f"{nan:.1%} of the readings are NaN (no measurement) and were left out.",
            {"n": float(table.n_nan), "share": nan},
            why="If this sensor reports a missing return as NaN, they are missing from z_max.",
            do="Then pass NaN as no_return when the log is read.",
        )
    if close > NOTABLE_SHARE_LEFT_OUT:
        yield Finding(
            "too-close-readings",
            "info",
            f"{close:.1%} of the readings are nearer than min_range = {table.min_range:.6g} m and were left out: parts "
            "of the robot, or readings outside the sensor's specified range.",
            {"n": float(table.n_too_close), "share": close},
        )


def blind_findings(table: BeamTable, log: SensorLog) -> Iterator[Finding]:
    """Name the beams that never return although the map has something there: parts of the robot, or dirt."""
    k = log.finder.n_beams
    hits = ~table.hits_nothing
    expected = np.bincount(table.beam[hits], minlength=k)
    returned = np.bincount(table.beam[hits & (table.ranges < table.max_range)], minlength=k)
    judged = expected >= FEWEST_OF_A_BEAM
    blind = judged & (returned < MOST_OF_A_BLIND_BEAM * expected)
    if not blind.any() or returned[judged].sum() < 0.5 * expected[judged].sum():
        return
    shown, options = sectors(log.finder.bearings, blind)
    share = float(expected[blind].sum() / hits.sum())
    yield Finding(
        "blind-beams",
        "warning",
        f"Nothing returns at {shown} although the map has something there: parts of the robot, or dirt on the "
        "sensor's window, most likely.",
        {"n_beams": float(blind.sum()), "share": share},
        why=f"They are {share:.1%} of the readings and count in z_max.",
        do=f"Clean the window; if that changes nothing, mask them ({options}).",
    )


def table_findings(table: BeamTable) -> Iterator[Finding]:
    """Warn if most readings have no expected range."""
    nothing = int(table.hits_nothing.sum())
    total = len(table) + table.n_unknown
    if nothing + table.n_unknown > 0.5 * total:
        yield Finding(
            "few-expected-ranges",
            "warning",
            f"Only {1 - (nothing + table.n_unknown) / total:.0%} of the readings have an expected range: "
            f"{table.n_unknown} rays cross unknown space, {nothing} hit nothing within {table.max_range:.1f} m.",
            {"n_unknown": float(table.n_unknown), "n_nothing": float(nothing)},
            why="The parameters rest on the other readings alone.",
            do="Check that the map is complete and the poses are in its frame.",
        )
