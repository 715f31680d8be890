"""A first run: what a second process compiles is what the run needs, and it ends with the run."""

import subprocess
import sys

import pytest

from beamfield.cli import compile_ahead
from beamfield.kernels.threads import set_threads

# In a process of its own: others may have called the kernels with other types.
SAME_TYPES = """
import numpy as np, beamfield as bf
from beamfield.cli.compile_ahead import compile_for_calibration
from beamfield.kernels import distance, field, intrinsics, many_beams
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log

kernels = [distance.fill_metres, field.fill_range_sums, intrinsics.em_pass, intrinsics.newton_pass,
           many_beams.fill_log_density, many_beams.fill_scan_log_likelihood]
compile_for_calibration()
ahead = [list(kernel.signatures) for kernel in kernels]
assert all(ahead), ahead
grid = draw_floor_plan()
laser = bf.RangeFinder.from_bearings(np.linspace(-1.5, 1.5, 24), 8.0)
truth = bf.BeamParameters(0.8, 0.1, 0.05, 0.05, sigma_hit=0.05, lambda_short=0.5)
log = simulate_log(grid, laser, truth, duration=60.0, scan_rate=4.0).only_sensor()
bf.calibrate(log, grid)
bf.learn_field_parameters(log, grid)
bf.BeamModel(grid, truth).log_likelihood(log[0], log.poses[:1])
assert [list(kernel.signatures) for kernel in kernels] == ahead
"""


def test_a_second_process_compiles_what_a_calibration_calls() -> None:
    done = subprocess.run([sys.executable, "-c", SAME_TYPES], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_second_process_ends_with_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[str]] = []

    class Started(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *_: object, **__: object) -> None:
            super().__init__([sys.executable, "-c", "import time; time.sleep(60)"])
            started.append(self)

    monkeypatch.setattr("subprocess.Popen", Started)
    monkeypatch.setattr(compile_ahead, "_pays", lambda: True)
    with compile_ahead.compile_ahead():
        assert started[0].poll() is None
    assert started[0].poll() is not None


def test_one_thread_compiles_alone() -> None:
    with set_threads(1):
        assert not compile_ahead._pays()
