"""Short drives through a log, with wrong poses beside the reference: what a model's weights are judged on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from beamfield.arguments import check_fields, check_magnitude, require
from beamfield.calibration.selection import SelectionOptions, apart, select_scans
from beamfield.calibration.time_split import FEWEST_BLOCKS, LONGEST_BLOCK_S, time_blocks
from beamfield.errors import TooLittleDataError
from beamfield.geometry import FloatArray, between, compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog

# Fewer windows than this on either side of the split are too little to fit or to judge.
FEWEST_WINDOWS = 5
HELD_OUT = 2
WINDOWS_PER_BLOCK = 2.5
# Guesses at truth and prior around each reference.
N_GUESSES = 20
# Prior probability that the robot is elsewhere on the map.
FAR_SHARE = 0.5
# A reference that is off by so many metres is off by a radian.
REFERENCE_LEVER = 4.0


@dataclass(frozen=True)
class WindowOptions:
    """How a log is cut into windows, and which poses compete in one.

    Parameters
    ----------
    scans
        Scans in a window. A filter's weights multiply over as many before its motion noise has blurred them, and errors
        of neighbouring scans go together: one scan alone would hide how over-confident a model is.
    travel, turn
        A filter's update: the next scan comes after so many metres or radians.
    windows
        At most so many windows in all.
    near, far
        Number of poses around the reference and elsewhere on the map that compete.
    spread, turn_spread
        The prior around the reference: standard deviations in metres (each axis) and radians.
    reference_error
        How wrong the reference poses themselves may be: standard deviation in metres (each axis), and by
        `REFERENCE_LEVER` in radians. No posterior pays that is surer of the reference than this: references often come
        from the same scans, so that agreement with them proves nothing below it.
    seed
        Of the poses.

    Raises
    ------
    InvalidInputError
        If a number makes no sense.
    """

    scans: int = 4
    travel: float = 0.25
    turn: float = 0.2
    windows: int = 90
    near: int = 400
    far: int = 100
    spread: float = 0.25
    turn_spread: float = 0.1
    reference_error: float = 0.04
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        for name, least in (("scans", 1), ("windows", 2), ("near", 2 * N_GUESSES), ("far", 0), ("seed", 0)):
            require(getattr(self, name) >= least, name, f"at least {least}", getattr(self, name))
        for name in ("spread", "turn_spread", "reference_error"):
            check_magnitude(name, getattr(self, name))
        for name in ("travel", "turn"):
            require(0.0 <= getattr(self, name) < np.inf, name, "a number >= 0", getattr(self, name))


@dataclass(frozen=True, eq=False)
class Rivals:
    """Poses around the reference, of all windows or one, with what makes sums over them integrals.

    There are c guesses at what is not known: where the truth lies, given the reference, and where a filter's prior is
    centred, given the truth.

    Parameters
    ----------
    offsets
        (n, 3) in the frame of the reference pose, metres and radians; the first c are the truths.
    volumes
        (n,) of each in an integral, m^2 rad.
    centres
        (c, 3) where priors are centred: off from the truth as far as their spread says.
    mass
        (c, n) weight of each pose in an integral over each prior; rows sum to 1.
    density
        (c, n) the prior's density, 1/(m^2 rad).
    far_density
        Density of poses elsewhere on the map, 1/(m^2 rad); 0 if there are none.
    """

    offsets: FloatArray
    volumes: FloatArray
    centres: FloatArray
    mass: FloatArray
    density: FloatArray
    far_density: float


@dataclass(frozen=True, eq=False)
class Window:
    """A few scans with competing trajectories.

    Parameters
    ----------
    scans
        (s,) indices into the log.
    near, far
        (s, n, 3) and (s, m, 3) robot poses in the map: each trajectory moves as the reference does.
    fold
        0 or 1: fitted to, in one of two parts that take turns in choosing settings; `HELD_OUT`: only judges the result.
    rivals
        What the near poses were made of.
    """

    scans: NDArray[np.int64]
    near: FloatArray
    far: FloatArray
    fold: int
    rivals: Rivals


def draw_rivals(options: WindowOptions, grid: OccupancyGrid) -> Rivals:
    """Draw poses around a reference at all scales, from half a centimetre to beyond the prior.

    A posterior may be centimetres wide: poses drawn from the prior alone would miss it, and its integral with them,
    which would reward sharpness without end. Here two thirds have log-uniform scales, the others reach as far as priors
    that are themselves off, and weights make up for it.
    """
    return _draw_rivals(options, grid, np.random.default_rng(options.seed))


def draw_rivals_of_each(options: WindowOptions, grid: OccupancyGrid) -> list[Rivals]:
    """Draw the poses around the reference anew for each of the windows.

    What windows have in common does not average out over them, and no interval from blocks of time knows of it: with
    the same guesses for all, exponents differed by 3 to 15% from seed to seed, with guesses of their own by 0.4 to 8%.
    """
    rng = np.random.default_rng(options.seed)
    return [_draw_rivals(options, grid, rng) for _ in range(options.windows)]


def _draw_rivals(options: WindowOptions, grid: OccupancyGrid, rng: np.random.Generator) -> Rivals:
    widths = np.array([options.spread, options.spread, options.turn_spread])
    error = reference_deviations(options.reference_error)
    truths = _normal_points(rng) * error
    scales = np.append(np.geomspace(0.005 / options.spread, 1.0, 16), np.full(8, 1.5))
    chosen = scales[rng.permutation(np.arange(options.near - N_GUESSES) % len(scales))]
    offsets = np.concatenate([truths, rng.standard_normal((len(chosen), 3)) * chosen[:, None] * widths])
    drawn = _density(offsets, scales[:, None, None] * widths).mean(axis=0)
    volumes = 1.0 / (N_GUESSES * _density(offsets, error) + len(chosen) * drawn)
    centres = truths + _normal_points(rng) * widths
    density = _density(offsets - centres[:, None], widths)
    mass = density * volumes
    area = int(grid.free.sum()) * grid.resolution**2
    return Rivals(
        offsets, volumes, centres, mass / mass.sum(axis=1, keepdims=True), density,
        1.0 / (2.0 * np.pi * area) if area > 0.0 else 0.0,
    )  # fmt: skip


def cut_windows(
    log: SensorLog, grid: OccupancyGrid, rivals: Rivals | Sequence[Rivals], options: WindowOptions,
    selection: SelectionOptions | None = None, block_s: float | None = None,
) -> list[Window]:  # fmt: skip
    """Cut a log into windows, spread over all of it; where the log is short they overlap.

    Poses elsewhere are drawn from the map's free cells; rivals are from `draw_rivals`, for all windows, or
    `draw_rivals_of_each`. The selection says which scans may be used, see `select_scans`. Blocks of time that are
    fitted or held out whole last block_s seconds, see `time_blocks`; None takes its default, or more if windows need
    it.

    InvalidInputError if the log has no reference poses on the map, TooLittleDataError if there are fewer than five
    windows in a part.
    """
    groups = _groups(log, grid, options, selection)
    blocks = time_blocks(log.stamps, _block_length(log, groups) if block_s is None else block_s)
    # A window across the border of two blocks would be fitted and held out at once.
    groups = [group for group in groups if blocks[group[0]] == blocks[group[-1]]]
    if len(groups) > options.windows:
        groups = [groups[i] for i in np.linspace(0, len(groups) - 1, options.windows).astype(np.int64)]
    rng = np.random.default_rng(options.seed + 1)
    free = np.argwhere(grid.free)
    each = [rivals] * len(groups) if isinstance(rivals, Rivals) else rivals
    windows = []
    for group, own in zip(groups, each, strict=False):
        motion = between(log.poses[group[0]], log.poses[group])[:, None]
        near = compose(compose(log.poses[group[0]], own.offsets)[None], motion)
        far = compose(_anywhere(grid, free, options.far, rng)[None], motion)
        # Every third block of time is held out, from the second on, as in `of_held_out`.
        windows.append(Window(group, near, far, (0, HELD_OUT, 1)[int(blocks[group[0]]) % 3], own))
    counts = [sum(window.fold == fold for window in windows) for fold in range(3)]
    if min(counts) < FEWEST_WINDOWS:
        raise TooLittleDataError(
            f"{log.finder.name or 'log'}: {counts[0]} and {counts[1]} windows of {options.scans} scans, "
            f"{options.travel:g} m or {options.turn:g} rad apart, to fit to and {counts[HELD_OUT]} to judge by; "
            f"need {FEWEST_WINDOWS} of each: a drive about {_times_as_long(min(counts)):.1f} times as long should do"
        )
    return windows


def _times_as_long(fewest: int) -> float:
    """Return how much longer a log should be whose poorest part has so few windows, in tenths, rounded up."""
    return math.ceil(10.0 * FEWEST_WINDOWS / max(fewest, 0.5)) / 10.0


def window_block_s(
    log: SensorLog, grid: OccupancyGrid, options: WindowOptions, selection: SelectionOptions | None
) -> float | None:
    """Return the length of blocks, seconds, that `cut_windows` takes if given none; None: that of `time_blocks`."""
    return _block_length(log, _groups(log, grid, options, selection))


def _groups(
    log: SensorLog, grid: OccupancyGrid, options: WindowOptions, selection: SelectionOptions | None
) -> list[NDArray[np.int64]]:
    """Return the scans of every window that there could be."""
    used = np.flatnonzero(select_scans(log, grid, selection).used)
    # Where a filter would update: so far from the last one.
    steps = used[apart(log.poses[used], options.travel, options.turn)]
    return [steps[i : i + options.scans] for i in range(len(steps) - options.scans + 1)]


def _block_length(log: SensorLog, groups: list[NDArray[np.int64]]) -> float | None:
    """Return a length of blocks that holds a few windows, if the default does not and the log is long enough."""
    if not groups:
        return None
    window = float(np.median([log.stamps[group[-1]] - log.stamps[group[0]] for group in groups]))
    duration = float(log.stamps[-1] - log.stamps[0])
    default = min(LONGEST_BLOCK_S, duration / FEWEST_BLOCKS)
    return max(default, min(WINDOWS_PER_BLOCK * window, duration / 6.0)) or None


def _anywhere(grid: OccupancyGrid, free: NDArray[np.int64], n: int, rng: np.random.Generator) -> FloatArray:
    """Draw poses with their position in one of the free cells (f, 2): row and column."""
    if n == 0 or len(free) == 0:
        return np.zeros((0, 3))
    within = (free[rng.integers(0, len(free), n), ::-1] + rng.random((n, 2))) * grid.resolution
    local = np.column_stack([within, rng.uniform(-np.pi, np.pi, n)])
    return compose(grid.origin, local)


def reference_deviations(reference_error: float) -> FloatArray:
    """Return the standard deviations (3,) of a reference pose, metres and radians, for that of each axis."""
    return np.array([reference_error, reference_error, reference_error / REFERENCE_LEVER])


def _normal_points(rng: np.random.Generator) -> FloatArray:
    """Return points (c, 3) of a normal distribution whose distances are its quantiles, one in twenty beyond 95%."""
    directions = rng.standard_normal((N_GUESSES, 3))
    # Every other one opposite to the last, so that they balance.
    directions[1::2] = -directions[::2]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # Quantiles of the chi distribution with 3 degrees of freedom; importing scipy.stats for them takes half a second.
    distances = np.sqrt(2.0 * gammaincinv(1.5, (np.arange(N_GUESSES) + 0.5) / N_GUESSES))
    # Pairs stay neighbours in distance; their order says nothing.
    pairs = rng.permutation(N_GUESSES // 2)
    return np.asarray((directions * distances[:, None]).reshape(-1, 2, 3)[pairs].reshape(-1, 3))


def _density(offsets: FloatArray, widths: FloatArray) -> FloatArray:
    """Return the normal density of offsets (..., 3) with standard deviations (..., 3)."""
    squares = np.square(offsets / widths).sum(axis=-1)
    return np.asarray(np.exp(-0.5 * squares) / np.prod(np.sqrt(2.0 * np.pi) * widths, axis=-1))
