"""Sample robot poses that fit landmark detections: section 6.6.4, Table 6.5."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import erfcx, ndtr

from beamfield.arguments import LARGEST, as_count, checked, require
from beamfield.detections import SPURIOUS, Detections
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray, compose, invert, wrap_angle
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.landmark_signatures import LOG_2PI, signature_log_density
from beamfield.models.wrapped_normal import sample_wrapped
from beamfield.short_repr import short_repr

# With a grid, drawing stops when less than one pose in so many lies in free space.
MAX_DRAWS_PER_POSE = 10_000
# From so many standard deviations below 0 on, the mass is that of its leading term, density / a^2, to 3e-8.
FAR_BELOW = -1e4
# 2.4 GB.
MOST_POSES = 100_000_000
# Poses drawn at a time, at most.
MAX_BATCH = 1_000_000


class PoseSamples(NamedTuple):
    """Weighted poses."""

    poses: FloatArray
    """(n, 3) metres and radians."""
    log_weights: FloatArray
    """(n,) nats, normalised: their exponentials sum to 1."""

    def __repr__(self) -> str:
        return short_repr(self)

    @property
    def effective_size(self) -> float:
        """1 / sum of squared weights: the number of equally weighted poses that are worth as much."""
        return float(1.0 / np.exp(2.0 * self.log_weights).sum())


class _Proposal(NamedTuple):
    """One feature turned into a density over poses."""

    range: float
    """Mean distance, bias and scale taken out; NaN if there is none."""
    bearing: float
    """Bias taken out; NaN if there is none."""
    probabilities: FloatArray
    """(N,) of each landmark."""
    log_mass: float
    """Integral of the feature's likelihood over all poses, averaged over the landmarks if unknown."""


@checked
def sample_poses(
    model: LandmarkModel,
    detections: Detections,
    n: int,
    rng: np.random.Generator,
    *,
    method: Literal["exact", "table"] = "exact",
    grid: OccupancyGrid | None = None,
) -> PoseSamples:
    """Sample poses from p(x | f(z), m) under a uniform prior over x, y and theta (6.41).

    With one feature the poses follow the posterior and all have the same weight. With several, each pose comes from one
    feature's posterior, chosen evenly, and has a weight: the product of all features' likelihoods, divided by the mean
    over features of the density that drew it (importance sampling from the even mixture). The weighted poses follow the
    posterior given all features; `effective_size` says how well.

    Parameters
    ----------
    model
        Map, noise and mount; its correspondence is not used. A feature of unknown id is taken for each landmark with
        equal prior probability (its signature counts), never for a spurious one.
    detections
        At least one feature; none spurious. A feature without range counts only poses within the parameters'
        max_range of the landmark.
    n
        Number of poses.
    rng
        Source of randomness; the same state gives the same poses.
    method
        - "exact": the distance r' to the landmark has the density r' N(r'; r, sigma_r), because a ring of twice the
          radius holds twice as many poses.
        - "table": r' is normal, as Table 6.5 has it; poses are too dense on the inside, by the factor r / r'. One
          feature with a range only.
    grid
        Poses outside of this map's free cells are drawn again: the prior is then uniform over free space.

    Returns
    -------
    Poses with normalised weights; -inf is the log weight of a pose that does not explain all features.

    Raises
    ------
    InvalidInputError
        If n is not from 1 to 10^8; a feature is spurious, has a range beyond 10^9 m, none while there is no max_range,
        or neither range nor bearing; an id or signature does not fit the map; or method "table" is asked for more than
        one feature.
    TooLittleDataError
        If less than one pose in 10,000 lies in free space, no pose explains all features, or no landmark can have a
        feature's type.

    Notes
    -----
    Table 6.5 draws gamma uniform, perturbs range and bearing, and looks back from the landmark; so does this. Bearing
    noise is cut off at a half turn, and biases and scale are taken out, as in `LandmarkModel`.

    References
    ----------
    Probabilistic Robotics, section 6.6.4: (6.41), Table 6.5.

    Examples
    --------
    >>> from beamfield.maps.landmarks import LandmarkMap
    >>> from beamfield.models.landmark_parameters import LandmarkParameters
    >>> noise = LandmarkParameters(sigma_range=0.1, sigma_bearing=0.05)
    >>> model = LandmarkModel(LandmarkMap([[2.0, 0.0]]), noise, correspondence="known")
    >>> seen = Detections([5.0], [np.pi / 6], ids=[1])
    >>> poses = sample_poses(model, seen, 1000, np.random.default_rng(0)).poses
    >>> float(np.hypot(poses[:, 0] - 2.0, poses[:, 1]).mean().round(1))
    5.0
    """
    require(method in ("exact", "table"), "method", "'exact' or 'table'", method)
    n = as_count(n, "n", least=1, most=MOST_POSES)
    proposals = _proposals(model, detections)
    if method == "table" and (len(detections) > 1 or np.isnan(detections.ranges).any()):
        raise InvalidInputError(f"method: 'table' takes one feature with a range, got {len(detections)} features")
    poses = _draw_free(model, proposals, n, rng, method == "exact", grid)
    if len(proposals) == 1:
        return PoseSamples(poses, np.full(n, -math.log(n)))
    each = _log_likelihoods(model, detections, poses)
    log_densities = each - np.array([proposal.log_mass for proposal in proposals])
    log_density = np.logaddexp.reduce(log_densities, axis=1)
    # Rounding can put a pose just beyond the only max_range that allowed it.
    possible = log_density > -np.inf
    log_weights: FloatArray = np.full(n, -np.inf)
    log_weights[possible] = each[possible].sum(axis=1) - log_density[possible]
    total = np.logaddexp.reduce(log_weights)
    if not np.isfinite(total):
        raise TooLittleDataError(f"none of {n} poses explains all {len(detections)} features")
    return PoseSamples(poses, np.asarray(log_weights - total))


