"""The emulated nav2 does what nav2's own code did on the same logs; all of it: benchmarks/replay_oracle.py."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.replay_oracle import emulate, p_values, read_inputs, read_oracle

pytestmark = [pytest.mark.oracle, pytest.mark.real]


@pytest.mark.parametrize(("name", "log", "runs"), [("prob_fit1", "wean5", 6), ("lf_default", "wean5", 4)])
def test_errors_and_spread_are_distributed_as_the_programs(shared, name, log, runs):
    run = next(run for run in read_oracle(shared) if (run["set"], run["log"]) == (name, log))
    ours, theirs = emulate(run, *read_inputs(shared, log), range(runs)), run["columns"]
    assert (ours.column("updates") == theirs["updates"][0]).all()
    # What hardly varies between runs agrees closely, what does not is not told apart from the program's runs.
    for measure, other in (("particles", "particles"), ("sd_position", "sd_pos")):
        spread = theirs[other].std() / np.sqrt(runs)
        assert ours.mean(measure) == pytest.approx(theirs[other].mean(), rel=0.02, abs=4.0 * spread)
    assert ours.mean("mean") == pytest.approx(theirs["mean"].mean(), abs=4.0 * theirs["mean"].std() / np.sqrt(runs))
    assert min(p_values(ours, theirs).values()) > 1e-3
