"""Entries from Python for kernels that have none."""

from __future__ import annotations

import numba


def entry(kernel):
    """Return a compiled function that does nothing but call the kernel."""
    return numba.njit(lambda *arguments: kernel(*arguments))


class Entries:
    """The functions of a module of kernels, each with an entry."""

    def __init__(self, module) -> None:
        self._module = module

    def __getattr__(self, name):
        made = entry(getattr(self._module, name))
        setattr(self, name, made)
        return made
