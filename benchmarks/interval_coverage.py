"""How often the 95% intervals of learned beam models hold the truth, on simulated logs of 1 to 20 minutes.

A laser drives through a room; its readings are drawn from known parameters, four ways:

- independent: every reading on its own
- near, far: errors that resemble those of neighbouring beams and scans (4 degrees and 1 s, 8 degrees and 3 s)
- bursts: near, and people who walk by for 5 s every 30 s on average, when shorts are ten times as frequent as otherwise

As in `calibrate`, every third block of time is held out and the rest is learned from. Common causes: three sensors take
turns; rare causes, in logs of up to 300 s: weights down to 0.0002 and 0, of which a log often has no reading at all.

Run: python benchmarks/interval_coverage.py [LOGS [SECONDS ...]]     (201 logs a row, of 60, 120, 300 and 1200 s)
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from beamfield.calibration.intrinsic.block_intervals import block_intervals
from beamfield.calibration.intrinsic.climb import climb
from beamfield.calibration.intrinsic.learning_problem import learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, parameters_of, theta_of
from beamfield.calibration.time_split import held_out_mask
from beamfield.geometry import FloatArray
from beamfield.kernels.threads import set_threads
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import beams_from_uniforms
from beamfield.simulation.dependence import Dependence, dependent_uniforms
from tables import print_table

DURATIONS_S = (60.0, 120.0, 300.0, 1200.0)
NAMES = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
COMMON = (
    BeamParameters(0.80, 0.08, 0.05, 0.07, 0.05, 0.5),
    BeamParameters(0.62, 0.15, 0.08, 0.15, 0.12, 0.9),
    BeamParameters(0.955, 0.02, 0.005, 0.02, 0.03, 0.3),
)
RARE = (
    BeamParameters(0.985, 0.004, 0.001, 0.01, 0.03, 0.5),
    BeamParameters(0.9793, 0.0005, 0.0002, 0.02, 0.05, 0.5),
    BeamParameters(0.9497, 0.05, 0.0, 0.0003, 0.03, 0.0),
)
NEAR = Dependence(np.radians(4.0), 1.0)
DEPENDENCE = {"independent": Dependence(), "near": NEAR, "far": Dependence(np.radians(8.0), 3.0), "bursts": NEAR}
MAX_RANGE, SCANS_PER_S = 10.0, 2.0
BEARINGS = np.radians(np.linspace(-135.0, 135.0, 60))
WIDTH, HEIGHT = 9.0, 6.0  # of the room, metres
BURST_S, QUIET_S = 5.0, 25.0
# Shorts in and between bursts, in units of their mean share.
IN_BURST, BETWEEN = 4.0, 0.4


def drive(duration: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return stamps (t,) and expected ranges (t, k) of a drive through the room."""
    t = np.arange(int(duration * SCANS_PER_S)) / SCANS_PER_S
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    x = WIDTH * (0.5 + 0.35 * np.sin(0.05 * t + phase[0]))[:, None]
    y = HEIGHT * (0.5 + 0.35 * np.sin(0.037 * t + phase[1]))[:, None]
    heading = phase[2] + 0.1 * t[:, None] + BEARINGS
    cos, sin = np.cos(heading), np.sin(heading)
    to_x = np.where(cos > 0.0, WIDTH - x, x) / np.abs(cos)
    to_y = np.where(sin > 0.0, HEIGHT - y, y) / np.abs(sin)
    return t, np.minimum(to_x, to_y)


def read(t: FloatArray, expected: FloatArray, truth: BeamParameters, kind: str, rng: np.random.Generator) -> FloatArray:
    """Return readings (t, k); whatever the kind, each alone has the distribution of the truth."""
    causes, places = (dependent_uniforms(t, BEARINGS, DEPENDENCE[kind], rng) for _ in range(2))
    if kind != "bursts":
        return beams_from_uniforms(causes, places, expected, MAX_RANGE, truth)
    busy, quiet = (
        beams_from_uniforms(causes, places, expected, MAX_RANGE, _with_shorts(truth, factor))
        for factor in (IN_BURST, BETWEEN)
    )
    return np.where(_in_burst(t, rng)[:, None], busy, quiet)


