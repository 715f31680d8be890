"""What makes each model a density: the integral over all measurements, and a transform of what it draws."""

from __future__ import annotations

import numpy as np
from scipy import stats

from beamfield.detections import UNKNOWN, Detections
from beamfield.geometry import wrap_angle
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_pit
from beamfield.models.landmark import LandmarkModel
from beamfield.models.line import LineModel
from beamfield.models.line_detections import LineDetections
from beamfield.models.marker import MarkerDetections, MarkerModel
from beamfield.models.sonar import SonarModel
from beamfield.sensors import Scan


def integrate_one_beam(model: BeamModel | SonarModel, pose: np.ndarray) -> float:
    """Return the integral over the range of a single beam, by the midpoint rule, plus the mass at max_range."""
    finder, far = model.finder.subset([4]), model.finder.max_range
    total = np.exp(model.log_likelihood(Scan([far], finder), pose))
    # In a wall, p_short fills the first micrometre.
    first = finder.min_range + 2e-6
    for low, high, n in [(finder.min_range, first, 100), (first, far, 50_000)]:
        ranges = low + (np.arange(n) + 0.5) * (high - low) / n
        same_ray = finder.subset(np.zeros(n, np.int64))
        density = np.exp(model.beam_log_likelihood(Scan(ranges, same_ray), pose))
        total += density.mean() * (high - low)
    return float(total)


def beam_transform(
    model: BeamModel | SonarModel, scans: list[Scan], pose: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return the randomised probability integral transform of all beams of all scans."""
    ranges = np.array([scan.ranges for scan in scans])
    low, far = model.finder.min_range, model.finder.max_range
    return beam_pit(ranges, model.expected(pose), far, model.parameters, rng, min_range=low).ravel()


def integrate_one_feature(model: LandmarkModel, pose: np.ndarray) -> float:
    """Return the integral over range and bearing of one feature, by the midpoint rule."""
    ranges, bearings = -4.95 + 0.1 * np.arange(950), (np.arange(160) + 0.5) * np.pi / 80.0
    r, phi = (axis.ravel() for axis in np.meshgrid(ranges, bearings))
    which = UNKNOWN if model.correspondence == "sum" else 3
    density = np.exp(model.detection_log_likelihood(Detections(r, phi, ids=np.full(r.size, which)), pose))
    return float(density.sum() * 0.1 * np.pi / 80.0)


def landmark_transform(
    model: LandmarkModel, features: list[Detections], pose: np.ndarray, _: np.random.Generator
) -> np.ndarray:
    """Return the probability integral transform of all ranges and bearings."""
    expected = model.expected(pose)
    a = np.array([z.ranges - expected[:, 0] for z in features]) / model.parameters.sigma_range
    b = np.array([wrap_angle(z.bearings - expected[:, 1]) for z in features]) / model.parameters.sigma_bearing
    end = np.pi / model.parameters.sigma_bearing
    return np.concatenate([stats.norm.cdf(a).ravel(), stats.truncnorm.cdf(b, -end, end).ravel()])


def integrate_one_line(model: LineModel, pose: np.ndarray) -> float:
    """Return the integral over rho and alpha of one line, by the midpoint rule."""
    rho, alpha = 0.05 + 0.1 * np.arange(800), (np.arange(160) + 0.5) * np.pi / 80.0
    r, a = (axis.ravel() for axis in np.meshgrid(rho, alpha))
    which = np.full(r.size, UNKNOWN if model.correspondence == "sum" else 3)
    density = np.exp(model.detection_log_likelihood(LineDetections(np.column_stack([r, a]), ids=which), pose))
    return float(density.sum() * 0.1 * np.pi / 80.0)


def line_transform(
    model: LineModel, samples: list[LineDetections], pose: np.ndarray, _: np.random.Generator
) -> np.ndarray:
    """Return the distribution functions of rho, folded at 0, and of alpha given rho, from half a turn before it."""
    expected = model.expected(pose)
    measured = np.array([z.lines for z in samples])
    rho, wide = measured[..., 0] / model.parameters.sigma_rho, np.pi / model.parameters.sigma_alpha
    d = expected[:, 0] / model.parameters.sigma_rho
    of_rho = stats.norm.cdf(rho - d) - stats.norm.cdf(-rho - d)
    turn = wrap_angle(measured[..., 1] - expected[:, 1])
    same = stats.norm.pdf(rho - d) / (stats.norm.pdf(rho - d) + stats.norm.pdf(rho + d))
    law = stats.truncnorm(-wide, wide, scale=model.parameters.sigma_alpha)
    behind = np.where(turn <= 0.0, law.cdf(turn + np.pi) - 0.5, 0.5 + law.cdf(turn - np.pi))
    return np.concatenate([of_rho.ravel(), (same * law.cdf(turn) + (1.0 - same) * behind).ravel()])


def integrate_one_marker(model: MarkerModel, pose: np.ndarray) -> float:
    """Return the integral over place and angle of one marker, by the trapezoidal rule in steps of sigma."""
    steps = np.arange(-4.5, 5.0) * model.parameters.sigma_pixel
    n_angles = int(np.ceil(2.0 * np.pi / model.parameters.sigma_angle)) + 8
    angles = -np.pi + 2.0 * np.pi * np.arange(n_angles) / n_angles
    noise = np.stack(np.meshgrid(steps, steps, angles, indexing="ij"), axis=-1).reshape(-1, 3)
    z = MarkerDetections([8] * len(noise), model.expected(pose)[1] + noise)
    cell = (steps[1] - steps[0]) ** 2 * 2.0 * np.pi / n_angles
    return float(np.exp(model.detection_log_likelihood(z, pose)).sum() * cell)


def marker_transform(
    model: MarkerModel, samples: list[MarkerDetections], pose: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return the distribution functions of places and (from half a turn before the expected one) of angles."""
    del rng  # nothing is discrete
    error = np.array([z.image for z in samples]) - model.expected(pose)
    angle = np.pi - np.mod(np.pi - error[..., 2], 2.0 * np.pi)
    turns = 2.0 * np.pi * np.arange(-10, 11)[:, None, None]
    law = stats.norm(0.0, model.parameters.sigma_angle)
    of_angle = (law.cdf(angle + turns) - law.cdf(-np.pi + turns)).sum(axis=0)
    return np.concatenate([stats.norm.cdf(error[..., :2] / model.parameters.sigma_pixel).ravel(), of_angle.ravel()])
