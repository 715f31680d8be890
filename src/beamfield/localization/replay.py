"""What a filter did on a log, and how far off it was: one set of numbers for every filter."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri

from beamfield.arguments import as_floats, check_fields, checked, require
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray, as_poses, wrap_angle
from beamfield.maps.occupancy import BoolArray
from beamfield.sensors import SensorLog
from beamfield.short_repr import short_repr

# A run is lost that ends so far off, metres, or is so far off in more than this share of the scans.
LOST_DISTANCE = 2.0
LOST_SHARE = 0.1
# Reference poses are themselves uncertain by about this much, metres.
REFERENCE_NOISE = 0.03
# Variances below this, m^2 and rad^2, count as this much: a cloud of equal particles has none.
LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, eq=False)
class PoseBelief:
    """A normal belief of where the robot is, for a filter to start from.

    Parameters
    ----------
    mean
        (3,) pose, metres and radians.
    covariance
        (3, 3) of x, y, theta; symmetric, none of its eigenvalues negative.

    Raises
    ------
    InvalidInputError
        If a shape or a number is not valid.
    """

    mean: FloatArray
    covariance: FloatArray

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(self, mean: ArrayLike, covariance: ArrayLike) -> None: ...

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        mean, covariance = as_poses(self.mean, "mean"), as_floats(self.covariance, "covariance")
        if mean.shape != (3,) or covariance.shape != (3, 3) or not np.isfinite(covariance).all():
            raise InvalidInputError(
                f"mean, covariance: expected finite numbers of shape (3,) and (3, 3), got {mean.shape} and "
                f"{covariance.shape}"
            )
        largest = np.abs(covariance).max()
        if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] < -1e-9 * largest:
            raise InvalidInputError(f"covariance: expected a covariance matrix, got {covariance.tolist()}")
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    @checked
    def around(cls, pose: ArrayLike, *, sd_position: float = 0.5, sd_heading: float = np.pi / 12) -> PoseBelief:
        """Return a belief with independent x, y and theta.

        Parameters
        ----------
        pose
            (3,) metres and radians.
        sd_position
            Standard deviation of x and of y, metres.
        sd_heading
            That of the heading, radians.

        Raises
        ------
        InvalidInputError
            If a standard deviation is negative or not finite.
        """
        for name, value in (("sd_position", sd_position), ("sd_heading", sd_heading)):
            require(0.0 <= value < np.inf, name, "a finite number of at least 0", value)
        return cls(as_poses(pose, "pose"), np.diag(np.square([sd_position, sd_position, sd_heading])))


@dataclass(frozen=True, eq=False)
class Replay:
    """What a filter said while a log ran.

    Parameters
    ----------
    poses
        (t, 3) the pose that it published at each scan, metres and radians; NaN where it had none to publish.
    updates
        (u,) indices of the scans that it used, increasing.
    means, covariances
        (u, 3) and (u, 3, 3) of its particles after these scans, metres and radians.
    particles
        (u,) how many there were.
    seconds
        (u,) processor time of each update; empty if it was not taken.

    Raises
    ------
    InvalidInputError
        If an array has another shape, or a mean or covariance is not finite.
    """

    poses: FloatArray
    updates: NDArray[np.int64]
    means: FloatArray
    covariances: FloatArray
    particles: NDArray[np.int64]
    seconds: FloatArray = field(default_factory=lambda: np.empty(0))

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        t, u = len(self.poses), len(self.updates)
        shapes = {
            "poses": (t, 3), "updates": (u,), "means": (u, 3), "covariances": (u, 3, 3), "particles": (u,),
            "seconds": (u,) if len(self.seconds) else (0,),
        }  # fmt: skip
        for name, shape in shapes.items():
            array = np.asarray(getattr(self, name))
            require(array.shape == shape, name, f"shape {shape}", array.shape)
            if name in ("means", "covariances") and not np.isfinite(array).all():
                raise InvalidInputError(f"{name}: expected finite numbers")
        if u and not (self.updates[0] >= 0 and self.updates[-1] < t and (np.diff(self.updates) > 0).all()):
            raise InvalidInputError(f"updates: expected increasing indices of {t} scans")


class ReplayedFilter(Protocol):
    """A filter that can be replayed."""

    def run(self, log: SensorLog, start: PoseBelief | None, rng: np.random.Generator) -> Replay:
        """Filter a log with odometry, whose reference poses are not looked at.

        The start is where the robot is at the first scan; None if it can be anywhere on the map.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class ReplayErrors:
    """How far off one run was from the reference.

    Parameters
    ----------
    mean, median, p95, end
        Distance between published and reference position, metres: over all scans that have both, and at the last.
    lost
        Whether the distance exceeds 2 m at the last scan, or in more than 10% of the scans.
    yaw_mean_deg, yaw_median_deg, yaw_p95_deg, yaw_rmse_deg
        Error of the published heading over the same scans, without sign, degrees.
    nees_median
        Median over updates of the particles' normalised estimation error squared,
        ``(mean - reference)^T covariance^-1 (mean - reference)`` in x, y and theta; 2.37 if the covariance is right.
    inside
        Share of the updates with a reference in which the particles' 95% ellipse of x and y holds it; 0.95 if it is
        right.
    inside_noisy
        The same, with a noise of the reference of 3 cm in x and in y.
    sd_position
        Median over updates of the root of the summed variances of x and y, metres.
    particles
        Mean number of particles.
    updates
        How many updates there were.
    update_ms
        Median processor time of an update, milliseconds; None if it was not taken.
    """

    mean: float
    median: float
    p95: float
    end: float
    lost: bool
    yaw_mean_deg: float
    yaw_median_deg: float
    yaw_p95_deg: float
    yaw_rmse_deg: float
    nees_median: float
    inside: float
    inside_noisy: float
    sd_position: float
    particles: float
    updates: int
    update_ms: float | None = None

    def summary(self) -> str:
        """Return the numbers in three lines for people."""
        time = "" if self.update_ms is None else f" of {self.update_ms:.3g} ms"
        before = f", but LOST before, more than {LOST_DISTANCE:g} m off in over {LOST_SHARE:.0%} of the scans"
        lost = "" if not self.lost else ": LOST" if self.end > LOST_DISTANCE else before
        return (
            f"position error {self.mean:.3f} m mean, {self.median:.3f} median, 95% below {self.p95:.3f}, "
            f"{self.end:.3f} at the end{lost}; heading {self.yaw_rmse_deg:.2f} deg rms\n"
            f"reference inside the particles' 95% ellipse in {self.inside:.0%} of the updates with a reference "
            f"({self.inside_noisy:.0%} with {REFERENCE_NOISE:g} m of noise of the reference), median NEES "
            f"{self.nees_median:.2f} (right: 2.37)\n"
            f"{self.particles:.0f} particles, standard deviation {self.sd_position:.3f} m, {self.updates} updates{time}"
        )


