"""What a ring of sonars measures among walls that mirror sound: echoes, pulses that get lost, cross-talk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, checked
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, compose
from beamfield.kernels import acoustics as kernels
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder
from beamfield.simulation.surfaces import Surfaces, surfaces_of_grid

Progress = Callable[[int, int], None]

SPEED_OF_SOUND = 343.0  # m/s, in air of 20 degrees Celsius
RAY_STEP = np.radians(1.0)
# Scans per call of the kernel: keeps memory small and progress alive.
SCANS_PER_CHUNK = 64
# A pulse is followed to so many times the way there and back at max_range: beyond, it is too faint for any sensor.
FAINT = 1.5


class EchoCause(IntEnum):
    """Why a reading is what it is."""

    DIRECT = 0
    """The echo of a wall that is square to the cone somewhere, or of a round thing."""
    CORNER = 1
    """The echo of an inner corner, which sends sound back where it came from."""
    EDGE = 2
    """The weak echo of an edge."""
    DIFFUSE = 3
    """Sound scattered by a rough surface: from the nearest point in the cone."""
    SECOND = 4
    """A pulse that was mirrored away and came back over other walls: too long."""
    LOST = 5
    """No return although there is something in the cone: the pulse was mirrored away, or its echo was too faint."""
    NOTHING = 6
    """No return because there is nothing in the cone before max_range."""
    CROSS_TALK = 7
    """Another sensor's pulse."""
    OBJECT = 8
    """A person or thing that is not in the map."""
    PHANTOM = 9
    """Electrical noise taken for an echo."""


@dataclass(frozen=True)
class SonarPhysics:
    """How sound is sent, reflected and heard. The shares are probabilities, drawn anew for each reading.

    Parameters
    ----------
    roughness
        Share of pulses that surfaces scatter in all directions, so that the nearest point in the cone is heard. 0:
        everything is a mirror; 1: the range is always that of the nearest thing in the cone, as `SonarModel` expects.
    corner_echo, edge_echo
        Shares of inner corners and of edges that are heard.
    second_echo
        Share of echoes over two or three mirrors that are loud enough to be heard.
    dropout
        Share of readings in which a sensor misses its own echoes, all of them.
    sigma, sigma_slope
        Standard deviation of the range: sqrt(sigma^2 + (sigma_slope z)^2), metres.
    cross_talk
        Share of another sensor's echoes that a sensor takes for its own.
    firing_groups
        Sensor k fires in group k modulo this number; a group fires at once. None: one sensor after the other.
    firing_interval
        Time from one group to the next, seconds. All groups have fired once per scan, and begin anew at once.
    objects, object_rate
        Share of readings in front of which an unexpected object may stand, and the rate of the exponential
        distribution of its distance, 1/metre. It is seen if it is nearer than everything else.
    phantoms
        Share of readings that are uniform over [0, max_range), whatever is there.

    Raises
    ------
    InvalidInputError
        If a share is outside [0, 1], or another number negative, zero where it may not be, or not finite.

    Examples
    --------
    >>> SonarPhysics(roughness=0.1, phantoms=0.0).corner_echo
    0.9
    """

    roughness: float = 0.3
    corner_echo: float = 0.9
    edge_echo: float = 0.2
    second_echo: float = 0.7
    dropout: float = 0.01
    sigma: float = 0.02
    sigma_slope: float = 0.005
    cross_talk: float = 0.3
    firing_groups: int | None = 4
    firing_interval: float = 0.01
    objects: float = 0.0
    object_rate: float = 0.5
    phantoms: float = 0.005

    def __post_init__(self) -> None:
        check_fields(self)
        positive = ("object_rate", "firing_interval")
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name == "firing_groups":
                if value is not None and not (isinstance(value, int) and value >= 1):
                    raise InvalidInputError(f"firing_groups: expected a whole number >= 1 or None, got {value!r}")
            elif item.name in (*positive, "sigma", "sigma_slope"):
                if not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and item.name not in positive))):
                    raise InvalidInputError(f"{item.name}: expected a positive finite number, got {value}")
            elif not 0.0 <= value <= 1.0:
                raise InvalidInputError(f"{item.name}: expected a share in [0, 1], got {value}")

    @classmethod
    def diffuse(cls, *, sigma: float = 0.05, **changes: float) -> SonarPhysics:
        """Return a world of rough walls and without cross-talk, in which the assumptions of `SonarModel` hold.

        With `dropout` d and `phantoms` p the mixture then is z_hit = (1 - d)(1 - p), z_max = d (1 - p), z_rand = p, and
        sigma_hit = `sigma`.

        Parameters
        ----------
        sigma
            Standard deviation of the range, metres.
        **changes
            Other fields, such as `dropout` and `phantoms`, which are 0 here.

        Returns
        -------
        Physics with roughness 1.

        Raises
        ------
        InvalidInputError
            As for the class.

        Examples
        --------
        >>> SonarPhysics.diffuse(dropout=0.05).cross_talk
        0.0
        """
        plain: dict[str, float] = {"dropout": 0.0, "cross_talk": 0.0, "phantoms": 0.0, "sigma_slope": 0.0}
        return cls(roughness=1.0, sigma=sigma, **{**plain, **changes})  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class SonarReadings:
    """What a ring measures, and why.

    Parameters
    ----------
    ranges
        (t, k) metres in the conventions of `Scan`: +inf for no return, -inf for too close.
    causes
        (t, k) an `EchoCause` each.
    nearest
        (t, k) the exact distance to the nearest thing in the cone, at most max_range: what the model expects.
    """

    ranges: FloatArray
    causes: NDArray[np.int8]
    nearest: FloatArray