def sample_distances(mean: float, sigma: float, n: int, rng: np.random.Generator) -> FloatArray:
    """Draw n distances r' > 0 with a density proportional to r' N(r'; mean, sigma): a ring's area grows with r'.

    All in metres; the mean may be negative.
    """
    a = mean / sigma
    propose = _propose_beyond if a < 0.0 else _propose_around
    parts: list[FloatArray] = []
    missing = n
    while missing > 0:
        accepted = propose(a, 2 * missing + 10, rng)[:missing]
        parts.append(sigma * accepted)
        missing -= len(accepted)
    return np.concatenate(parts) if parts else np.empty(0)


def log_distance_mass(mean: float, sigma: float) -> float:
    """Return the log of the integral of r' N(r'; mean, sigma) over r' > 0; finite, however low the mean lies."""
    a = mean / sigma
    # sigma (density(a) + a share below a); far negative means would cancel to 0 unless the density is taken out.
    if a < FAR_BELOW:
        return math.log(sigma) - 0.5 * (a * a + LOG_2PI) - 2.0 * math.log(-a)
    if a < 0.0:
        share = math.sqrt(math.pi / 2.0) * float(erfcx(-a / math.sqrt(2.0)))
        return math.log(sigma) - 0.5 * (a * a + LOG_2PI) + math.log1p(a * share)
    return math.log(sigma * math.exp(-0.5 * (a * a + LOG_2PI)) + mean * float(ndtr(a)))