MEASURES = tuple(item.name for item in fields(ReplayErrors))


@checked
def judge_replay(replay: Replay, reference: ArrayLike) -> ReplayErrors:
    """Compare a run with reference poses.

    Parameters
    ----------
    replay
        What a filter said.
    reference
        (t, 3) poses of the robot, metres and radians; NaN where there is none. Scans without it do not count.

    Returns
    -------
    The errors. All are finite: a variance of the particles below (1 um)^2 or (1 urad)^2 counts as that.

    Raises
    ------
    InvalidInputError
        If the reference has another shape.
    TooLittleDataError
        If no scan, or no update, has both a pose and a reference.

    Examples
    --------
    >>> poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> replay = Replay(poses, np.array([1]), poses[1:], np.diag([0.01, 0.01, 0.01])[None], np.array([500]))
    >>> errors = judge_replay(replay, [[0.0, 0.0, 0.0], [1.0, 0.1, 0.0]])
    >>> round(errors.mean, 3), round(errors.nees_median, 3), errors.lost
    (0.05, 1.0, False)
    """
    truth = as_floats(reference, "reference")
    require(truth.shape == replay.poses.shape, "reference", f"shape {replay.poses.shape}", truth.shape)
    known: BoolArray = np.asarray(np.isfinite(truth).all(axis=1))
    scans = known & np.isfinite(replay.poses).all(axis=1)
    judged = known[replay.updates]
    if not scans.any() or not judged.any():
        raise TooLittleDataError(
            f"reference: {int(scans.sum())} scans and {int(judged.sum())} of {len(judged)} updates have both a pose "
            "of the filter and of the reference, at least one of each is needed"
        )
    off = _difference(replay.poses[scans], truth[scans])
    distance, turn = np.hypot(off[:, 0], off[:, 1]), np.degrees(np.abs(off[:, 2]))
    off = _difference(replay.means[judged], truth[replay.updates[judged]])
    covariances = replay.covariances[judged]
    noise = np.diag([REFERENCE_NOISE**2, REFERENCE_NOISE**2])
    limit = float(chdtri(2, 0.05))
    return ReplayErrors(
        mean=float(distance.mean()),
        median=float(np.median(distance)),
        p95=float(np.percentile(distance, 95.0)),
        end=float(distance[-1]),
        lost=bool(distance[-1] > LOST_DISTANCE or (distance > LOST_DISTANCE).mean() > LOST_SHARE),
        yaw_mean_deg=float(turn.mean()),
        yaw_median_deg=float(np.median(turn)),
        yaw_p95_deg=float(np.percentile(turn, 95.0)),
        yaw_rmse_deg=float(np.sqrt((turn**2).mean())),
        nees_median=float(np.median(normalised_squares(off, covariances))),
        inside=float((normalised_squares(off[:, :2], covariances[:, :2, :2]) <= limit).mean()),
        inside_noisy=float((normalised_squares(off[:, :2], covariances[:, :2, :2] + noise) <= limit).mean()),
        sd_position=float(np.median(np.sqrt(np.trace(replay.covariances[:, :2, :2], axis1=1, axis2=2)))),
        particles=float(replay.particles.mean()),
        updates=len(replay.updates),
        update_ms=1e3 * float(np.median(replay.seconds)) if len(replay.seconds) else None,
    )


def normalised_squares(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return ``e^T C^-1 e`` of errors (n, d) and covariances (n, d, d), with eigenvalues of 1e-12 at least."""
    values, vectors = np.linalg.eigh(covariances)
    along = (vectors * errors[:, :, None]).sum(axis=1)
    return np.asarray((along**2 / np.maximum(values, LEAST_VARIANCE)).sum(axis=1))


def _difference(poses: FloatArray, truth: FloatArray) -> FloatArray:
    off = poses - truth
    off[:, 2] = wrap_angle(off[:, 2])
    return off


def reference_start(log: SensorLog, **spread: Any) -> tuple[int, PoseBelief]:
    """Return the first scan that has both a reference pose and odometry, and a belief around its reference pose.

    The spread is as for `PoseBelief.around`. TooLittleDataError if there is no such scan.
    """
    usable = np.flatnonzero(np.isfinite(log.poses).all(axis=1) & np.isfinite(log.odometry).all(axis=1))
    if not len(usable):
        raise TooLittleDataError("log: no scan has both a reference pose and odometry")
    return int(usable[0]), PoseBelief.around(log.poses[usable[0]], **spread)
