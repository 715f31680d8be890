"""How much of sigma_hit is error of the reference poses: refine each pose on every other beam, look at the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.errors import TooLittleDataError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between, compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.range_mixture import RangeMixtureModel
from beamfield.models.sonar import model_of_sensor
from beamfield.sensors import Scan, SensorLog, usable_ranges
from beamfield.short_repr import short_repr

# Half widths of the searched window around each reference pose (metres, radians), halved on each level.
WINDOW = (0.3, 0.06)
LEVELS = 6
STEPS = 2  # nodes on each side of the centre, per axis and level
MAX_SCANS = 100
# A delay shows only where the robot drives (metres per second), on so many scans, and matters from so many seconds on.
SLOWEST = 0.1
FEWEST_MOVING = 20
LEAST_DELAY = 0.02


@dataclass(frozen=True, eq=False)
class PoseRefinement:
    """What refining the reference poses on the even beams does to the odd ones.

    Parameters
    ----------
    scans
        (r,) indices of the refined scans.
    shifts
        (r, 3) refined pose seen from the reference pose, metres and radians.
    sigma_before, sigma_after
        sigma_hit, one value for all ranges, fitted to the odd beams of these scans at the reference and at the refined
        poses, metres.
    delay, delay_share
        By how many seconds the reference would have to be read later to make the shifts along the path vanish, and
        which share of their squares that explains; NaN if the robot hardly moves.
    """

    scans: NDArray[np.int64]
    shifts: FloatArray
    sigma_before: float
    sigma_after: float
    delay: float = float("nan")
    delay_share: float = float("nan")

    __repr__ = short_repr


def refine_poses(
    log: SensorLog,
    grid: OccupancyGrid,
    scans: NDArray[np.int64],
    parameters: BeamParameters,
    *,
    unknown_occupied: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> PoseRefinement | None:
    """Refine some reference poses on every other beam and fit sigma_hit to the other ones; None if they are too few.

    A better score on the beams that were used would prove nothing; the beams that were not used tell. Of the usable
    scans, by index, about 100, equally spaced, are refined to where the fitted model is likeliest.
    """
    chosen = scans[np.unique(np.linspace(0, len(scans) - 1, min(MAX_SCANS, len(scans))).astype(np.int64))]
    unknown: Literal["free", "occupied"] = "occupied" if unknown_occupied else "free"
    model = model_of_sensor(log.finder)(grid, parameters, unknown=unknown)
    beams = np.arange(log.finder.n_beams)
    even, odd = beams[::2], beams[1::2]
    refined = np.empty((len(chosen), 3))
    for i, scan in enumerate(chosen.tolist()):
        refined[i] = _climb(model, log.scan(scan).subset(even), log.poses[scan])
        if progress is not None:
            progress(i + 1, len(chosen))
    z = usable_ranges(log.ranges[chosen], log.finder)[:, odd]
    good = np.isfinite(z)
    sigma = []
    for poses in (log.poses[chosen], refined):
        expected = model.expected(poses, log.finder.subset(odd))
        try:
            fit = learn_intrinsic_parameters(
                z[good],
                expected[good],
                log.finder.max_range,
                min_range=log.finder.min_range,
                initial=parameters,
                hold={"range_offset": parameters.range_offset},
                n_starts=1,  # all of these beams' log led to the parameters
            )
        except TooLittleDataError:
            return None
        sigma.append(fit.parameters.sigma_hit)
    shifts = between(log.poses[chosen], refined)
    return PoseRefinement(chosen, shifts, sigma[0], sigma[1], *_delay(log, chosen, shifts))


def _climb(model: RangeMixtureModel, scan: Scan, pose: FloatArray) -> FloatArray:
    """Search a shrinking window for the pose that a scan likes best."""
    if len(model.used_beams(scan)) == 0:
        return pose
    ticks = np.linspace(-1.0, 1.0, 2 * STEPS + 1)
    dx, dy, dt = (axis.ravel() for axis in np.meshgrid(ticks, ticks, ticks, indexing="ij"))
    steps = np.column_stack([dx * WINDOW[0], dy * WINDOW[0], dt * WINDOW[1]])
    centre = pose
    for level in range(LEVELS):
        candidates = compose(centre, steps * 0.5**level)
        centre = candidates[int(np.argmax(model.log_likelihood(scan, candidates)))]
    return centre


def _delay(log: SensorLog, scans: NDArray[np.int64], shifts: FloatArray) -> tuple[float, float]:
    """Explain shifts along the path by stamps that are off: shift = speed * delay."""
    before, after = np.maximum(scans - 1, 0), np.minimum(scans + 1, len(log) - 1)
    seconds = log.stamps[after] - log.stamps[before]
    with np.errstate(invalid="ignore", divide="ignore"):
        step = between(log.poses[before], log.poses[after])
        speed = step[:, 0] / seconds
    # A scan that was not refined, or whose best pose lies elsewhere, says nothing about stamps.
    good = np.isfinite(speed) & (seconds > 0) & (np.abs(speed) > SLOWEST) & (np.abs(shifts[:, 0]) < 0.9 * WINDOW[0])
    if good.sum() < FEWEST_MOVING:
        return float("nan"), float("nan")
    delay = float(np.median(shifts[good, 0] / speed[good]))
    left = ((shifts[good, 0] - delay * speed[good]) ** 2).sum()
    return delay, float(1.0 - left / max(float((shifts[good, 0] ** 2).sum()), 1e-12))


def refinement_findings(refinement: PoseRefinement | None, *, drawn: bool = False) -> Iterator[Finding]:
    """Report how much of sigma_hit is error of the reference poses, and whether these are late; nothing for None.

    If the map was drawn from the log itself, the fit leaves out beams that meet what is not drawn exactly, and its
    sigma_hit is smaller than both here.
    """
    if refinement is None:
        return
    shift = np.median(np.hypot(refinement.shifts[:, 0], refinement.shifts[:, 1]))
    turn = np.median(np.abs(refinement.shifts[:, 2]))
    values = {
        "n_scans": float(len(refinement.scans)),
        "sigma_before": refinement.sigma_before,
        "sigma_after": refinement.sigma_after,
        "median_shift": float(shift),
        "median_turn": float(turn),
        "delay": refinement.delay,
        "delay_share": refinement.delay_share,
    }
    text = (
        f"Refining {len(refinement.scans)} reference poses on every other beam changes sigma_hit on the remaining "
        f"beams from {refinement.sigma_before:.3f} to {refinement.sigma_after:.3f} m (median shift {shift:.3f} m, "
        f"{np.degrees(turn):.2f} deg)."
    )
    if refinement.sigma_after >= 0.85 * refinement.sigma_before:
        yield Finding("pose-refinement", "info", text + " The reference poses explain little of sigma_hit.", values)
        return
    yield Finding(
        "pose-error-in-sigma",
        "warning",
        text,
        values,
        why="Part of sigma_hit is error of the reference poses, not of the sensor.",
        do="Compare these two with each other, not with the fit, which leaves out what is not drawn exactly; give "
        "better poses and calibrate again."
        if drawn
        else "Use the smaller sigma_hit for a sensor with exact poses; else calibrate again with better poses, such as "
        "those that beamfield trajectory writes: --poses takes them.",
    )
    if abs(refinement.delay) > LEAST_DELAY and refinement.delay_share > 0.5:
        late = "older" if refinement.delay > 0 else "newer"
        yield Finding(
            "stamps-skewed",
            "warning",
            f"The refined poses lie along the path, in proportion to the speed: the reference poses seem "
            f"{abs(refinement.delay):.2f} s {late} than the scans with the same stamp "
            f"({refinement.delay_share:.0%} of the shifts along the path).",
            values,
            why="While the robot moves, each scan is compared with the map at a wrong place.",
            do="Correct the clock offset between the laser and what the poses are from (a localizer, or, if they were "
            "fitted to the log, its odometry), or the stamps of the poses.",
        )