def sonar_ring(
    n_sensors: int,
    *,
    radius: float = 0.2,
    opening_angle: float = np.radians(30.0),
    max_range: float = 5.0,
    min_range: float = 0.0,
    first_bearing: float = 0.0,
    name: str = "sonar",
) -> RangeFinder:
    """Return a ring of sonars on the robot's rim, evenly spaced, looking outwards.

    Parameters
    ----------
    n_sensors
        How many; rings of real robots have 8, 16 or 24.
    radius
        Of the rim, metres.
    opening_angle
        Full width of each cone, radians.
    max_range, min_range
        Limits of each sensor, metres.
    first_bearing
        Where the first sensor looks, radians; the others follow counter-clockwise.
    name
        Of the sensor.

    Returns
    -------
    A finder with `n_sensors` beams that are cones.

    Raises
    ------
    InvalidInputError
        If the number is not positive, the radius negative, or a limit is out of range.

    Examples
    --------
    >>> sonar_ring(4, radius=0.2).mounts.round(3).tolist()[1]
    [0.0, 0.2, 1.571]
    """
    if n_sensors < 1:
        raise InvalidInputError(f"n_sensors: expected at least 1, got {n_sensors}")
    if not 0.0 <= radius < np.inf:
        raise InvalidInputError(f"radius: expected a finite number of metres >= 0, got {radius}")
    bearings = first_bearing + np.arange(n_sensors) * (2.0 * np.pi / n_sensors)
    turned = np.column_stack([np.zeros((n_sensors, 2)), bearings])
    mounts = compose(turned, [radius, 0.0, 0.0])
    return RangeFinder(mounts, max_range, min_range=min_range, opening_angle=opening_angle, name=name)


