"""Settings of a stack's motion noise that are worth a replay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from beamfield.calibration.odometry.learning import calibrate_odometry
from beamfield.calibration.odometry.result import OdometryCalibration, OdometryOptions
from beamfield.errors import TooLittleDataError
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.sensors import SensorLog
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.registry import STACKS

BEFORE, LEARNED = "before", "learned"
# Alphas 1 and 2, of rotations, and 3 and 4, of translations, in nav2's formula. Scans tell the heading best: where
# updates are close to each other noise there costs little, and particles stay as far apart as errors of the map and
# drift of the odometry ask for. How far the robot has come along a corridor no scan tells, and noise there is error.
ALPHAS = ((0.02, 0.02), (0.05, 0.05), (0.1, 0.1), (0.1, 0.02), (0.2, 0.02))
# Alphas 1 to 5 of an omni model, also for robots that cannot move sideways: where walls are drawn a little off, the
# pose that fits lies beside the odometry's, and a model that turns, drives and turns gets there by turning alone. ROS 1
# before Melodic has alphas 1 and 4 exchanged; these are alike.
OMNI_ALPHAS = ((0.02, 0.02, 0.02, 0.02, 0.02), (0.02, 0.02, 0.005, 0.02, 0.02))
# Noise four times too large costs little, but five times too small it loses robots. The floor of what is learned is a
# reserve of its own.
RESERVE = 2.0


class MotionCandidates(NamedTuple):
    """Values for the motion model's parameters."""

    by_name: dict[str, Mapping[str, float | str]]
    """By a name for people, the user's own (none to change) first."""
    safe: Mapping[str, float] | None
    """Twice what the log shows, or the floor where that is more: of settings that replay cannot tell apart, the one
    with about so much noise is best. None if the log does not show it."""


def motion_candidates(settings: FilterSettings, log: SensorLog, reference_error: float) -> MotionCandidates:
    """Return values that are worth a replay.

    Beside the user's own, they are those learned from the log, at the filter's own update distance, and `ALPHAS`. Where
    the stack's formula is not nav2's, values with the noise of such alphas at the same steps stand for them: of the
    lower one in formulas with a single level. Where the stack has an omni model, that one is tried with `OMNI_ALPHAS`,
    whatever the robot's is. There are no others if the log does not show the odometry's noise, or the motion model has
    none that could be set.
    """
    described = STACKS[settings.stack]
    own = getattr(settings.motion, described.motion_key, None)
    convert = described.motion_from(own)
    candidates: dict[str, Mapping[str, float | str]] = {BEFORE: {}}
    if convert is None:
        return MotionCandidates(candidates, None)
    min_distance, min_turn = settings.update_distances
    options = OdometryOptions(min_distance, min_turn, reference_error)
    try:
        learned = calibrate_odometry(settings.at_ticks(log), options)
    except TooLittleDataError:
        return MotionCandidates(candidates, None)
    candidates[LEARNED] = least = convert(learned)
    shown = convert(_without_floor(learned))
    safe = {name: max(value, RESERVE * shown[name]) for name, value in least.items()}
    for rotation, translation in ALPHAS:
        same = rotation == translation
        name = f"alpha {rotation:g}" if same else f"alphas {rotation:g} and {translation:g}"
        candidates[name] = convert(_with_alphas(learned, rotation, translation))
    if (omni := described.omni_motion.get(str(own))) is not None and (to_omni := described.motion_from(omni)):
        names = list(to_omni(learned))
        for alphas in OMNI_ALPHAS:
            same = len(set(alphas)) == 1
            name = f"omni {alphas[0]:g}" if same else f"omni {alphas[0]:g} and {alphas[2]:g}"
            candidates[name] = {described.motion_key: omni} | dict(zip(names, alphas, strict=True))
    return MotionCandidates(_without_repetition(candidates), safe)


def _without_floor(learned: OdometryCalibration) -> OdometryCalibration:
    model = learned.chosen.model
    assert isinstance(model, DifferentialMotion)
    return replace(learned, alphas=model, options=replace(learned.options, floor=0.0))


def _with_alphas(learned: OdometryCalibration, rotation: float, translation: float) -> OdometryCalibration:
    """Return the calibration with these alphas; in formulas that are fitted anew, with no less noise than the lower."""
    return replace(
        learned,
        alphas=DifferentialMotion(rotation, rotation, translation, translation),
        options=replace(learned.options, floor=min(rotation, translation)),
    )


def _without_repetition(
    candidates: Mapping[str, Mapping[str, float | str]],
) -> dict[str, Mapping[str, float | str]]:
    kept: dict[str, Mapping[str, float | str]] = {}
    for name, values in candidates.items():
        if values not in kept.values():
            kept[name] = values
    return kept
