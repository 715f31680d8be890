"""Which kernels were compiled, and for which types: none should be compiled twice for what looks the same."""

from __future__ import annotations

import sys
from typing import Any

from numba.core.dispatcher import Dispatcher


def compiled_kernels() -> dict[str, list[Any]]:
    """Return the signatures of all kernels so far; nothing where the compiler is switched off."""
    modules = [module for name, module in sys.modules.items() if name.startswith("beamfield.kernels.")]
    return {
        f"{module.__name__}.{name}": list(kernel.signatures)
        for module in modules
        for name, kernel in vars(module).items()
        if isinstance(kernel, Dispatcher)
    }