@checked
def simulate_sonar(
    world: Surfaces | OccupancyGrid,
    poses: ArrayLike,
    ring: RangeFinder,
    physics: SonarPhysics | None = None,
    rng: np.random.Generator | None = None,
    *,
    progress: Progress | None = None,
) -> SonarReadings:
    """Return what a ring of sonars measures.

    A smooth wall is a mirror for sound: it is heard only where the perpendicular on it lies in the cone, which is where
    the angle between the cone's axis and the perpendicular is at most half the opening angle (Figure 6.1b). Otherwise
    the pulse goes on in the mirrored direction, and comes back late over other walls, or not at all. Inner corners send
    sound back, edges little of it, rough surfaces everywhere. A sensor reports the first echo it hears, be it its own
    or another's.

    Parameters
    ----------
    world
        The walls, or a map of which the walls are found (see `surfaces_of_grid`).
    poses
        (t, 3) robot poses, metres and radians.
    ring
        The sensors; all have the finder's opening angle.
    physics
        How sound is reflected; None: smooth walls with some roughness.
    rng
        Source of randomness; None: a generator with seed 0.
    progress
        Called with (done, total) scans.

    Returns
    -------
    SonarReadings
        Ranges, their true causes, and the distances that a cone model expects.

    Raises
    ------
    InvalidInputError
        If the poses are not finite (t, 3), or the map has no occupied cell.

    Notes
    -----
    Ways of sound are exact for straight walls: lengths are those of lines to mirror images. Sound is mirrored at most
    three times, at the third time by the first wall again, and the pairs of walls are found by rays one degree apart,
    so that walls narrower than that are missed as second mirrors. A ring's sensors are heard among each other by
    mirrors, edges and scattering in the same way. If sensor j fires t_j, k at t_k, and the way from j over walls to k
    is L long, then k takes it for a range of (L + c (t_j - t_k)) / 2, with c the speed of sound.

    Not modelled: strength of sound over distance and angle, multiple sound speeds, the robot's motion within a scan,
    and walls that are not upright.

    References
    ----------
    Probabilistic Robotics, section 6.1, Figure 6.1; 6.3.1, failures and random measurements.

    Examples
    --------
    >>> room = Surfaces.from_outlines([[[0, 0], [6, 0], [6, 4], [0, 4]]])
    >>> smooth = SonarPhysics(roughness=0.0, sigma=0.0, sigma_slope=0.0, dropout=0.0, cross_talk=0.0, phantoms=0.0)
    >>> readings = simulate_sonar(room, [[2.0, 1.5, 0.0]], sonar_ring(4, radius=0.0), smooth)
    >>> readings.ranges.tolist()
    [[4.0, 2.5, 2.0, 1.5]]
    """
    robots = as_poses(poses)
    if robots.ndim != 2:
        raise InvalidInputError(f"poses: expected shape (t, 3), got {robots.shape}")
    walls = (surfaces_of_grid(world) if isinstance(world, OccupancyGrid) else world).walls()
    physics = physics or SonarPhysics()
    rng = rng or np.random.default_rng(0)
    shape = (len(robots), ring.n_beams)
    ranges, causes, nearest = np.empty(shape), np.empty(shape, np.int8), np.empty(shape)
    for first in range(0, len(robots), SCANS_PER_CHUNK):
        part = slice(first, min(first + SCANS_PER_CHUNK, len(robots)))
        ways = _ways(compose(robots[part, None], ring.mounts), ring, walls, physics)
        nearest[part] = np.minimum(0.5 * _own(ways)[..., kernels.DIFFUSE], ring.max_range)
        ranges[part], causes[part] = _readings(ways, nearest[part], ring, physics, rng)
        if progress is not None:
            progress(part.stop, len(robots))
    return SonarReadings(ranges, causes, nearest)


def _ways(sensors: FloatArray, ring: RangeFinder, walls: kernels.Walls, physics: SonarPhysics) -> FloatArray:
    """Return (t, from k, to k, kind) lengths of the shortest ways of sound, inf where there is none."""
    n_rays = 1 + int(np.ceil(ring.opening_angle / RAY_STEP))
    pulse = kernels.Pulse(
        0.5 * ring.opening_angle, FAINT * 2.0 * ring.max_range, n_rays, bool(physics.cross_talk > 0.0)
    )
    k = ring.n_beams
    ways: FloatArray = np.full((len(sensors), k, k, kernels.N_WAYS), np.inf)
    run_in_blocks(
        lambda start, stop: kernels.find_ways(sensors[start:stop], walls, pulse, ways[start:stop]),
        len(sensors), work_per_row=50 * k * n_rays,
    )  # fmt: skip
    return ways


