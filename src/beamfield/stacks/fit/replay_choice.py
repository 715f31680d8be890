"""Choose a stack's parameters by what its own filter does with them: replay decides what windows propose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain, product, starmap
from math import log
from typing import Any

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.localization.replay_comparison import ReplayComparison, ReplayTrials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.fit.kept_runs import KeptRuns
from beamfield.stacks.fit.motion_candidates import BEFORE, MotionCandidates
from beamfield.stacks.fit.replay_amount import ReplayOptions
from beamfield.stacks.fit.replay_cost import clipped, compared, costs, costs_by_stretch, is_surely_better
from beamfield.stacks.fit.replay_runs import HOLLOW, Key, Progress, Replays, ReplaySetting
from beamfield.stacks.registry import STACKS, model_named

# Seeds of the race's first round, how many settings come into the second, and how many with the best sensor's values
# into the last; there the best with other values of the sensor runs as well.
FIRST_SEEDS, KEPT, LAST = 2, 6, 3
OFF = "off"
# In this order the user's values come back if others are not better for sure, but for what `_known` returns. That
# depends on the sensor's model, so that recovery comes last.
PARTS = ("motion", "sensor", "recovery")
# Motion noise of 0 is compared as this.
LEAST_NOISE = 1e-6
# Settings that cost so little more than the best, relatively, are as good on a few stretches. Of them the one is taken
# whose motion noise is nearest to what is safe by the log.
AS_GOOD = 0.1


@dataclass(frozen=True, eq=False)
class ReplayChoice:
    """What replay decided.

    Parameters
    ----------
    before
        The user's setting.
    finalist
        The best over all stretches; the same if that was the user's.
    is_better
        Whether the finalist won: its cost is surely lower, and its error lower or its coverage higher for sure; neither
        the error nor the share of lost runs is surely higher. It has the user's motion noise or sensor where neither
        cost nor error is surely lower with others, and the rest wins without.
    trials_before, trials_finalist
        Runs on each stretch, paired: of the user's setting, and of the one that the other stretches choose, mostly the
        finalist. No stretch judges what it has chosen.
    trials_without
        By the names of a `Key`, as far as the finalist differs in it: the finalist's runs without it.
    error
        Mean position error of a run, no more than 1 m: before and finalist.
    cost
        The same raised for missing coverage, as a natural logarithm: a difference of -0.1 is about 10% less. Places
        where every setting is far off so count no more than others.
    parts
        By the names of a `Key`, as far as the finalist differs in it: the error without and with it.
    n_settings
        How many settings were tried.
    moves_origin, hollows_solids
        Whether the map's origin, and the inside of its solids, were among what was chosen.
    """

    before: ReplaySetting
    finalist: ReplaySetting
    is_better: bool
    trials_before: tuple[ReplayTrials, ...]
    trials_finalist: tuple[ReplayTrials, ...]
    trials_without: Mapping[str, tuple[ReplayTrials, ...]]
    error: ReplayComparison
    cost: ReplayComparison
    parts: Mapping[str, ReplayComparison]
    n_settings: int
    moves_origin: bool = False
    hollows_solids: bool = False

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
    sensors: Mapping[str, tuple[str, Any]],
    motions: MotionCandidates,
    shift: float,
    stretches: Sequence[SensorLog],
    grid: OccupancyGrid,
    options: ReplayOptions | None = None,
    progress: Progress | None = None,
    kept: KeptRuns | None = None,
    *,
    hollow: bool = False,
    is_moved: bool = False,
) -> ReplayChoice:
    """Choose sensor parameters, motion noise, the filter's map and recovery by replaying the stack's filter.

    All combinations of sensor and motion race with few seeds, and then the best with more; all motion noises are
    compared with the best sensor's values. They race with the map's origin set right and its solids hollow, where
    that is possible, and without poses drawn at random: that the program reads its map half a cell off is known, and so
    is that its field is highest inside solids, and that weights of products do not tell a lost robot; only a surely
    greater error speaks against it. Of what is left the stretches of
    the log choose together, and keep the user's motion noise or sensor, and random poses in sums, if other values are
    not surely better. They judge crosswise: on each one the setting that the others choose runs against the user's. A
    few stretches disagree too much for half of them to choose and half to judge. If the choice is not better for sure,
    it is made once more without its sensor, or without those that only some stretches choose.

    Parameters
    ----------
    before
        The user's filter.
    sensors
        Measurement models and their parameters by name, "before" for the user's.
    motions
        Parameters of the motion model.
    shift
        What sets the map's x and y origin right for the program, metres; 0 if it reads maps as they are.
    stretches
        Of the log, two or more, from `cut_segments`.
    grid
        The map.
    options
        How many runs.
    progress
        Called with what is done, runs done and runs in all.
    kept
        Runs of an interrupted call with the same inputs; this one's are added.
    hollow
        Whether the map is painted black where nothing is known, and the filter's may be unknown there.
    is_moved
        Whether the user's filter reads a map that is set right already: then there is no choice.
    """
    options, kept = options or ReplayOptions(), kept or KeptRuns()
    recoveries = {BEFORE: before} | ({OFF: before.without_recovery()} if any(before.recovery_rates) else {})
    solid = HOLLOW if hollow else BEFORE
    origins, insides = (dict.fromkeys((right,) if is_moved else (plain, right))
                        for plain, right in ((0.0, shift), (BEFORE, solid)))  # fmt: skip
    settings = {}
    for key in starmap(Key, product(sensors, motions.by_name, origins, recoveries, insides)):
        model, sensor = sensors[key.sensor]
        motion = replace(before.motion, **motions.by_name[key.motion])
        values = replace(recoveries[key.recovery], model=model, sensor=sensor, motion=motion)
        settings[key] = ReplaySetting(key, values)
    its = Key(BEFORE, BEFORE, shift, BEFORE, solid) if is_moved else Key(BEFORE, BEFORE, 0.0, BEFORE)
    own, right = settings[its], (shift, [*recoveries][-1], solid)
    raced = [one for one in settings.values() if one.key[2:] == right or one is own]
    replays = Replays(stretches, grid, options.seeds(len(stretches)), options.seed, kept)
    safe = None if motions.safe is None else replace(before.motion, **motions.safe)
    last = _race(raced, replays, progress)
    by_stretch = costs_by_stretch(replays.of(last, replays.n_seeds, f"comparing the best {len(last)}", progress))

    def choose(asked: Sequence[int]) -> ReplaySetting:
        best = _of_equals(last, by_stretch[:, asked].mean(axis=1), safe)
        for part in PARTS:
            plain = settings[best.key._replace(**{part: getattr(its, part)})]
            if part not in _known(best) and plain is not best and not _is_surely_cheaper(best, plain, replays, asked):
                best = plain
        return best

    everywhere = range(len(stretches))
    best = finalist = choose(everywhere)
    tried = {one.key for one in raced}
    for part in _known(best):
        plain = settings[finalist.key._replace(**{part: getattr(its, part)})]
        tried.add(plain.key)
        finalist = _unless_surely_worse(finalist, plain, replays)
    crossed = [own] * len(stretches)
    if finalist is not own:
        known = {part: getattr(finalist.key, part) for part in _known(best)}
        choices = [choose([other for other in everywhere if other != i]) for i in everywhere]
        crossed = [one if one is own else settings[one.key._replace(**known)] for one in choices]

    def judge(finalist: ReplaySetting, crossed: Sequence[ReplaySetting]) -> ReplayChoice:
        without = _without_each_part(settings, its, finalist, crossed)
        judged = {one.key: one for one in (own, *crossed, *chain(*without.values()))}
        trials = replays.of(judged.values(), replays.n_seeds, "judging the choice", progress)

        def on_each(chosen: Sequence[ReplaySetting]) -> tuple[ReplayTrials, ...]:
            return tuple(trials[one.key][i] for i, one in enumerate(chosen))

        before_, after = tuple(trials[own.key]), on_each(crossed)
        without_parts = {name: on_each(rivals) for name, rivals in without.items()}
        return ReplayChoice(
            before=own,
            finalist=finalist,
            is_better=is_surely_better(before_, after),
            trials_before=before_,
            trials_finalist=after,
            trials_without=without_parts,
            error=compared(before_, after, clipped),
            cost=compared(before_, after, costs),
            parts={name: compared(rivals, after, clipped) for name, rivals in without_parts.items()},
            n_settings=len(tried),
            moves_origin=bool(shift) and not is_moved,
            hollows_solids=hollow and not is_moved,
        )

    choice = judge(finalist, crossed)
    for part in ("motion", "recovery"):
        # All stretches chose it; what the judgement does not confirm is chance.
        if part not in _known(choice.finalist) and choice.is_better and not _is_confirmed(choice, part):
            key, *keys = (one.key._replace(**{part: getattr(its, part)}) for one in (choice.finalist, *crossed))
            simpler = [settings[one] for one in keys]
            rest = judge(settings[key], simpler)
            choice, crossed = (rest, simpler) if rest.is_better else (choice, crossed)
    of_finalist = finalist.key.sensor
    others = {one.key.sensor for one in crossed} - {BEFORE} if of_finalist == BEFORE else {of_finalist}
    if not others or (choice.is_better and _is_confirmed(choice, "sensor")):
        return choice
    # What is not better for sure, as a sensor that loses a few robots, must not hide what is; nor must one that only
    # some of the stretches choose. Other values of the sensor go with other motion noise.
    fewer = {name: one for name, one in sensors.items() if name not in others}
    again = choose_by_replay(
        before, fewer, motions, shift, stretches, grid, options, progress, kept, hollow=hollow, is_moved=is_moved
    )
    return replace(again, n_settings=choice.n_settings) if again.is_better else choice


def _race(settings: list[ReplaySetting], replays: Replays, progress: Progress | None) -> list[ReplaySetting]:
    """Return the settings worth all seeds.

    Two rounds find the sensor's values; with those, all motion noises are compared. The best of them are returned, and
    the best with other values of the sensor.
    """
    some = max(FIRST_SEEDS + 1, replays.n_seeds // 3)

    def best_first(raced: Sequence[ReplaySetting], n_seeds: int, stage: str) -> list[ReplaySetting]:
        cost = costs_by_stretch(replays.of(raced, n_seeds, stage, progress)).mean(axis=1)
        return [raced[i] for i in np.argsort(cost, kind="stable")]

    left = best_first(settings, FIRST_SEEDS, f"racing {len(settings)} settings")[:KEPT]
    left = best_first(left, some, f"racing the best {len(left)}")
    best = left[0]
    others = [one for one in left if one.key.sensor != best.key.sensor][:1]
    left = [one for one in settings if one.key._replace(motion=best.key.motion) == best.key]
    return best_first(left, some, "comparing motion noise")[:LAST] + others


def _of_equals(settings: Sequence[ReplaySetting], cost: FloatArray, safe: Any) -> ReplaySetting:
    """Return the best setting by costs (n,), or one about as good whose motion noise is nearer to the safe one.

    One with the user's motion model comes first. Only settings with the same sensor are about as good: which sensor's
    values are best, noise does not tell.
    """
    best = settings[int(np.argmin(cost))]
    if safe is None:
        return best

    def apart(i: int) -> tuple[bool, float, float]:
        motion = settings[i].filter.motion
        return _kind(motion) != _kind(safe), abs(log(_noise(motion) / _noise(safe))), float(cost[i])

    sensor, most = best.key.sensor, cost.min() + AS_GOOD
    as_good = [i for i, one in enumerate(settings) if one.key.sensor == sensor and cost[i] <= most]
    return settings[min(as_good, key=apart)]


def _noise(motion: Any) -> float:
    """Return the sum of a motion model's numbers, but for the fifth alpha, which differential models do not have."""
    values = asdict(motion).items()
    numbers = [value for name, value in values if isinstance(value, float) and not name.endswith("5")]
    return max(LEAST_NOISE, sum(numbers))