def _with_shorts(truth: BeamParameters, factor: float) -> BeamParameters:
    more = (factor - 1.0) * truth.z_short
    return replace(truth, z_hit=truth.z_hit - more, z_short=truth.z_short + more)


def _in_burst(t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(t,) whether people walk by: a Markov chain in its stationary state."""
    state = rng.random() < BURST_S / (BURST_S + QUIET_S)
    ends = [rng.exponential(BURST_S if state else QUIET_S)]
    states = [state]
    while ends[-1] <= t[-1]:
        states.append(not states[-1])
        ends.append(ends[-1] + rng.exponential(BURST_S if states[-1] else QUIET_S))
    return np.array(states)[np.searchsorted(ends, t, side="right")]


def one_log(duration: float, truth: BeamParameters, kind: str, rng: np.random.Generator) -> dict[str, FloatArray]:
    """Simulate, learn from two thirds of the blocks, and return the intervals by parameter."""
    t, expected = drive(duration, rng)
    ranges = read(t, expected, truth, kind, rng).ravel()
    stamps, expected = np.repeat(t, BEARINGS.size), expected.ravel()
    fitted = ~held_out_mask(stamps) & (expected < MAX_RANGE)
    beams = ranges[fitted], expected[fitted]
    # The maximum, from a start that is near it: several starts would only cost time.
    likelihood = IntrinsicLikelihood(*beams, MAX_RANGE)
    end = climb(likelihood, learning_problem(MAX_RANGE), theta_of(truth), tolerance=1e-10, max_iterations=200,
                em_steps_first=2)  # fmt: skip
    result = block_intervals(*beams, stamps[fitted], MAX_RANGE, parameters_of(end.theta))
    return {name: np.array(result.intervals[name]) for name in NAMES}


def row(duration: float, truths: tuple[BeamParameters, ...], kind: str, n_logs: int) -> tuple[dict[str, str], ...]:
    """Return shares of intervals that hold the truth, and their median widths, per parameter."""
    held, widths, open_ended = ({name: [] for name in NAMES} for _ in range(3))
    for i in range(n_logs):
        truth = truths[i % len(truths)]
        rng = np.random.default_rng([i, int(duration), list(DEPENDENCE).index(kind)])
        for name, (low, high) in one_log(duration, truth, kind, rng).items():
            open_ended[name].append(not np.isfinite(high))
            if np.isfinite(high):
                held[name].append(low <= getattr(truth, name) <= high)
                widths[name].append(high - low)
    head = {"log": f"{duration:g} s", "errors": kind}
    coverage = {name: _share(held[name]) for name in NAMES}
    every = [hit for name in NAMES for hit in held[name]]
    print(f"{head} {coverage}", file=sys.stderr, flush=True)
    undetermined = f"{100.0 * np.mean(open_ended['lambda_short']):.0f}"
    return (
        {**head, **coverage, "all six": f"{100.0 * np.mean(every):.1f}", "lambda not determined, %": undetermined},
        {**head, **{name: f"{np.median(widths[name]):.2g}" for name in NAMES}},
    )


def _share(hits: list[bool]) -> str:
    share = float(np.mean(hits))
    return f"{100.0 * share:.0f} ± {100.0 * np.sqrt(max(share * (1.0 - share), 0.25 / len(hits)) / len(hits)):.1f}"


def main() -> None:
    """Print both tables for common and for rare causes."""
    n_logs = int(sys.argv[1]) if len(sys.argv) > 1 else 201
    durations = [float(word) for word in sys.argv[2:]] or DURATIONS_S
    for name, truths, longest in (("Common causes", COMMON, np.inf), ("Rare causes", RARE, 300.0)):
        rows = [row(d, truths, kind, n_logs) for d in durations if d <= longest for kind in DEPENDENCE]
        if not rows:
            continue
        print(f"\n{name}: intervals that hold the truth, %, ± one standard error, {n_logs} logs a row\n")
        print_table([coverage for coverage, _ in rows])
        print(f"\n{name}: median width of the intervals\n")
        print_table([width for _, width in rows])


if __name__ == "__main__":
    set_threads(1)
    main()
