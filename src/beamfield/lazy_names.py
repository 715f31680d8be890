"""Names that a package offers and loads when they are first used (PEP 562)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_names(
    package: str, names: Mapping[str, tuple[str, ...]], modules: tuple[str, ...] = ()
) -> tuple[list[str], Callable[[str], object], Callable[[], list[str]]]:
    """Return what a package calls ``__all__``, ``__getattr__`` and ``__dir__``.

    Names are by the module within the package that holds them; modules are offered themselves.
    """
    homes = {name: module for module, held in names.items() for name in held}
    offered = [*homes, *modules]

    def load(name: str) -> object:
        if name in modules:
            return import_module(f"{package}.{name}")
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{homes[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return offered, load, lambda: sorted(sys.modules[package].__all__)