def _kind(motion: Any) -> list[str]:
    """Return which motion model runs."""
    return [value for value in asdict(motion).values() if isinstance(value, str)]


def _is_surely_cheaper(one: ReplaySetting, other: ReplaySetting, replays: Replays, asked: Sequence[int]) -> bool:
    """Return whether a setting's cost on some stretches is lower than another's for sure."""
    trials = replays.of((one, other), replays.n_seeds)
    after, before = ([trials[which.key][i] for i in asked] for which in (one, other))
    return compared(before, after, costs).is_lower


def _known(setting: ReplaySetting) -> list[str]:
    """Return which parts need no proof, because it is known what the program does wrong there."""
    its = setting.filter
    is_misled = STACKS[its.stack].averages_scans and model_named(its.stack, its.model).multiplies(its.sensor)
    return ["origin", "solids", *(["recovery"] if is_misled else [])]


def _unless_surely_worse(corrected: ReplaySetting, plain: ReplaySetting, replays: Replays) -> ReplaySetting:
    """Return a setting with a part set right, or as it was if its error is surely higher."""
    if corrected is plain:
        return plain
    trials = replays.of((corrected, plain), replays.n_seeds)
    return plain if compared(trials[plain.key], trials[corrected.key], clipped).is_higher else corrected


def _without_each_part(
    settings: Mapping[Key, ReplaySetting], its: Key, finalist: ReplaySetting, crossed: Sequence[ReplaySetting]
) -> dict[str, list[ReplaySetting]]:
    """Return settings with each part as the user has it, as far as the finalist differs in it."""
    changed = [name for name in Key._fields if getattr(finalist.key, name) != getattr(its, name)]
    return {name: [settings[one.key._replace(**{name: getattr(its, name)})] for one in crossed] for name in changed}


def _is_confirmed(choice: ReplayChoice, part: str) -> bool:
    """Return whether the finalist's error or cost is surely lower with a part; true if it does not differ in it."""
    if part not in choice.parts:
        return True
    cost = compared(choice.trials_without[part], choice.trials_finalist, costs)
    return cost.is_lower or choice.parts[part].is_lower
