"""What to know before using the values calibrated for another program's model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from beamfield.finding import Finding
from beamfield.report.replay_choice import despite_error
from beamfield.report.stack_result import StackResult
from beamfield.stacks.fit.fit import StackFit
from beamfield.stacks.fit.replay_choice import ReplayChoice
from beamfield.stacks.fit.replay_runs import HOLLOW
from beamfield.stacks.registry import STACKS, model_named

# A z_hit below this share of z_rand looks like a mistake to people.
SMALL_Z_HIT = 0.1
# A filter that loses the robot in more of the runs does not localize it, whatever its mean error.
MANY_LOST = 0.1


def stack_findings(result: StackResult) -> list[Finding]:
    """Return what to know before using the values: coverage, odd numbers, choices at the end of what was tried."""
    fit = result.chosen
    about_trial = () if result.trial is fit.before else _about_search(fit)
    z_hit = small_z_hit(fit.model.stack, fit.model.model, result.parameters)
    return [
        *_about_lost_runs(result),
        *_about_places(result),
        *_about_model(result),
        *other_motion(result),
        *_about_map(result),
        *_about_recovery(result),
        *z_hit,
        *_about_coverage(result),
        *about_trial,
    ]


def _about_lost_runs(result: StackResult) -> Iterator[Finding]:
    if result.replay is None:
        return
    better = result.replay.is_better
    trials = result.replay.trials_finalist if better else result.replay.trials_before
    n_lost, n = sum(one.n_lost for one in trials), sum(map(len, trials))
    if n_lost > MANY_LOST * n:
        values = "with the new values, too" if better else "and no values tried are better for sure"
        yield Finding(
            "stack-still-lost",
            "warning",
            f"The filter loses the robot in {n_lost} of {n} runs, {values}.",
            {"lost": n_lost, "runs": n},
            why="Values mend neither a map that shows too little of what is there, nor odometry that slips, nor a "
            "sensor that sees too little.",
            do="Look at the other warnings first. Map the place anew where beamfield check says that it has changed, "
            "then calibrate again.",
        )


def _about_places(result: StackResult) -> Iterator[Finding]:
    if result.replay is not None and result.is_from_few_places:
        n = len(result.replay.trials_before)
        yield Finding(
            "stack-few-stretches",
            "warning",
            f"The log is short: the values were judged on {n} stretches.",
            {"stretches": n},
            why="The interval of the difference covers chance in the filter, not other places.",
            do="Compare old and new values on another drive (beamfield evaluate) before you rely on them.",
        )


def _about_model(result: StackResult) -> Iterator[Finding]:
    if result.replay is None:
        return
    model, before = result.chosen.model.model, result.replay.before.filter.model
    if before != model:
        sensor = result.replay.parts["sensor"]
        yield Finding(
            "stack-other-model",
            "info",
            f"The filter does better with {model} than with {before}, {_which(result.replay)}: its position error was "
            f"{sensor.after:.3f} m, not {sensor.before:.3f} m{despite_error(result.replay, 'sensor')}.",
            why=f"{before} computes {model_named(result.chosen.model.stack, before).weight.text}, {model} "
            f"{model_named(result.chosen.model.stack, model).weight.text}: one scan then says more.",
            do=f"If your robot has to find itself from anywhere, try that, too: {before} forgives more there, and "
            f"--model {before} keeps it.",
        )


def _which(replay: ReplayChoice) -> str:
    return "which it ran before" if replay.before.filter.path is not None else "its default"


def other_motion(result: StackResult) -> Iterator[Finding]:
    """Yield the explanation of a motion model that the user did not have, also where the robot cannot move so."""
    key = STACKS[result.chosen.model.stack].motion_key
    if result.replay is not None and key in result.motion:
        motion = result.replay.parts["motion"]
        before = getattr(result.replay.before.filter.motion, key)
        yield Finding(
            "stack-other-motion",
            "info",
            f"The filter does better with {key} = {result.motion[key]} than with {before}, {_which(result.replay)}, "
            f"also if the robot cannot move sideways: its position error was {motion.after:.3f} m, with the motion "
            f"noise as before {motion.before:.3f} m{despite_error(result.replay, 'motion')}.",
            why="Where walls are drawn a little off, the pose that fits lies beside the odometry's. Particles get "
            "there by noise across the way driven, of which this model has its own (alpha5); the other has to turn.",
            do="Leave it: the robot's controller and its odometry stay as they are. --odometry-noise keeps the model.",
        )


def _about_map(result: StackResult) -> Iterator[Finding]:
    if result.replay is None or not result.replay.chosen.changes_map:
        return
    replay, stack = result.replay, result.chosen.model.stack
    key = replay.chosen.key
    what, why = [], []
    if key.solids == HOLLOW:
        what.append("unknown where it is painted black far from what is free")
        why.append(f"{stack}'s field is as high inside of solids as on a wall: poses fit whose readings end there."
                   + _error_without(replay, "solids", "black inside"))  # fmt: skip
    if key.origin:
        what.append(f"with its origin moved by {key.origin:g} m")
        why.append(f"{stack} reads maps half a cell off." + _error_without(replay, "origin", "at its own origin"))
    if not replay.parts.keys() & {"solids", "origin"}:
        why.append("The file says that its values were chosen for it: all were replayed with it (--keep-map: yours).")
    yield Finding(
        "stack-map",
        "info",
        f"The values go with amcl_map.yaml, your map {', and '.join(what)}.",
        {"shift_m": key.origin, "hollow": float(key.solids == HOLLOW)},
        why=" ".join(why),
        do="Let a second map_server publish it on a topic that amcl alone takes; all else needs your map as it is.",
    )


def _error_without(replay: ReplayChoice, part: str, how: str) -> str:
    if (error := replay.parts.get(part)) is None:
        return ""
    return (
        f" In the replay the position error was {error.before:.3f} m with the map {how}, {error.after:.3f} m with this"
        f"{despite_error(replay, part)}."
    )


def _about_recovery(result: StackResult) -> Iterator[Finding]:
    if result.replay is not None and (values := result.recovery):
        recovery = result.replay.parts["recovery"]
        yield Finding(
            "stack-recovery",
            "info",
            f"No poses are drawn at random any more: {', '.join(f'{name} = 0' for name in values)}.",
            values,
            why="They can replace particles that are right, above all where the map is a little wrong. In the replay "
            f"the position error was {recovery.before:.3f} m with them, {recovery.after:.3f} m without"
            f"{despite_error(result.replay, 'recovery')}.",
            do="A robot that is carried elsewhere then needs an initial pose: beamfield localize --global looks "
            "for it. Where your robot is carried often and never lost otherwise, keep your rates.",
        )


def small_z_hit(stack: str, model: str, parameters: Any) -> Iterator[Finding]:
    """Yield the explanation of a z_hit that looks wrong, if it is that small."""
    described = model_named(stack, model)
    z_hit, z_rand = (described.value(parameters, name) for name in ("z_hit", "z_rand"))
    hit, rand = map(described.own_name, ("z_hit", "z_rand"))
    if described.multiplies(parameters) and z_hit and z_rand and z_hit <= SMALL_Z_HIT * z_rand:
        yield Finding(
            "stack-small-z-hit",
            "info",
            f"{hit} = {z_hit:.2g} is intended: it does not say that so few readings hit the map.",
            {"z_hit": z_hit},
            why=f"{model} multiplies over beams as if they erred independently. A beam that fits raises a weight by "
            f"{hit} range_max / {rand}, so that a small {hit} is the only way to count each beam for less.",
            do=f"Leave it, and change {hit} and {rand} together only.",
        )


def _about_coverage(result: StackResult) -> Iterator[Finding]:
    coverage = result.trial.held_out.coverage
    if not result.covers:
        yield Finding(
            "stack-coverage",
            "warning",
            f"Only {coverage:.0%} of the held-out windows have the truth in their 95% region.",
            {"coverage": coverage},
            why="The weights are still too sure here: a filter may drop the right pose.",
            do="Look at the warnings about map and reference poses first; else calibrate with a longer log.",
        )


def _about_search(fit: StackFit) -> Iterator[Finding]:
    if len(fit.trials) > 1 and fit.chosen.setting == fit.trials[-1].setting:
        setting = ", ".join(f"{name} = {value}" for name, value in fit.chosen.setting.items())
        yield Finding(
            "stack-most-beams",
            "info",
            f"{setting} is the setting with the most beams that was tried.",
            why="More beams may do better still, but cost time in every update.",
            do="Check that your computer keeps up with this many beams; fewer lose what the report's figure shows.",
        )
    if fit.at_edge:
        yield Finding(
            "stack-at-edge",
            "info",
            f"At the end of what is searched: {', '.join(fit.at_edge)}.",
            why="The best value on this log may lie beyond. The search is bounded because no log shows all that a "
            "robot will meet.",
            do="Use the values; they hold for places and crowds like those of this log.",
        )
