"""Whether the motion noise, the updates and the number of particles suit the robot."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from beamfield.calibration.odometry.windows import update_scans
from beamfield.errors import FormatError, TooLittleDataError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.motion import OdometryMotion
from beamfield.stacks.doctor.subject import Subject
from beamfield.stacks.files.filter_file import FilterSettings, read_filter_settings

# Of the variances that the log shows to those that the file says. Noise four times too large costs little, but five
# times too small it loses robots.
NARROW, WIDE = 4.0, 0.1
ANY_STEP = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
# Noise that is wider than the way itself loses robots with good weights, too: with alphas of 1, 2 and 5, 1, 6 and 9 of
# 15 runs in three maps; with 0.5, none.
METRE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
# Beyond this the log does not show how much too wide the noise is.
MOST_TIMES = 20.0
# Of the way of differential drives on record at most 6% is sideways, in steps of so many metres or radians; shorter
# ones show the odometry's noise while the robot stands.
SIDEWAYS, STEP = 0.2, (0.2, 0.2)
# A robot that turns on the spot goes nowhere: less way than this, metres, is noise.
LEAST_WAY = 1.0
# A robot drives and turns so far between updates at most, metres and radians, with the programs' usual values.
FAR, FAR_TURN = 1.0, math.radians(60.0)
# With 100 particles nav2's default model errs 1.2 to 3.8 times as much as with 500 (benchmarks/particle_counts.py).
FEW_PARTICLES = 200


def motion_noise(subject: Subject) -> Iterator[Finding]:
    """Compare the motion model's noise with what the log's odometry shows, at the filter's own updates."""
    from beamfield.calibration.odometry.learning import calibrate_odometry
    from beamfield.calibration.odometry.noise_fit import fit_levels
    from beamfield.calibration.odometry.result import OdometryOptions

    settings, log = _settings(subject), subject.log
    if settings is None or log is None or not (log.has_odometry and log.has_poses):
        return
    convert, formula = _conversion(subject, settings), _formula(settings)
    if convert is None or formula is None:
        return
    min_distance, min_turn = settings.update_distances
    try:
        learned = calibrate_odometry(
            settings.at_ticks(log), OdometryOptions(update_min_d=min_distance, update_min_a=min_turn)
        )
    except TooLittleDataError:
        return
    windows, kept = learned.windows, learned.is_noise
    unit = windows.covariance(formula)[kept]
    if not unit.any():
        return
    level = float(fit_levels(windows.residuals[kept], windows.reference[kept], unit[None])[0])
    advised = convert(learned)
    values = ", ".join(f"{subject.file.name_in_file(name)} = {value:g}" for name, value in advised.items())
    do = f"try {values} in beamfield evaluate, or let beamfield calibrate --stack choose by replay"
    own = subject.file.name_in_file(next(iter(advised)))
    safe = _formula(replace(settings, motion=replace(settings.motion, **advised)))
    # The least that is safe may be more, where steps are short and the formula's noise grows with their square.
    if level < WIDE and safe is not None and _size(windows.covariance(safe)[kept]) < _size(unit):
        times = min(1.0 / math.sqrt(level), MOST_TIMES)
        more = " or more" if times == MOST_TIMES else ""
        of_a_metre = float(np.trace(formula.step(METRE).covariance()[:2, :2]))
        yield subject.finding(
            "motion-noise-wide", "warning" if of_a_metre > 1.0 else "info",
            f"the motion noise is {times:.0f} times{more} as wide as this log's odometry errs (standard deviations)",
            "particles are spread by more than the scans gather again: less accurate, and lost where places look alike",
            do, own=own, values={"times": times, **advised},
        )  # fmt: skip
    elif level > NARROW:
        times = math.sqrt(level)
        yield subject.finding(
            "motion-noise-narrow", "warning",
            f"this log's odometry errs {times:.1f} times as much as the motion noise says (standard deviations)",
            "no particle goes where the robot went: the filter loses it after a slip or a turn",
            do, own=own, values={"times": times, **advised},
        )  # fmt: skip


def _size(covariances: FloatArray) -> float:
    """Return the sum of all variances of covariances (w, 3, 3)."""
    return float(np.trace(covariances.sum(axis=0)))


def no_motion_noise(subject: Subject) -> Iterator[Finding]:
    """Find a motion model without any noise."""
    settings = _settings(subject)
    formula = None if settings is None else _formula(settings)
    if formula is not None and not formula.step(ANY_STEP).covariance().any():
        own = next((name for name in subject.file.section.entries if "alpha" in name), "alpha1")
        yield subject.finding(
            "no-motion-noise", "warning", f"{own} and the others of the motion model are 0",
            "all particles move alike: after the first update no scan can correct the odometry",
            "give the motion model some noise: beamfield calibrate --odometry-noise says how much", own=own,
        )  # fmt: skip


