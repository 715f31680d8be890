"""Choose a stack's parameters by what its own filter does with them: replay decides what windows propose."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from math import ceil, log, sqrt
from typing import Any

import numpy as np

from beamfield.calibration.odometry.windows import update_scans
from beamfield.localization.replay import ReplayErrors
from beamfield.localization.replay_comparison import FEWEST_SEEDS, ReplayComparison, ReplayTrials, compare_trials
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.fit.kept_runs import KeptRuns
from beamfield.stacks.fit.motion_candidates import BEFORE, MotionCandidates
from beamfield.stacks.fit.replay_segments import USUAL_DISTANCES, ReplaySegments
from beamfield.stacks.registry import model_named

Progress = Callable[[str, int, int], None]
# Names of the sensor's and the motion's values, and the shift of the origin, metres.
Key = tuple[str, str, float]

# A run that is farther off counts as so far, metres: lost runs count, but not how far they went.
FARTHEST = 1.0
# No reference is better than this, metres.
NEAREST = 0.001
# Seeds of the race's first round, how many settings come into the second, and how many motion noises into the last.
FIRST_SEEDS, KEPT, LAST = 2, 6, 3
# Motion noise of 0 is compared as this.
LEAST_NOISE = 1e-6
# An error counts this many times more than it is, per share of the updates that the particles' 95 % ellipse lacks of
# holding the reference in 90 %: 0.1 m with 70 % as 0.14 m. That much is missing by chance in a few dozen updates.
COVERAGE_PRICE = 2.0
COVERAGE = 0.9
# Settings that cost so little more than the best, relatively, are as good on a few stretches. Of them the one is taken
# whose motion noise is nearest to what is safe by the log.
AS_GOOD = 0.1


@dataclass(frozen=True)
class ReplayOptions:
    """How much is replayed.

    Parameters
    ----------
    runs
        Of each setting that comes into the last round, over stretches and seeds: at least so many.
    most_stretches, longest
        Stretches of the log, and updates of one, at most.
    seed
        The first seed.
    """

    runs: int = 60
    most_stretches: int = 12
    longest: int = 40
    seed: int = 0

    def seeds(self, n_stretches: int) -> int:
        """Return how many seeds make so many runs on these stretches, and not too few to be sure of anything."""
        return max(FEWEST_SEEDS, ceil(self.runs / n_stretches))


# By the model's kind: a cast ray costs some twenty times a look-up in a field.
OF_FIELDS = ReplayOptions()
OF_RAYS = ReplayOptions(runs=30, most_stretches=4, longest=12)
# Where a filter takes more scans than so many for each update of amcl, there are fewer runs, and shorter ones.
AFFORDABLE_SCANS = 2.0


def replay_options(settings: FilterSettings, log: SensorLog, seed: int) -> ReplayOptions:
    """Return how much a filter can afford on a log: fewer and shorter runs if updates are costly or many."""
    usual = OF_FIELDS if model_named(settings.stack, settings.model).weight.of_field else OF_RAYS
    less = max(1.0, sqrt(_scans_per_update(settings, log) / AFFORDABLE_SCANS))
    return replace(usual, runs=ceil(usual.runs / less), longest=ceil(usual.longest / less), seed=seed)


def _scans_per_update(settings: FilterSettings, log: SensorLog) -> float:
    """Return how many scans a filter takes where amcl takes one."""
    if settings.update_distances != (0.0, 0.0):
        return 1.0
    taken = settings.at_ticks(log).odometry
    return float(np.isfinite(taken).all(axis=1).sum() / max(1, len(update_scans(taken, *USUAL_DISTANCES))))


@dataclass(frozen=True, eq=False)
class ReplaySetting:
    """One setting of everything that is chosen.

    Parameters
    ----------
    sensor, motion
        Where its parameters come from: "before" for the user's.
    shift
        What is added to the map's x and y origin, metres.
    filter
        All parameters.
    """

    sensor: str
    motion: str
    shift: float
    filter: FilterSettings

    @property
    def key(self) -> Key:
        """What tells it from others."""
        return self.sensor, self.motion, self.shift


@dataclass(frozen=True, eq=False)
class ReplayChoice:
    """What replay decided.

    Parameters
    ----------
    before
        The user's setting.
    finalist
        The best on the stretches for choosing; the same if that was the user's.
    is_better
        Whether the finalist won: on the judging stretches its cost is surely lower, and neither its error nor the share
        of lost runs is surely higher.
    trials_before, trials_finalist
        Their runs on the judging stretches, paired.
    error
        Mean position error of a run, no more than 1 m: before and finalist.
    cost
        The same raised for missing coverage, as a natural logarithm: a difference of -0.1 is about 10 % less. Places
        where every setting is far off so count no more than others.
    parts
        By "sensor", "motion" or "origin", as far as the finalist differs in it: the error without and with it.
    n_settings, n_choosing
        How many settings were tried, and on how many stretches.
    """

    before: ReplaySetting
    finalist: ReplaySetting
    is_better: bool
    trials_before: tuple[ReplayTrials, ...]
    trials_finalist: tuple[ReplayTrials, ...]
    error: ReplayComparison
    cost: ReplayComparison
    parts: Mapping[str, ReplayComparison]
    n_settings: int
    n_choosing: int

    @property
    def chosen(self) -> ReplaySetting:
        """The setting to use."""
        return self.finalist if self.is_better else self.before

    @property
    def n_runs(self) -> int:
        """How many runs judged each."""
        return sum(map(len, self.trials_before))


def choose_by_replay(
    before: FilterSettings,
    sensors: Mapping[str, Any],
    motions: MotionCandidates,
    shift: float,
    segments: ReplaySegments,
    grid: OccupancyGrid,
    options: ReplayOptions | None = None,
    progress: Progress | None = None,
    kept: KeptRuns | None = None,
) -> ReplayChoice:
    """Choose sensor parameters, motion noise and the map's origin by replaying the stack's filter.

    All combinations of sensor and motion race on every other stretch of the log, with few seeds and then the best with
    more; all motion noises are compared with the best sensor's values. They race with the map's origin set right, where
    that is possible: that the program reads its map half a cell off is known, and only a surely greater error there
    speaks against it. What is left is judged against the user's on the other stretches, which had no part in the race.

    Parameters
    ----------
    before
        The user's filter.
    sensors
        Parameters of the measurement model by name, "before" for the user's.
    motions
        Parameters of the motion model.
    shift
        What sets the map's x and y origin right for the program, metres; 0 if it reads maps as they are.
    segments
        Stretches of the log.
    grid
        The map.
    options
        How many runs.
    progress
        Called with what is done, runs done and runs in all.
    kept
        Runs of an interrupted call with the same inputs; this one's are added.
    """
    options, kept = options or ReplayOptions(), kept or KeptRuns()
    settings = {
        (sensor, motion, shift): ReplaySetting(
            sensor, motion, shift,
            replace(before, sensor=sensors[sensor], motion=replace(before.motion, **motions.by_name[motion])),
        )
        for sensor, motion, shift in product(sensors, motions.by_name, {0.0, shift})
    }  # fmt: skip
    own = settings[BEFORE, BEFORE, 0.0]
    raced = [one for one in settings.values() if one.shift == shift or one is own]
    choosing = _Replays(segments.choosing, segments.names[0], grid, options, kept)
    safe = None if motions.safe is None else replace(before.motion, **motions.safe)
    best = _race(raced, choosing, safe, progress)
    finalist = _with_origin_or_without(best, settings[best.sensor, best.motion, 0.0], choosing)
    without = _without_each_part(settings, finalist)
    judging = _Replays(segments.judging, segments.names[1], grid, options, kept)
    judged = {one.key: one for one in (own, finalist, *without.values())}
    trials = judging.of(judged.values(), judging.n_seeds, "judging the choice", progress)
    before_, after = trials[own.key], trials[finalist.key]
    error, cost = _compared(before_, after, clipped), _compared(before_, after, costs)
    return ReplayChoice(
        before=own,
        finalist=finalist,
        is_better=cost.is_lower and not error.is_higher and not compare_trials(before_, after, "lost").is_higher,
        trials_before=tuple(before_),
        trials_finalist=tuple(after),
        error=error,
        cost=cost,
        parts={name: _compared(trials[rival.key], after, clipped) for name, rival in without.items()},
        n_settings=len(raced) + (best.shift > 0.0),
        n_choosing=len(segments.choosing),
    )


def shifted_map(grid: OccupancyGrid, shift: float) -> OccupancyGrid:
    """Return the map with another origin."""
    return replace(grid, origin=grid.origin + np.array([shift, shift, 0.0])) if shift else grid


def clipped(trials: ReplayTrials) -> ReplayTrials:
    """Return runs whose mean error is no more than 1 m."""
    return _counted(trials, lambda one: min(one.mean, FARTHEST))


def costs(trials: ReplayTrials) -> ReplayTrials:
    """Return runs with the logarithm of their error, no more than 1 m and raised for missing coverage, as the mean."""

    def cost(one: ReplayErrors) -> float:
        missing = max(0.0, COVERAGE - one.inside_noisy)
        return float(np.log(max(min(one.mean, FARTHEST), NEAREST) * (1.0 + COVERAGE_PRICE * missing)))

    return _counted(trials, cost)


def _counted(trials: ReplayTrials, count: Callable[[ReplayErrors], float]) -> ReplayTrials:
    return replace(trials, errors=tuple(replace(one, mean=count(one)) for one in trials.errors))


class _Replays:
    """Runs of settings on some stretches, none made twice."""

    def __init__(
        self,
        stretches: Sequence[SensorLog],
        names: Sequence[str],
        grid: OccupancyGrid,
        options: ReplayOptions,
        kept: KeptRuns,
    ) -> None:
        self._stretches, self._names, self._grid, self._first = stretches, names, grid, options.seed
        self._kept = kept
        self.n_seeds = options.seeds(len(stretches))
        self._runs: dict[Key, list[ReplayTrials]] = {}

    def of(
        self, settings: Iterable[ReplaySetting], n_seeds: int, stage: str = "", progress: Progress | None = None
    ) -> dict[Key, list[ReplayTrials]]:
        """Return the runs of settings with so many seeds on each stretch."""
        chosen = list(settings)
        for done, one in enumerate(chosen):
            if progress is not None and stage:
                progress(f"replay: {stage}", done, len(chosen))
            self._run(one, n_seeds)
        return {one.key: [_first_of(trials, n_seeds) for trials in self._runs[one.key]] for one in chosen}

    def _run(self, setting: ReplaySetting, n_seeds: int) -> None:
        """Run the seeds that are missing."""
        known = self._runs.get(setting.key, [])
        seeds = range(self._first + (len(known[0]) if known else 0), self._first + n_seeds)
        if not seeds:
            return
        replayed = setting.filter.filter(shifted_map(self._grid, setting.shift))
        new = [
            self._kept.of((name, setting.key, seeds), partial(run_trials, replayed, log, seeds, name=name))
            for log, name in zip(self._stretches, self._names, strict=True)
        ]
        self._runs[setting.key] = [_joined(*pair) for pair in zip(known, new, strict=True)] if known else new


def _first_of(trials: ReplayTrials, n: int) -> ReplayTrials:
    return replace(trials, seeds=trials.seeds[:n], errors=trials.errors[:n])


def _joined(one: ReplayTrials, other: ReplayTrials) -> ReplayTrials:
    return replace(one, seeds=one.seeds + other.seeds, errors=one.errors + other.errors)


def _race(settings: list[ReplaySetting], replays: _Replays, safe: Any, progress: Progress | None) -> ReplaySetting:
    """Return the best setting on the stretches for choosing; `safe` is a motion model, or None.

    Two rounds find the sensor's values; with those, all motion noises are compared, the best of them with all seeds.
    """
    some = max(FIRST_SEEDS + 1, replays.n_seeds // 3)

    def best_first(raced: Sequence[ReplaySetting], n_seeds: int, stage: str) -> dict[Key, float]:
        trials = replays.of(raced, n_seeds, stage, progress)
        cost = {key: float(np.mean([costs(one).mean("mean") for one in runs])) for key, runs in trials.items()}
        return dict(sorted(cost.items(), key=lambda item: item[1]))

    by_key = {one.key: one for one in settings}
    left = [by_key[key] for key in best_first(settings, FIRST_SEEDS, f"racing {len(settings)} settings")][:KEPT]
    sensor, _, shift = next(iter(best_first(left, some, f"racing the best {len(left)}")))
    left = [one for one in settings if (one.sensor, one.shift) == (sensor, shift)]
    left = [by_key[key] for key in best_first(left, some, "comparing motion noise")][:LAST]
    return _of_equals(left, best_first(left, replays.n_seeds, f"comparing the best {len(left)}"), safe)


def _of_equals(settings: Sequence[ReplaySetting], cost: Mapping[Key, float], safe: Any) -> ReplaySetting:
    """Return the best setting, or one about as good whose motion noise is nearer to the safe one, if known."""
    best = min(settings, key=lambda one: cost[one.key])
    if safe is None:
        return best
    as_good = [one for one in settings if cost[one.key] <= cost[best.key] + AS_GOOD]

    def apart(one: ReplaySetting) -> float:
        return abs(log(_noise(one.filter.motion) / _noise(safe)))

    return min(as_good, key=lambda one: (apart(one), cost[one.key]))


def _noise(motion: Any) -> float:
    """Return the sum of a motion model's numbers, but for the fifth alpha, which differential models do not have."""
    values = asdict(motion).items()
    numbers = [value for name, value in values if isinstance(value, float) and not name.endswith("5")]
    return max(LEAST_NOISE, sum(numbers))


def _with_origin_or_without(shifted: ReplaySetting, plain: ReplaySetting, replays: _Replays) -> ReplaySetting:
    """Return the setting with the map's origin set right, unless its error is surely higher."""
    if shifted is plain:
        return plain
    trials = replays.of((shifted, plain), replays.n_seeds)
    return plain if _compared(trials[plain.key], trials[shifted.key], clipped).is_higher else shifted


def _without_each_part(settings: Mapping[Key, ReplaySetting], finalist: ReplaySetting) -> dict[str, ReplaySetting]:
    """Return the finalist with each part as it was before, as far as it was changed."""
    sensor, motion, shift = finalist.key
    without = {
        "sensor": (BEFORE, motion, shift), "motion": (sensor, BEFORE, shift), "origin": (sensor, motion, 0.0),
    }  # fmt: skip
    return {name: settings[key] for name, key in without.items() if key != finalist.key}


def _compared(
    before: Sequence[ReplayTrials], after: Sequence[ReplayTrials], counted: Callable[[ReplayTrials], ReplayTrials]
) -> ReplayComparison:
    return compare_trials([counted(one) for one in before], [counted(one) for one in after])
