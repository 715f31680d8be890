"""The first run on a machine: a second process compiles kernels that the first will need later.

Numba compiles on one processor, and a process finds on the disk what another has compiled.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def compile_ahead() -> Iterator[None]:
    """Compile kernels of calibration in another process, if they are not on the disk and a processor is free for it."""
    if not _pays():
        yield
        return
    with subprocess.Popen(
        [sys.executable, "-P", "-m", __spec__.name],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    ) as other:  # fmt: skip
        try:
            yield
        finally:
            other.kill()


def _pays() -> bool:
    from beamfield.kernels.intrinsics import em_pass
    from beamfield.kernels.jit import is_on_disk
    from beamfield.kernels.processors import n_idle
    from beamfield.kernels.threads import n_threads

    return n_threads() > 1 and n_idle() > 0 and not is_on_disk(em_pass)


def compile_for_calibration() -> None:
    """Call kernels that take seconds to compile with next to nothing: those first that a run needs first.

    Which needs `em_pass` so soon that it may as well compile it: that comes last, for the demo, whose poses are fitted.
    """
    import numpy as np

    from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood
    from beamfield.kernels.many_beams import fill_scan_log_likelihood
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.models.beam_density import as_view, beam_log_density, read_only
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.models.field_parameters import LikelihoodFieldParameters
    from beamfield.models.likelihood_field import LikelihoodFieldModel
    from beamfield.sensors import RangeFinder, Scan

    ranges, theta = np.array([0.5, 1.0]), np.array([0.7, 0.1, 0.1, 0.1, 0.01, 0.0, 0.0, 1.0])
    likelihood = IntrinsicLikelihood(ranges, ranges, 2.0)
    likelihood.derivatives(theta)
    beams = BeamParameters(0.7, 0.1, 0.1, 0.1, sigma_hit=0.1, lambda_short=1.0)
    beam_log_density(ranges, ranges, 2.0, beams)
    fill_scan_log_likelihood(read_only(ranges), read_only(ranges[None]), as_view(beams, 2.0, 0.0), np.zeros(1))
    field = LikelihoodFieldModel(
        OccupancyGrid(np.eye(4, dtype=np.float32), 0.5), LikelihoodFieldParameters(0.8, 0.2, sigma_hit=0.1)
    )
    field.log_likelihood(Scan(ranges, RangeFinder.from_bearings([0.0, 1.0], 2.0)), [[0.5, 0.5, 0.0]])
    likelihood.expected_statistics(theta)


if __name__ == "__main__":
    compile_for_calibration()
