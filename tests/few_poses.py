"""Learn exponents and fields from few poses, where what is learned from them is not what is tested."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from unittest.mock import patch

from beamfield.calibration.context import exponent
from beamfield.calibration.field import learning
from beamfield.calibration.pose_windows import WindowOptions

FEW_POSES = partial(WindowOptions, windows=60, near=100, far=25)


@contextmanager
def few_poses() -> Iterator[None]:
    """Let fewer poses compete with the reference than users have: they take most of the time of a short calibration."""
    with patch.object(exponent, "WindowOptions", FEW_POSES), patch.object(learning, "WindowOptions", FEW_POSES):
        yield
