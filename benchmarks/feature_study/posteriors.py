"""What a scan says about the pose, and what its walls and corners say (6.6.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.features.corners import Corner, find_corners
from beamfield.features.lines import find_lines
from beamfield.features.map_features import MapFeatures
from beamfield.features.straight_line import Line
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import FloatArray
from beamfield.localization.information import FeatureInformation
from beamfield.localization.lattice_noise import widened_for_lattice
from beamfield.localization.pose_posterior import PoseLattice, PosePosterior, pose_posterior, posterior_of
from beamfield.maps.lines import LineMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.sensors import RangeFinder, Scan, SensorLog, usable_ranges

from .corner_likelihood import CornerLikelihood
from .field_of_view import FieldOfView
from .learning import (
    CornerSightings,
    learn_corner_noise,
    learn_exponent,
    learn_line_noise,
    most_probable_noise,
)
from .noise import TYPICAL_NOISE, CornerNoise, FeatureNoise, LineNoise

# Beams of a scan that are scored, evenly spaced, each for those beside it as well: casting all of them over a map takes
# minutes and, with an exponent, tells hardly more.
SCORED_BEAMS = 60
# Share of a wall in a scan that must lie beside a mapped wall.
MIN_OVERLAP = 0.5
# Walls are rougher than the noise of a good sensor, metres.
LEAST_NOISE = 0.02
# The other poses that reference poses are compared with when an exponent is learned.
OTHER_POSITIONS, OTHER_HEADINGS = 400, 12


@dataclass(frozen=True, eq=False)
class ScanAndFeatures:
    """Posteriors given a scan, its walls, and its corners, all on one lattice.

    Parameters
    ----------
    scan, lines, corners
        The posteriors; without a feature in the scan or the map it is the prior.
    n_lines, n_corners
        How many the scan shows.
    """

    scan: PosePosterior
    lines: PosePosterior
    corners: PosePosterior
    n_lines: int
    n_corners: int

    @property
    def of_lines(self) -> FeatureInformation:
        """What the walls keep."""
        return FeatureInformation(self.scan, self.lines)

    @property
    def of_corners(self) -> FeatureInformation:
        """What the corners keep."""
        return FeatureInformation(self.scan, self.corners)


def posteriors_of_scan(
    scan: Scan,
    grid: OccupancyGrid,
    parameters: BeamParameters,
    features: MapFeatures,
    lattice: PoseLattice,
    *,
    exponent: float,
    noise: FeatureNoise = TYPICAL_NOISE,
) -> ScanAndFeatures:
    """Compare what a scan, its walls and its corners say about where in a map it was taken.

    The scan is scored by the beam model with 60 of its beams, walls by `LineModel`, and corners with their opening
    angle by `CornerLikelihood`, both summed over all correspondences.

    Parameters
    ----------
    scan
        The scan.
    grid
        The map.
    parameters
        Of the sensor; its noise is also that of the features, and its range offset is taken off before they are looked
        for.
    features
        The map's, from `map_features`.
    lattice
        The poses. What lies between them is added as noise to each model.
    exponent
        Of the scan: the chapter's alpha of 6.3.4, in (0, 1]; one beam in 1 / exponent is independent of the others.
    noise
        Of the features, best from `learn_feature_noise` with other scans. It brings their own exponents.

    Raises
    ------
    InvalidInputError
        If the exponent is out of range.
    """
    if not 0.0 < exponent <= 1.0:
        raise InvalidInputError(f"exponent: expected a number in (0, 1], got {exponent}")
    wide = widened_for_lattice(parameters, resolution=lattice.resolution, headings=_headings(lattice))
    n = scan.finder.n_beams
    scored = min(n, SCORED_BEAMS)
    beam_model = BeamModel(grid, wide, exponent=min(1.0, exponent * n / scored), n_beams=scored)
    whole = pose_posterior(beam_model, scan, lattice)
    lines, corners = features_of_scan(scan, parameters)
    return ScanAndFeatures(
        whole,
        posterior_of_lines(lines, features.lines, lattice, noise.lines),
        posterior_of_corners(corners, corner_likelihood(grid, features, lattice, scan.finder), lattice, noise.corners),
        len(lines),
        len(corners),
    )


def features_of_scan(scan: Scan, parameters: BeamParameters) -> tuple[list[Line], list[Corner]]:
    """Return the walls and corners of a scan where the map would show them: without the sensor's range offset.

    Parameters
    ----------
    scan
        The scan.
    parameters
        Of the sensor.
    """
    z = usable_ranges(scan.ranges, scan.finder)
    # What is without return, or too close, stays what it is.
    measured = z < scan.finder.max_range
    ranges = np.where(measured, np.maximum(scan.ranges - parameters.range_offset, 0.0), scan.ranges)
    lines = find_lines(replace(scan, ranges=ranges), RangeNoise(max(parameters.sigma_hit, LEAST_NOISE)))
    return lines, find_corners(lines)


def posterior_of_lines(
    lines: Sequence[Line], mapped: LineMap | None, lattice: PoseLattice, noise: LineNoise
) -> PosePosterior:
    """Return the posterior given the walls of a scan; the prior if it or the map has none.

    Parameters
    ----------
    lines, mapped
        The scan's and the map's.
    lattice
        The poses.
    noise
        Of walls.
    """
    if mapped is None or not lines:
        return _prior(lattice)
    model = _line_model(mapped, noise.parameters, lattice)
    plain = pose_posterior(model, _detections(lines, noise.parameters), lattice)
    log_likelihood = plain.log_mass + plain.log_evidence + np.log(lattice.n_poses)
    return posterior_of(noise.exponent * log_likelihood, lattice)


def posterior_of_corners(
    corners: Sequence[Corner], likelihood: CornerLikelihood | None, lattice: PoseLattice, noise: CornerNoise
) -> PosePosterior:
    """Return the posterior given the corners of a scan; the prior if it or the map has none.

    Parameters
    ----------
    corners
        The scan's.
    likelihood
        From `corner_likelihood`, for the same lattice; None if the map has no corner.
    lattice
        The poses.
    noise
        Of corners.
    """
    if likelihood is None or not corners:
        return _prior(lattice)
    return posterior_of(likelihood.log_likelihood(corners, lattice.headings, noise), lattice)


def corner_likelihood(
    grid: OccupancyGrid, features: MapFeatures, lattice: PoseLattice, finder: RangeFinder
) -> CornerLikelihood | None:
    """Return the likelihood of corners over a lattice, for any scan of a finder; None if the map has no corner.

    Which corners the map hides from which cell takes longest, and is looked up here once.

    Parameters
    ----------
    grid, features
        The map, which hides corners, and its features.
    lattice
        The poses.
    finder
        The sensor.
    """
    if features.corners is None:
        return None
    cell = (lattice.resolution, lattice.heading_step)
    return CornerLikelihood.on(grid, features.corners, lattice.centres(), FieldOfView.of(finder), cell)


def learn_feature_noise(
    log: SensorLog,
    scans: ArrayLike,
    grid: OccupancyGrid,
    parameters: BeamParameters,
    features: MapFeatures,
    lattice: PoseLattice,
) -> FeatureNoise:
    """Learn how walls and corners of scans differ from those of a map, from scans with reference poses.

    Noise, clutter and heavy tails are those that make the features most probable at the reference poses. Features of
    one scan share errors, which that does not see: the exponents are those under which the reference poses are most
    probable among others of the lattice; that of corners is learned from each half of the scans with the noise of the
    other half.

    Parameters
    ----------
    log, scans
        The log and the indices (t,) of the scans to learn from. Those that are judged must not be among them.
    grid, parameters, features, lattice
        As for `posteriors_of_scan`.

    Raises
    ------
    InvalidInputError
        If a scan has no reference pose.
    TooLittleDataError
        If they show fewer than ten walls or corners; corners are not asked for where the map has none, nor walls.
    """
    chosen = np.asarray(scans, dtype=np.int64)
    poses = log.poses[chosen]
    if not np.isfinite(poses).all():
        raise InvalidInputError(f"scans: scan {chosen[~np.isfinite(poses).all(axis=1)][0]} has no reference pose")
    found = [features_of_scan(log.scan(int(i)), parameters) for i in chosen]
    rng = np.random.default_rng(0)
    centres = lattice.centres()
    positions = centres[rng.choice(len(centres), min(len(centres), OTHER_POSITIONS), replace=False)]
    headings = lattice.headings[rng.choice(len(lattice.headings), min(len(lattice.headings), OTHER_HEADINGS), False)]
    lines, corners = TYPICAL_NOISE.lines, TYPICAL_NOISE.corners
    if features.lines is not None:
        lines = _learn_lines([lines for lines, _ in found], poses, features.lines, lattice, positions, headings)
    if features.corners is not None:
        seen = [corners for _, corners in found]
        view = FieldOfView.of(log.finder)
        cell = (lattice.resolution, lattice.heading_step)
        others = CornerLikelihood.on(grid, features.corners, positions, view, cell)
        corners = learn_corner_noise(CornerSightings.of(seen, poses, grid, features.corners, view))
        corners = replace(corners, exponent=_corner_exponent(seen, poses, grid, others, headings))
    return FeatureNoise(lines, corners)


def _learn_lines(
    scans: Sequence[Sequence[Line]],
    poses: FloatArray,
    mapped: LineMap,
    lattice: PoseLattice,
    positions: FloatArray,
    headings: FloatArray,
) -> LineNoise:
    shown = [t for t, lines in enumerate(scans) if lines]
    if not shown:
        raise TooLittleDataError("noise of walls: no scan shows any")
    seen = [LineDetections.from_lines(scans[t]) for t in shown]
    parameters = learn_line_noise(seen, poses[shown], mapped, TYPICAL_NOISE.lines.parameters, MIN_OVERLAP)
    model = _line_model(mapped, parameters, lattice)
    others = np.empty((len(positions), len(headings), 3))
    others[..., :2], others[..., 2] = positions[:, None], headings
    here = [float(model.log_likelihood(z, poses[t])) for t, z in zip(shown, seen, strict=True)]
    there = [model.log_likelihood(z, others).ravel() for z in seen]
    return LineNoise(parameters, learn_exponent(here, there))


def _corner_exponent(
    scans: Sequence[Sequence[Corner]],
    poses: FloatArray,
    grid: OccupancyGrid,
    others: CornerLikelihood,
    headings: FloatArray,
) -> float:
    """Learn the exponent from each half of the scans with the noise of the other: on their own they look too good."""
    here: list[float] = []
    there: list[FloatArray] = []
    for half in (0, 1):
        learned_from = CornerSightings.of(scans[1 - half :: 2], poses[1 - half :: 2], grid, others.corners, others.view)
        noise = most_probable_noise(learned_from, TYPICAL_NOISE.corners)
        for t in range(half, len(scans), 2):
            if scans[t]:
                at = CornerLikelihood.on(grid, others.corners, poses[t : t + 1, :2], others.view, others.cell)
                here.append(float(at.log_likelihood(scans[t], poses[t : t + 1, 2], noise)[0, 0]))
                there.append(others.log_likelihood(scans[t], headings, noise).ravel())
    return learn_exponent(here, there)


def _line_model(mapped: LineMap, parameters: LineParameters, lattice: PoseLattice) -> LineModel:
    """Return the model with what lies between the lattice's poses: half a cell, half a step."""
    wide = replace(
        parameters,
        sigma_rho=float(np.hypot(parameters.sigma_rho, lattice.resolution / np.sqrt(12.0))),
        sigma_alpha=float(np.hypot(parameters.sigma_alpha, lattice.heading_step / np.sqrt(12.0))),
    )
    return LineModel(mapped, wide, correspondence="sum", min_overlap=MIN_OVERLAP)


def _detections(lines: Sequence[Line], parameters: LineParameters) -> LineDetections:
    """Return those walls that are no farther than the noise's limit: others could be of no mapped wall."""
    limit = np.inf if parameters.max_range is None else parameters.max_range
    return LineDetections.from_lines([line for line in lines if line.rho <= limit])


def _headings(lattice: PoseLattice) -> int:
    return max(1, round(2.0 * np.pi / lattice.heading_step))


def _prior(lattice: PoseLattice) -> PosePosterior:
    return posterior_of(np.zeros((int(lattice.inside.sum()), len(lattice.headings))), lattice)
