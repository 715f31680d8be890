"""An entry from Python for kernels that have none."""

from __future__ import annotations

import numba


def entry(kernel):
    """Return a compiled function that does nothing but call the kernel."""
    return numba.njit(lambda *arguments: kernel(*arguments))
