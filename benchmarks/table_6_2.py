"""Compare Table 6.2 taken literally with exact EM, on beams drawn from the model (docs/evidence/learning.md).

Run: python benchmarks/table_6_2.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.calibration.intrinsic.climb import climb
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.calibration.intrinsic.learning_problem import learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, parameters_of, theta_of
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from reference import table_6_2

N_BEAMS = 100_000
N_ITERATIONS = 60
SEED = 62
# Truth, maximum range, interval of expected ranges.
CASES: dict[str, tuple[BeamParameters, float, tuple[float, float]]] = {
    "indoor": (BeamParameters(0.8, 0.1, 0.05, 0.05, 0.1, 0.5), 30.0, (0.3, 12.0)),
    "one wall at 3 m": (BeamParameters(0.65, 0.15, 0.05, 0.15, 0.15, 1.0), 5.0, (3.0, 3.0)),
    "walls near the limit": (BeamParameters(0.7, 0.1, 0.1, 0.1, 0.5, 0.5), 5.0, (4.0, 5.0)),
    "walls near the sensor": (BeamParameters(0.7, 0.1, 0.05, 0.15, 0.2, 2.0), 5.0, (0.1, 0.6)),
    "nearly uniform shorts": (BeamParameters(0.7, 0.2, 0.02, 0.08, 0.05, 0.05), 30.0, (0.3, 12.0)),
}


def run() -> list[dict[str, Any]]:
    """Return one row per case and way of learning; the table and exact EM start at the same shapes."""
    rows: list[dict[str, Any]] = []
    for name, (truth, max_range, (low, high)) in CASES.items():
        rng = np.random.default_rng(SEED)
        expected = rng.uniform(low, high, N_BEAMS)
        z = sample_beams(expected, max_range, truth, rng)
        thetas = table_6_2.learn_intrinsic_parameters(
            z, expected, max_range, 2.0 * truth.sigma_hit, 2.0 * truth.lambda_short, N_ITERATIONS
        )
        trace = [table_6_2.log_likelihood(z, expected, max_range, theta) for theta in thetas]
        start = BeamParameters(0.25, 0.25, 0.25, 0.25, 2.0 * truth.sigma_hit, 2.0 * truth.lambda_short)
        em = climb(
            IntrinsicLikelihood(z, expected, max_range),
            learning_problem(max_range),
            theta_of(start),
            tolerance=1e-30,
            max_iterations=N_ITERATIONS,
            accelerate=False,
        )
        exact = learn_intrinsic_parameters(z, expected, max_range)
        at_truth = float(beam_log_density(z, expected, max_range, truth).mean())
        rows += [
            row(name, "truth", truth, at_truth),
            row(name, "Table 6.2", BeamParameters(*thetas[-1]), trace[-1], trace),
            row(name, "exact EM", parameters_of(em.theta), em.objective, list(em.trace[1:])),
            row(name, "beamfield", exact.parameters, exact.log_likelihood),
        ]
    return rows


def row(
    case: str, way: str, p: BeamParameters, log_likelihood: float, trace: list[float] | None = None
) -> dict[str, Any]:
    return {"case": case, "way": way, "parameters": p, "log_likelihood": log_likelihood, "trace": trace or []}


def main() -> None:
    rows = run()
    print("| beams | | z_hit | z_short | z_max | z_rand | sigma_hit | lambda_short | log-likelihood, nats per beam |")
    print("|---|---|---|---|---|---|---|---|---|")
    for r in rows:
        p = r["parameters"]
        shares = " | ".join(f"{weight:.3f}" for weight in p.weights)
        print(
            f"| {r['case']} | {r['way']} | {shares} | {p.sigma_hit:.4f} | {p.lambda_short:.3f} | "
            f"{r['log_likelihood']:.5f} |"
        )
    print("\n| beams | | after 1 | 2 | 3 | 5 | 10 | 60 | largest fall in a step |")
    print("|---|---|---|---|---|---|---|---|---|")
    for r in rows:
        if r["trace"]:
            trace = r["trace"]
            fall = max(0.0, float(-np.diff(trace).min()))
            steps = " | ".join(f"{trace[min(k, len(trace)) - 1]:.5f}" for k in (1, 2, 3, 5, 10, N_ITERATIONS))
            print(f"| {r['case']} | {r['way']} | {steps} | {fall:.5f} |")


if __name__ == "__main__":
    main()