def _proposals(model: LandmarkModel, detections: Detections) -> list[_Proposal]:
    p, landmarks = model.parameters, model.landmarks
    if not len(detections):
        raise InvalidInputError("detections: expected at least one feature, got none")
    if detections.ids is not None and (detections.ids == SPURIOUS).any():
        raise InvalidInputError("ids: a spurious feature does not constrain the pose, got SPURIOUS")
    result = []
    signatures = signature_log_density(detections.signatures, len(detections), landmarks, p)[:, :-1]
    for k in range(len(detections)):
        measured, bearing = float(detections.ranges[k]), float(detections.bearings[k])
        if math.isnan(measured) and math.isnan(bearing):
            raise InvalidInputError(f"detections: feature {k} has neither range nor bearing")
        if abs(measured) > LARGEST:
            raise InvalidInputError(f"ranges: expected at most {LARGEST:g} m, got {measured:g} of feature {k}")
        if not math.isnan(measured) and p.sigma_range is None:
            raise InvalidInputError(f"sigma_range: feature {k} has a range, but the sigma is None")
        if not math.isnan(bearing) and p.sigma_bearing is None:
            raise InvalidInputError(f"sigma_bearing: feature {k} has a bearing, but the sigma is None")
        if math.isnan(measured) and p.max_range is None:
            raise InvalidInputError(f"max_range: feature {k} has no range, but max_range is None")
        log_shares = signatures[k] - math.log(len(landmarks))
        if detections.ids is not None and detections.ids[k] >= 0:
            log_shares = np.full(len(landmarks), -np.inf)
            which = landmarks.indices_of(detections.ids[k : k + 1])[0]
            log_shares[which] = signatures[k, which]
        log_total = float(np.logaddexp.reduce(log_shares))
        if log_total == -math.inf:
            raise TooLittleDataError(f"no landmark can show the signature of feature {k}")
        # Over gamma and theta: a bearing fixes theta, or theta is free, and then any bearing's density is 1.
        log_mass = LOG_2PI + log_total + (LOG_2PI if math.isnan(bearing) else 0.0)
        if math.isnan(measured):
            log_mass += 2.0 * math.log(float(p.max_range or math.nan)) - math.log(2.0)
        else:
            # A density over measured ranges as one over distances: the scale's factor appears once.
            log_mass += log_distance_mass(*_distance(measured, p)) - math.log(p.range_scale)
        shares = np.exp(log_shares - log_total)
        distance = _distance(measured, p)[0]
        result.append(_Proposal(distance, bearing - p.bearing_bias, shares / shares.sum(), log_mass))
    return result


def _distance(measured: float, p: LandmarkParameters) -> tuple[float, float]:
    """Return mean and standard deviation of the distance, without bias and scale, that a measured range tells."""
    return (measured - p.range_bias) / p.range_scale, (p.sigma_range or math.nan) / p.range_scale


def _draw_free(
    model: LandmarkModel, proposals: list[_Proposal], n: int, rng: np.random.Generator, exact: bool,
    grid: OccupancyGrid | None,
) -> FloatArray:  # fmt: skip
    parts: list[FloatArray] = []
    found = drawn = 0
    while found < n:
        if drawn > MAX_DRAWS_PER_POSE * (found + 1):
            raise TooLittleDataError(f"only {found} of {drawn} poses that fit the features lie in free space")
        share = max(found, 1) / drawn if drawn else 1.0
        batch = min(MAX_BATCH, int((n - found) / share) + 1)
        poses = _draw(model, proposals, batch, rng, exact)
        drawn += batch
        if grid is not None:
            poses = poses[grid.look_up(grid.free, poses[:, :2])]
        parts.append(poses[: n - found])
        found += len(parts[-1])
    return np.concatenate(parts)