def sideways_motion(subject: Subject) -> Iterator[Finding]:
    """Find a robot that moves sideways, with a motion model that turns it there and back instead."""
    settings, log = _settings(subject), subject.log
    if settings is None or log is None or not isinstance(_formula(settings), DifferentialMotion):
        return
    places = log.odometry[update_scans(log.odometry, *STEP)]
    step = between(places[:-1], places[1:])
    way = float(np.hypot(step[:, 0], step[:, 1]).sum())
    # Beside the heading halfway: along an arc a robot goes straight ahead.
    beside = np.cos(0.5 * step[:, 2]) * step[:, 1] - np.sin(0.5 * step[:, 2]) * step[:, 0]
    share = float(np.abs(beside).sum()) / way if way >= LEAST_WAY else 0.0
    if share > SIDEWAYS:
        own = subject.file.name_in_file(subject.stack.motion_key)
        other = next(name for name in subject.stack.motions if "omni" in name.lower())
        yield subject.finding(
            "moves-sideways", "warning",
            f"{share:.0%} of the way is sideways, and {own} is {getattr(settings.motion, subject.stack.motion_key)}",
            "each step sideways counts as a turn by 90 degrees and one back, with as much noise of the heading: the "
            "particles are torn apart",
            f"set {own} to {other}; of a robot that cannot move sideways, turn the frame so that x points ahead",
            own=own, values={"share": share},
        )  # fmt: skip


def updates_and_particles(subject: Subject) -> Iterator[Finding]:
    """Find updates that are far apart, fewer particles at most than at least, and too few."""
    settings = _settings(subject)
    if settings is None:
        return
    distance, turn = settings.update_distances
    for name, value, most, text in (
        ("update_min_d", distance, FAR, f"{distance:g} m"),
        ("update_min_a", turn, FAR_TURN, f"{math.degrees(turn):.0f} degrees"),
    ):
        if value > most:
            own = subject.file.name_in_file(name)
            yield subject.finding(
                "updates-far-apart", "warning", f"{own} is {text}: scans in between are not used",
                "the odometry's error grows unseen from one update to the next, and with it the cloud",
                "the usual values are 0.2 m and 10 to 30 degrees", own=own, values={name: value},
            )  # fmt: skip
    least, most_ = (getattr(settings.particles, name, None) for name in ("min_particles", "max_particles"))
    if least is not None and most_ is not None and most_ < least:
        own = subject.file.name_in_file("max_particles")
        yield subject.finding(
            "particles-reversed", "warning", f"{own} is {most_}, fewer than min_particles, {least}",
            "the number of particles is then not what either says",
            "set max_particles to no less than min_particles", own=own,
            values={"min_particles": float(least), "max_particles": float(most_)},
        )  # fmt: skip
    if most_ is not None and most_ < FEW_PARTICLES and not subject.model.multiplies(settings.sensor):
        own = subject.file.name_in_file("max_particles")
        yield subject.finding(
            "few-particles", "warning", f"{own} is {most_}, with a sum over beams",
            "its weights hardly tell good particles from others, so that it takes many to follow the robot",
            "500 or more; or a product over beams and motion noise that fits, with which 100 do nearly as well as 2000 "
            "(docs/tune_amcl.md)", own=own, values={"max_particles": float(most_)},
        )  # fmt: skip


def random_poses(subject: Subject) -> Iterator[Finding]:
    """Find averages of weights, by which poses are drawn at random, whose ratio says nothing or is reversed."""
    settings = _settings(subject)
    if settings is None:
        return
    slow, fast = settings.recovery_rates
    values = {"recovery_alpha_slow": slow, "recovery_alpha_fast": fast}
    if fast > 0.0 and subject.stack.averages_scans and subject.model.multiplies(settings.sensor):
        own = subject.file.name_in_file("recovery_alpha_fast")
        yield subject.finding(
            "recovery-in-product", "warning",
            f"{own} is {fast:g}{'' if own in subject.file.of_filter.section.entries else ' by default'}, and "
            f"{settings.model} multiplies over beams",
            "such weights fall by powers of ten where the map is a little wrong: poses drawn at random replace the "
            "particles, though the robot is not lost",
            "set both rates to 0, and look for a robot that was carried elsewhere with beamfield localize --global",
            own=own, values=values,
        )  # fmt: skip
    elif slow > 0.0 and slow >= fast:
        # Of random poses there is a share of 1 - fast / slow, by the averages that these rates make.
        when = "when the weights have just risen" if slow > fast else "never"
        own = subject.file.name_in_file("recovery_alpha_slow")
        yield subject.finding(
            "recovery-reversed", "warning", f"{own} is {slow:g}, recovery_alpha_fast is {fast:g}",
            f"random poses, which are to find a lost robot again, are mixed in {when}, not when the weights fall",
            "set both to 0, or the slow rate to a hundredth of the fast one, 0.001 and 0.1 for example",
            own=own, values=values,
        )  # fmt: skip


def _settings(subject: Subject) -> FilterSettings | None:
    """Return what the file says about the filter; None if a value cannot be used or the filter is not emulated."""
    try:
        return read_filter_settings(subject.file)
    except FormatError:
        return None


def _formula(settings: FilterSettings) -> OdometryMotion | None:
    """Return the motion model that the program runs; None if its noise is not that of the step alone."""
    formula = getattr(settings.motion, "formula", settings.motion)
    return formula if isinstance(formula, OdometryMotion) else None


def _conversion(subject: Subject, settings: FilterSettings) -> Any:
    return subject.stack.motion_from(getattr(settings.motion, subject.stack.motion_key, None))