def _own(ways: FloatArray) -> FloatArray:
    """Return the ways (t, k, kind) that begin and end at the same sensor."""
    sensor = np.arange(ways.shape[1])
    return np.asarray(ways[:, sensor, sensor])


def _readings(
    ways: FloatArray, nearest: FloatArray, ring: RangeFinder, physics: SonarPhysics, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.int8]]:
    """Draw which ways are heard; return the first echo of each sensor and its cause."""
    shares = np.empty(kernels.N_WAYS)
    shares[[kernels.MIRROR, kernels.CORNER, kernels.EDGE, kernels.SECOND, kernels.DIFFUSE]] = (
        1.0, physics.corner_echo, physics.edge_echo, physics.second_echo, physics.roughness,
    )  # fmt: skip
    heard = rng.random(ways.shape) < shares
    arrivals = np.where(heard, 0.5 * ways, np.inf)
    own = _own(arrivals).copy()
    own[rng.random(own.shape[:2]) < physics.dropout] = np.inf
    kind = np.argmin(own, axis=-1)
    z = np.take_along_axis(own, kind[..., None], axis=-1)[..., 0]
    cause = _CAUSE_OF_WAY[kind]
    others = _cross_talk(arrivals, physics, ring.min_range, rng)
    cause, z = np.where(others < z, EchoCause.CROSS_TALK, cause), np.minimum(z, others)
    away = rng.exponential(1.0 / physics.object_rate, z.shape)
    away[rng.random(z.shape) >= physics.objects] = np.inf
    cause, z = np.where(away < z, EchoCause.OBJECT, cause), np.minimum(z, away)
    z = z + np.hypot(physics.sigma, physics.sigma_slope * np.where(np.isfinite(z), z, 0.0)) * rng.standard_normal(
        z.shape
    )
    phantom = rng.random(z.shape) < physics.phantoms
    anywhere = rng.uniform(0.0, ring.max_range, z.shape)
    cause, z = np.where(phantom, EchoCause.PHANTOM, cause), np.where(phantom, anywhere, z)
    silent = z >= ring.max_range
    # An echo that noise alone puts beyond the limit is lost, too.
    cause = np.where(silent, np.where(nearest < ring.max_range, EchoCause.LOST, EchoCause.NOTHING), cause)
    z = np.where(silent, np.inf, np.where(z < ring.min_range, -np.inf, z))
    return z, cause.astype(np.int8)


_CAUSE_OF_WAY = np.empty(kernels.N_WAYS, np.int8)
_CAUSE_OF_WAY[[kernels.MIRROR, kernels.CORNER, kernels.EDGE, kernels.SECOND, kernels.DIFFUSE]] = (
    EchoCause.DIRECT, EchoCause.CORNER, EchoCause.EDGE, EchoCause.SECOND, EchoCause.DIFFUSE,
)  # fmt: skip


def _cross_talk(arrivals: FloatArray, physics: SonarPhysics, min_range: float, rng: np.random.Generator) -> FloatArray:
    """Return (t, k) the first range that each sensor would report of the others' pulses; inf for none."""
    k = arrivals.shape[1]
    if physics.cross_talk == 0.0 or k == 1:
        return np.full(arrivals.shape[:2], np.inf)
    groups = physics.firing_groups or k
    fired = np.arange(k) % groups * physics.firing_interval
    late = 0.5 * SPEED_OF_SOUND * (fired[:, None] - fired[None, :])
    cycle = 0.5 * SPEED_OF_SOUND * groups * physics.firing_interval
    first = arrivals.min(axis=-1)
    # Pulses of this round and of the one before; each is taken for one's own or not.
    seen = np.stack([first + late, first + late - cycle])
    taken = rng.random(seen.shape) < physics.cross_talk
    taken &= ~np.eye(k, dtype=bool)
    # What arrives before, or right after, a sensor fires is not listened to.
    seen[~taken | (seen <= min_range)] = np.inf
    return np.asarray(seen.min(axis=(0, 2)))
