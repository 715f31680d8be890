"""How much of sigma_hit is error of the reference poses: refine each pose on every other beam, look at the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.em import learn_intrinsic_parameters
from beamfield.calibration.finding import Finding
from beamfield.errors import TooLittleDataError
from beamfield.geometry import FloatArray, between, compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import SensorLog, usable_ranges

# Half widths of the searched window around each reference pose (metres, radians), halved on each level.
WINDOW = (0.3, 0.06)
LEVELS = 6
STEPS = 2  # nodes on each side of the centre, per axis and level
MAX_SCANS = 100


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
    """

    scans: NDArray[np.int64]
    shifts: FloatArray
    sigma_before: float
    sigma_after: float


def refine_poses(
    log: SensorLog,
    grid: OccupancyGrid,
    scans: NDArray[np.int64],
    parameters: BeamParameters,
    *,
    unknown_occupied: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> PoseRefinement | None:
    """Refine some reference poses on every other beam and fit sigma_hit to the other ones.

    A better score on the beams that were used would prove nothing; the beams that were not used tell.

    Parameters
    ----------
    log, grid
        Scans with reference poses, and the map.
    scans
        Indices of usable scans; about 100, equally spaced, are refined.
    parameters
        The fitted model, whose likelihood is maximised.
    unknown_occupied
        Whether rays stop at unknown cells.
    progress
        Called with (done, total) scans.

    Returns
    -------
    PoseRefinement or None
        None if there are too few beams to say.
    """
    chosen = scans[np.unique(np.linspace(0, len(scans) - 1, min(MAX_SCANS, len(scans))).astype(np.int64))]
    caster = RayCaster(grid, unknown="occupied" if unknown_occupied else "free")
    beams = np.arange(log.finder.n_beams)
    even, odd = beams[::2], beams[1::2]
    ranges = usable_ranges(log.ranges[chosen], log.finder)
    refined = np.empty((len(chosen), 3))
    for i, scan in enumerate(chosen):
        refined[i] = _climb(caster, log, log.poses[scan], ranges[i, even], even, parameters)
        if progress is not None:
            progress(i + 1, len(chosen))
    finder = log.finder.subset(odd)
    sigma = []
    for poses in (log.poses[chosen], refined):
        expected = caster.expected_ranges(poses, finder)
        z = ranges[:, odd]
        good = np.isfinite(z)
        try:
            fit = learn_intrinsic_parameters(
                z[good],
                expected[good],
                log.finder.max_range,
                hold={"range_offset": parameters.range_offset},
            )
        except TooLittleDataError:
            return None
        sigma.append(fit.parameters.sigma_hit)
    return PoseRefinement(chosen, between(log.poses[chosen], refined), sigma[0], sigma[1])


def _climb(
    caster: RayCaster,
    log: SensorLog,
    pose: FloatArray,
    ranges: FloatArray,
    beams: NDArray[np.int64],
    parameters: BeamParameters,
) -> FloatArray:
    """Search a shrinking window for the pose that the given beams like best."""
    good = np.isfinite(ranges)
    finder = log.finder.subset(beams[good])
    z = ranges[good]
    if len(z) == 0:
        return pose
    ticks = np.linspace(-1.0, 1.0, 2 * STEPS + 1)
    dx, dy, dt = (axis.ravel() for axis in np.meshgrid(ticks, ticks, ticks, indexing="ij"))
    centre = pose
    for level in range(LEVELS):
        scale = 0.5**level
        steps = np.column_stack([dx * WINDOW[0] * scale, dy * WINDOW[0] * scale, dt * WINDOW[1] * scale])
        candidates = compose(centre, steps)
        expected = caster.expected_ranges(candidates, finder)
        score = beam_log_density(np.broadcast_to(z, expected.shape), expected, log.finder.max_range, parameters).sum(
            axis=1
        )
        centre = candidates[int(np.argmax(score))]
    return centre


def refinement_findings(refinement: PoseRefinement | None) -> list[Finding]:
    """Say whether sigma_hit is partly error of the reference poses."""
    if refinement is None:
        return []
    shift = np.median(np.hypot(refinement.shifts[:, 0], refinement.shifts[:, 1]))
    turn = np.median(np.abs(refinement.shifts[:, 2]))
    values = {
        "n_scans": float(len(refinement.scans)),
        "sigma_before": refinement.sigma_before,
        "sigma_after": refinement.sigma_after,
        "median_shift": float(shift),
        "median_turn": float(turn),
    }
    text = (
        f"Refining {len(refinement.scans)} reference poses on every other beam changes sigma_hit on the remaining "
        f"beams from {refinement.sigma_before:.3f} to {refinement.sigma_after:.3f} m (median shift {shift:.3f} m, "
        f"{np.degrees(turn):.2f} deg)."
    )
    if refinement.sigma_after < 0.85 * refinement.sigma_before:
        return [
            Finding(
                "pose-error-in-sigma",
                "warning",
                text + " Part of sigma_hit is error of the reference poses, not of the sensor.",
                values,
            )
        ]
    return [Finding("pose-refinement", "info", text + " The reference poses explain little of sigma_hit.", values)]
