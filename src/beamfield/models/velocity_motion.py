"""The velocity motion model: a robot that drives an arc with noisy speeds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, between
from beamfield.kernels.motion import EXACT
from beamfield.models.motion import OdometryMotion, check_not_negative, odometry_step
from beamfield.models.motion_steps import log_angle, log_normal

# Arcs whose chords differ by half turns, driven forwards or backwards, lead to the same place; these are counted.
_HALF_TURNS = range(-2, 3)


@dataclass(frozen=True)
class VelocityMotion(OdometryMotion):
    """A robot that drives at a noisy speed v and turn rate w for a while, and then turns by a little (Table 5.3).

    The variances are alpha1 v^2 + alpha2 w^2 of v, alpha3 v^2 + alpha4 w^2 of w, and alpha5 v^2 + alpha6 w^2 of the
    rate of the turn at the end. The speeds are those of the arc that odometry drove in `duration`: what it reports
    across that arc, as of a robot that slips sideways, is left out.

    Parameters
    ----------
    alpha1, alpha2, alpha3, alpha4, alpha5, alpha6
        As above.
    duration
        Of each step, seconds.

    Raises
    ------
    InvalidInputError
        If an alpha is negative, the duration not positive, or a number not finite.

    Notes
    -----
    The log density is that of Table 5.1, times what the table leaves out: the determinant of the map from speeds to
    poses, without which it is no density over poses. Arcs of up to two whole turns are counted; without
    noise at the end (alpha5 = alpha6 = 0) that part is a mass.

    References
    ----------
    Probabilistic Robotics, Tables 5.1 and 5.3.

    Examples
    --------
    >>> model = VelocityMotion(alpha1=0.01, alpha4=0.01, duration=0.5)
    >>> odometry = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
    >>> particles = model.sample(np.zeros((1000, 3)), odometry, np.random.default_rng(0))
    >>> particles[:, 0].std().round(2).item()
    0.05
    """

    alpha1: float = 0.02
    alpha2: float = 0.02
    alpha3: float = 0.02
    alpha4: float = 0.02
    alpha5: float = 0.005
    alpha6: float = 0.005
    duration: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, *(f"alpha{i}" for i in range(1, 7)), "duration")
        if self.duration == 0.0:
            raise InvalidInputError("duration: expected a positive number of seconds, got 0")

    def step(self, odometry: FloatArray) -> ArcStep:
        """Return the distribution of the step between two odometry poses (2, 3)."""
        v, w = arc_speeds(odometry, self.duration)
        squares = np.array([v**2, w**2])
        alphas = np.array([[self.alpha1, self.alpha2], [self.alpha3, self.alpha4], [self.alpha5, self.alpha6]])
        return ArcStep(v, w, np.sqrt(alphas @ squares), self.duration)


@dataclass(frozen=True, eq=False)
class ArcStep:
    """An arc of noisy speeds, in m/s and rad/s, and a noisy turn at its end.

    The deviations (3,) are those of v, w and the rate of the turn at the end; the duration is in seconds.
    """

    v: float
    w: float
    deviations: FloatArray
    duration: float

    def sample(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw where each of the poses (n, 3) is after the step; takes n rows of 3 standard normals: v, w, end."""
        noise = self.deviations * rng.standard_normal((len(poses), 3))
        turn = (self.w + noise[:, 1]) * self.duration
        # The chord of an arc is at half the turn from either end; no division by a turn rate of 0.
        chord = (self.v + noise[:, 0]) * self.duration * np.sinc(turn / (2.0 * np.pi))
        bearing = poses[:, 2] + 0.5 * turn
        return np.column_stack(
            [
                poses[:, 0] + chord * np.cos(bearing),
                poses[:, 1] + chord * np.sin(bearing),
                poses[:, 2] + turn + noise[:, 2] * self.duration,
            ]
        )

    def log_density(self, after: FloatArray, before: FloatArray) -> FloatArray:
        """Return the log density of `after`, given `before`, both (n, 3)."""
        step = between(before, after)
        distance = np.hypot(step[:, 0], step[:, 1])
        mean_turn, turn_spread, end_spread = self.w * self.duration, *(self.deviations[1:] * self.duration)
        if self.v == 0.0 and self.deviations[0] == 0.0:
            # The arc has no length, and both turns are in place.
            rotation = log_angle(step[:, 2] - mean_turn, math.hypot(turn_spread, end_spread))
            return np.where(distance <= EXACT, rotation, -np.inf)
        bearing = np.arctan2(step[:, 1], step[:, 0])
        ways = []
        for k in _HALF_TURNS:  # driven backwards where it is odd
            length, log_scale = self._arc((-1.0) ** k * distance, bearing + np.pi * k)
            turn = 2.0 * (bearing + np.pi * k)
            ways.append(
                log_normal(length - self.v * self.duration, self.deviations[0] * self.duration)
                + log_normal(turn - mean_turn, turn_spread)
                + log_angle(step[:, 2] - turn, end_spread)
                - log_scale
            )
        return np.asarray(np.logaddexp.reduce(ways))

    def covariance(self) -> FloatArray:
        """Return the covariance (3, 3) of ahead, left, turn, to first order in the noise, but for that of long turns.

        Length, turn and the turn at the end move the chord's end by d(chord) = sinc(turn / 2) d(length) along its
        bearing and by chord d(turn) / 2 across it; what a turn takes from the chord's length is left out.
        """
        half_turn = 0.5 * self.w * self.duration
        shortening = float(np.sinc(half_turn / np.pi))
        chord = self.v * self.duration * shortening
        cos, sin = math.cos(half_turn), math.sin(half_turn)
        root = np.array(
            [[shortening * cos, -0.5 * chord * sin, 0.0], [shortening * sin, 0.5 * chord * cos, 0.0], [0.0, 1.0, 1.0]]
        ) * (self.deviations * self.duration)  # fmt: skip
        return np.asarray(root @ root.T)

    def _arc(self, chord: FloatArray, half_turn: FloatArray) -> tuple[FloatArray, FloatArray | float]:
        """Return the length of an arc with this chord, and log d(x, y) / (d length d turn).

        d(x, y) = chord d chord d half_turn; what has no noise is not integrated over.
        """
        shortening = np.abs(np.sinc(half_turn / np.pi)) + 1e-300
        length = np.sign(np.sinc(half_turn / np.pi)) * chord / shortening
        pole = np.log(0.5 * np.maximum(np.abs(chord), EXACT)) if self.deviations[1] > 0.0 else 0.0
        return length, pole + (np.log(shortening) if self.deviations[0] > 0.0 else 0.0)


def arc_speeds(odometry: FloatArray, duration: float) -> tuple[float, float]:
    """Return speed and turn rate of the arc between two odometry poses (2, 3): m/s, negative backwards, and rad/s."""
    ahead, left, turn = odometry_step(odometry).tolist()
    along = ahead * math.cos(0.5 * turn) + left * math.sin(0.5 * turn)
    return along / float(np.sinc(turn / (2.0 * np.pi))) / duration, turn / duration
