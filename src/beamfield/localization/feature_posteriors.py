"""What a scan says about the pose, and what its walls and corners say (6.6.5)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beamfield.detections import Detections
from beamfield.errors import InvalidInputError
from beamfield.features.corners import find_corners
from beamfield.features.feature import stack_features
from beamfield.features.lines import find_lines
from beamfield.features.sweep import RangeNoise
from beamfield.localization.feature_map import MapFeatures
from beamfield.localization.information import FeatureInformation
from beamfield.localization.lattice_noise import widened_for_lattice
from beamfield.localization.pose_posterior import PoseLattice, PosePosterior, pose_posterior, posterior_of
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.sensors import Scan, usable_ranges

# Beams of a scan that are scored, evenly spaced, each for those beside it as well: casting all of them over a map takes
# minutes and, with an exponent, tells hardly more.
SCORED_BEAMS = 60
# Shares of a scan's features that the map does not show: things that moved, and, in the simulated office, half of the
# corners.
SPURIOUS_LINES, SPURIOUS_CORNERS = 0.2, 0.5
# Share of a wall in a scan that must lie beside a mapped wall.
MIN_OVERLAP = 0.5
SIGMA_OPENING = 0.15
# Walls are rougher than the noise of a good sensor, metres.
LEAST_NOISE = 0.02
# Where features of the scan and of the map are at least apart, metres and radians: walls are not straight.
MAP_SIGMA, MAP_SIGMA_ANGLE = 0.03, 0.01


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
) -> ScanAndFeatures:
    """Compare what a scan, its walls and its corners say about where in a map it was taken.

    The scan is scored by the beam model with 60 of its beams, walls by `LineModel`, and corners with their opening
    angle by `LandmarkModel`, both summed over all correspondences.

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
        The chapter's alpha of 6.3.4, in (0, 1]: one beam in 1 / exponent is independent of the others. Covariances of
        features are divided by it, so that scan and features take the same readings for as independent.

    Raises
    ------
    InvalidInputError
        If the exponent is out of range.
    """
    if not 0.0 < exponent <= 1.0:
        raise InvalidInputError(f"exponent: expected a number in (0, 1], got {exponent}")
    turn = lattice.heading_step
    wide = widened_for_lattice(parameters, resolution=lattice.resolution, headings=max(1, round(2.0 * np.pi / turn)))
    n = scan.finder.n_beams
    scored = min(n, SCORED_BEAMS)
    beam_model = BeamModel(grid, wide, exponent=min(1.0, exponent * n / scored), n_beams=scored)
    whole = pose_posterior(beam_model, scan, lattice)
    corrected, misfit = _on_map_surfaces(scan, parameters)
    lines = find_lines(corrected, RangeNoise(max(parameters.sigma_hit, LEAST_NOISE)))
    measured, covariances = stack_features(find_corners(lines))
    limit = scan.finder.max_range
    # Positions err by half a cell, headings by half a step; noise that grows with the range moves whole walls.
    beside = np.sqrt(MAP_SIGMA**2 + misfit**2 + lattice.resolution**2 / 12.0)
    turned = np.hypot(MAP_SIGMA_ANGLE, turn / np.sqrt(12.0))
    by_lines = by_corners = _prior(lattice)
    if features.lines is not None and lines:
        noise = LineParameters(float(beside), float(turned), SPURIOUS_LINES, limit)
        line_model = LineModel(features.lines, noise, correspondence="sum", min_overlap=MIN_OVERLAP)
        z = LineDetections.from_lines(lines)
        z = LineDetections(z.lines, np.asarray(z.covariances) / exponent, z.segments)
        by_lines = pose_posterior(line_model, z, lattice)
    if features.corners is not None and len(measured):
        typical = np.sqrt(np.median(covariances[:, [0, 1], [0, 1]], axis=0) / exponent)
        across = beside / np.median(measured[:, 0])
        corner_noise = LandmarkParameters(
            float(np.hypot(typical[0], beside)),
            float(np.hypot(np.hypot(typical[1], across), turned)),
            sigma_signature=SIGMA_OPENING,
            spurious_rate=SPURIOUS_CORNERS,
            max_range=limit,
        )
        corner_model = LandmarkModel(features.corners, corner_noise, correspondence="sum")
        by_corners = pose_posterior(corner_model, Detections(*measured.T), lattice)
    return ScanAndFeatures(whole, by_lines, by_corners, len(lines), len(measured))


def _on_map_surfaces(scan: Scan, parameters: BeamParameters) -> tuple[Scan, float]:
    """Return the scan as the map's surfaces would show it, and how far they are off at a typical range, metres."""
    z = usable_ranges(scan.ranges, scan.finder)
    measured = z < scan.finder.max_range
    typical = float(np.median(z[measured])) if measured.any() else 0.0
    # What is without return, or too close, stays what it is.
    corrected = np.where(measured, np.maximum(scan.ranges - parameters.range_offset, 0.0), scan.ranges)
    return replace(scan, ranges=corrected), parameters.sigma_slope * typical


def _prior(lattice: PoseLattice) -> PosePosterior:
    return posterior_of(np.zeros((int(lattice.inside.sum()), len(lattice.headings))), lattice)
