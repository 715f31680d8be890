"""Time learning: passes over beams, the whole fit, the intervals, and the peak memory of a fresh process.

Run: python benchmarks/learning.py [largest number of beams]
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from typing import Any

import numpy as np

from beamfield.calibration.intrinsic.block_intervals import block_intervals
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.calibration.intrinsic.learning_problem import learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, theta_of
from beamfield.calibration.intrinsic.m_steps import m_step
from beamfield.kernels.threads import set_threads
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from measure import median_seconds

MAX_RANGE = 30.0
TRUTH = BeamParameters(0.75, 0.12, 0.05, 0.08, 0.04, 0.2, 0.03, 0.01)
FORMS = {"chapter": {}, "offset and slope": {"fit_offset": True, "fit_sigma_slope": True}}
SIZES = (100_000, 1_000_000, 10_000_000)


def run(sizes: tuple[int, ...] = SIZES) -> list[dict[str, Any]]:
    """Return one row per number of beams and form of the model; each is measured in a process of its own."""
    rows = []
    for n in sizes:
        for form in FORMS:
            command = [sys.executable, __file__, "--one", str(n), form]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            rows.append(json.loads(done.stdout))
    return rows


def measure(n: int, form: str) -> dict[str, Any]:
    """Measure one case on one thread; the fit again on all."""
    options = FORMS[form]
    rng = np.random.default_rng(0)
    expected = np.minimum(rng.gamma(2.0, 2.5, n) + 0.2, 29.9)
    z = np.concatenate([sample_beams(part, MAX_RANGE, TRUTH, rng) for part in np.array_split(expected, 1 + n // 10**6)])
    # Compile before the clock runs.
    learn_intrinsic_parameters(z[:5000], expected[:5000], MAX_RANGE, **options)

    e_step, m_steps, newton = time_passes(z, expected, options)
    start = time.perf_counter()
    result = learn_intrinsic_parameters(z, expected, MAX_RANGE, **options)
    fit = time.perf_counter() - start
    start = time.perf_counter()
    with set_threads(None):
        learn_intrinsic_parameters(z, expected, MAX_RANGE, **options)
    fit_all = time.perf_counter() - start
    stamps = np.linspace(0.0, 1800.0, n)
    start = time.perf_counter()
    with set_threads(None):
        block_intervals(z, expected, stamps, MAX_RANGE, result.parameters, **options)
    return {
        "beams": n,
        "form": form,
        "em_ns": (e_step + m_steps) / n * 1e9,
        "m_ns": m_steps / n * 1e9,
        "newton_ns": newton / n * 1e9,
        "iterations": result.iterations,
        "fit_s": fit,
        "fit_all_s": fit_all,
        "intervals_s": time.perf_counter() - start,
        "input_mib": 2 * z.nbytes / 2**20,
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def time_passes(z: np.ndarray, expected: np.ndarray, options: dict[str, bool]) -> tuple[float, float, float]:
    """Seconds of an E-step, an M-step and a pass for Newton, on one thread."""
    likelihood = IntrinsicLikelihood(z, expected, MAX_RANGE)
    problem = learning_problem(MAX_RANGE, **options)
    theta = problem.apply(theta_of(TRUTH))
    slope = bool(options)
    statistics = likelihood.expected_statistics(theta, slope_is_free=slope)
    return (
        median_seconds(lambda: likelihood.expected_statistics(theta, slope_is_free=slope)),
        median_seconds(lambda: m_step(statistics, theta, problem)),
        median_seconds(lambda: likelihood.derivatives(theta)),
    )


def main(sizes: tuple[int, ...] = SIZES) -> None:
    print(
        "EM and Newton: median ns per beam and iteration, one thread, M-step included. Intervals: all\n"
        "processors. Peak memory: of the whole process, Python, Numba and the input included.\n"
    )
    print(
        "| beams | model | EM, ns | of it M-step | Newton, ns | iterations on all | fit, 1 thread | fit, all threads "
        "| intervals | input | peak memory |"
    )
    print("|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
    for r in run(sizes):
        print(
            f"| {r['beams']:,} | {r['form']} | {r['em_ns']:.1f} | {r['m_ns']:.1f} | {r['newton_ns']:.1f} "
            f"| {r['iterations']} | {r['fit_s']:.2f} s | {r['fit_all_s']:.2f} s | {r['intervals_s']:.2f} s "
            f"| {r['input_mib']:.0f} MiB | {r['peak_mib']:.0f} MiB |"
        )


if __name__ == "__main__":
    set_threads(1)
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(measure(int(sys.argv[2]), sys.argv[3])))
    elif len(sys.argv) > 1:
        main(tuple(size for size in SIZES if size <= float(sys.argv[1])))
    else:
        main()
