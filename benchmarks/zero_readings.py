"""How far readings of 0 among those of a sensor move lambda_short, in standard errors (docs/evidence/learning.md).

Run: python benchmarks/zero_readings.py
"""

from __future__ import annotations

import numpy as np

from beamfield.calibration.intrinsic.block_intervals import block_intervals
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.models.beam_parameters import BeamParameters
from interval_coverage import COMMON, MAX_RANGE, drive, read
from tables import print_table

SHARES = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
N_LOGS = 4


def shifts(duration: float, truth: BeamParameters, seed: int) -> list[float]:
    """Return how far each share of zeros moves lambda_short, in standard errors of the log without."""
    rng = np.random.default_rng(seed)
    t, expected = drive(duration, rng)
    ranges, z_star = read(t, expected, truth, "near", rng).ravel(), expected.ravel()
    without = learn_intrinsic_parameters(ranges, z_star, MAX_RANGE).parameters
    stamps = np.repeat(t, expected.shape[1])
    error = block_intervals(ranges, z_star, stamps, MAX_RANGE, without).standard_errors["lambda_short"]
    lot = np.random.default_rng(9).random(ranges.size)
    rates = [
        learn_intrinsic_parameters(np.where(lot < share, 0.0, ranges), z_star, MAX_RANGE).parameters.lambda_short
        for share in SHARES
    ]
    return [(rate - without.lambda_short) / error for rate in rates]


def main() -> None:
    """Print the table."""
    rows = []
    for duration in (120.0, 600.0):
        for truth in COMMON:
            mean = np.mean([shifts(duration, truth, seed) for seed in range(N_LOGS)], axis=0)
            head = {"log": f"{duration:g} s", "z_short, lambda_short": f"{truth.z_short:g}, {truth.lambda_short:g}"}
            rows.append(head | {f"{100 * share:g}%": f"{x:.2g}" for share, x in zip(SHARES, mean, strict=True)})
    print_table(rows)


if __name__ == "__main__":
    main()
