"""What to know of a learned likelihood field: what the log leaves open, and where it is not better than others."""

from __future__ import annotations

import math
from collections.abc import Iterator

from beamfield.calibration.field.axis_density import DensityFit, share_bounds, sigma_bounds
from beamfield.calibration.field.axis_table import AxisTable
from beamfield.calibration.time_split import FEWEST_TRUSTED_BLOCKS
from beamfield.finding import Finding

# A hit component that gains less than this over a uniform, nats over all readings, may be chance.
LEAST_GAIN = 20.0


def has_no_hits(table: AxisTable, fit: DensityFit) -> bool:
    """Return whether hits explain no more of the readings than chance would."""
    return (fit.trace[-1] + math.log(table.span)) * len(table) < LEAST_GAIN


def density_findings(table: AxisTable, fit: DensityFit, n_blocks: int) -> Iterator[Finding]:
    """Return what the readings, and their blocks of time, do not tell about z_hit, z_rand and sigma_hit."""
    low, high = sigma_bounds(table)
    sigma, share = fit.mixture.sigma, fit.mixture.hit_share
    if has_no_hits(table, fit):
        yield Finding(
            "field-no-hits",
            "warning",
            f"The readings end near obstacles no more often than chance would ({fit.n_hits:.0f} of {len(table)} "
            "look like hits).",
            {"n_hits": fit.n_hits, "n": float(len(table))},
            why="sigma_hit is undetermined.",
            do="Check that the map is of this place and that the poses are in its frame.",
        )
    elif sigma <= low * 1.001:
        yield Finding(
            "field-sigma-at-floor",
            "warning",
            f"All hits end in occupied cells: sigma_hit stops at {low:.4g} m, a quarter of a cell, and could be less.",
            {"sigma_hit": sigma, "resolution": table.resolution},
            why="Walls drawn too thick hide the sensor's noise.",
            do="Use the value with this map; for the sensor's own noise draw a map with finer cells.",
        )
    elif sigma >= high / 1.001:
        yield Finding(
            "field-sigma-at-ceiling",
            "warning",
            f"sigma_hit stops at {high:.3g} m, the largest that is searched.",
            {"sigma_hit": sigma},
            why="The readings hardly follow the map.",
            do="Check that the map is of this place and that the poses are in its frame.",
        )
    if share >= share_bounds(len(table))[1]:
        yield Finding(
            "field-no-random",
            "info",
            "No reading needs the random component: z_rand is set to half a reading, so that no reading makes "
            "a pose impossible.",
            {"n": float(len(table))},
        )
    if not fit.converged:
        yield Finding(
            "field-not-converged",
            "warning",
            "Learning the likelihood field did not converge.",
            why="Other values may explain the readings better.",
            do="Do not use its values; calibrate with a longer log.",
        )
    if n_blocks < FEWEST_TRUSTED_BLOCKS:
        yield Finding(
            "field-few-blocks",
            "warning",
            f"The likelihood field's intervals rest on {n_blocks} blocks of time, fewer than {FEWEST_TRUSTED_BLOCKS}.",
            {"n_blocks": float(n_blocks)},
            why="The intervals are rough.",
            do="Record a longer log.",
        )


def exponent_findings(
    reason: str, score: float | None, standard_error: float | None, *, cones: bool
) -> Iterator[Finding]:
    """Return what is to be known of the exponent and of the posteriors it makes.

    The reason says why it was not learned; empty if it was. The score and its standard error are of held-out windows,
    nats over knowing nothing; None without windows. Cones are a sonar's.
    """
    if reason:
        yield Finding(
            "field-exponent-not-learned",
            "warning",
            f"The field's exponent was not learned: {reason}. It is 1.",
            why="That takes beams for independent: a field with many beams is then far too certain.",
            do="Use few beams of each scan (10 to 20), or calibrate with a longer log.",
        )
    elif score is not None and standard_error is not None and score <= 2.0 * standard_error:
        yield Finding(
            "field-says-nothing",
            "warning",
            "On held-out windows the likelihood field's posterior is not surely better than a uniform one "
            f"({score:+.2f} ± {standard_error:.2f} nats).",
            {"score": score, "standard_error": standard_error},
            why="A field takes a sonar's cones for rays: it says little, even in the right map."
            if cones
            else "The map, the poses or their frame are wrong, most readings are of people, or the log is too short.",
            do="Use the beam model's parameters, with SonarModel, not the likelihood field."
            if cones
            else "Correct what is wrong and calibrate again; until then do not use the likelihood field.",
        )