def _draw(
    model: LandmarkModel, proposals: list[_Proposal], n: int, rng: np.random.Generator, exact: bool
) -> FloatArray:
    """Draw from the even mixture of the features' posteriors: lines 2 to 8 of Table 6.5."""
    p, positions = model.parameters, model.landmarks.positions
    poses: FloatArray = np.empty((n, 3))
    chosen = rng.integers(len(proposals), size=n)
    sigma = (p.sigma_range or math.nan) / p.range_scale
    for k, proposal in enumerate(proposals):
        mine = np.flatnonzero(chosen == k)
        m = len(mine)
        j = rng.choice(len(positions), size=m, p=proposal.probabilities)
        gamma = rng.uniform(0.0, 2.0 * np.pi, m)
        if math.isnan(proposal.range):
            distance = float(p.max_range or math.nan) * np.sqrt(rng.random(m))
        elif exact:
            distance = sample_distances(proposal.range, sigma, m, rng)
        else:
            distance = proposal.range + sigma * rng.standard_normal(m)
        if math.isnan(proposal.bearing):
            bearing = rng.uniform(-np.pi, np.pi, m)
        else:
            bearing = proposal.bearing + sample_wrapped(p.sigma_bearing or math.nan, (m,), rng)
        poses[mine, 0] = positions[j, 0] + distance * np.cos(gamma)
        poses[mine, 1] = positions[j, 1] + distance * np.sin(gamma)
        poses[mine, 2] = wrap_angle(gamma - np.pi - bearing)
    return compose(poses, invert(model.mount))


def _log_likelihoods(model: LandmarkModel, detections: Detections, poses: FloatArray) -> FloatArray:
    """Return log p of each feature given each pose, (n, k), as the proposals have it."""
    p = replace(model.parameters, spurious_rate=0.0)
    without_spurious = LandmarkModel(model.landmarks, p, correspondence="sum", mount=model.mount)
    each = without_spurious.detection_log_likelihood(detections, poses)
    no_range = np.isnan(detections.ranges)
    if no_range.any():
        # Beyond max_range a feature without range excludes the pose; of an unknown landmark, landmarks are left out.
        sensor = compose(poses, model.mount)
        for k in np.flatnonzero(no_range):
            each[:, k] = _bearing_only(without_spurious, detections.subset([k]), poses, sensor)
    return each


def _bearing_only(model: LandmarkModel, one: Detections, poses: FloatArray, sensor: FloatArray) -> FloatArray:
    landmarks = model.landmarks
    known = one.ids is not None and one.ids[0] >= 0
    candidates = np.asarray(one.ids) if known else landmarks.ids
    near: FloatArray = np.empty((len(poses), len(candidates)))
    for column, which in enumerate(candidates):
        named = Detections(one.ranges, one.bearings, one.signatures, np.array([which]))
        away = landmarks.positions[landmarks.indices_of([which])[0]] - sensor[:, :2]
        within = np.hypot(away[:, 0], away[:, 1]) <= float(model.parameters.max_range or math.nan)
        near[:, column] = np.where(within, model.log_likelihood(named, poses), -np.inf)
    return np.asarray(np.logaddexp.reduce(near, axis=1) - math.log(len(candidates)))


def _propose_around(a: float, n: int, rng: np.random.Generator) -> FloatArray:
    """Accepted of n draws of r' / sigma for a mean of a >= 0 sigma.

    (a + t) N(t), with t = r' / sigma - a > -a, lies below (a + |t|) N(t): a normal, or a Rayleigh with either sign.
    """
    normal = rng.random(n) * (a + math.sqrt(2.0 / math.pi)) < a
    signs = np.where(rng.random(n) < 0.5, -1.0, 1.0)
    t = np.where(normal, rng.standard_normal(n), signs * rng.rayleigh(size=n))
    accepted = rng.random(n) * (a + np.abs(t)) < a + t
    return np.asarray((a + t)[accepted])


def _propose_beyond(a: float, n: int, rng: np.random.Generator) -> FloatArray:
    """Accepted of n draws for a mean below 0: w exp(-|a| w - w^2 / 2) lies below a gamma's w exp(-rate w)."""
    rate = max(-a, 1.0)
    w = rng.gamma(2.0, 1.0 / rate, n)
    accepted = rng.random(n) < np.exp(-0.5 * np.square(w - (rate + a)))
    return np.asarray(w[accepted])
