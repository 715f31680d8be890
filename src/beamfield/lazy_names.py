"""Names that a package offers and loads when they are first used (PEP 562)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_names(
    package: str,
    names: Mapping[str, tuple[str, ...]],
    modules: tuple[str, ...] = (),
    *,
    doors: tuple[str, ...] = (),
) -> tuple[list[str], Callable[[str], object], Callable[[], list[str]]]:
    """Return what a package calls ``__all__``, ``__getattr__`` and ``__dir__``.

    Names are by the module within the package that holds them; modules are offered themselves. Doors are other packages
    that offer names: the error about a name that is missing here says which of them has it.
    """
    homes = {name: module for module, held in names.items() for name in held}
    offered = [*homes, *modules]

    def load(name: str) -> object:
        if name in modules:
            return import_module(f"{package}.{name}")
        if name not in homes:
            elsewhere = [door for door in doors if name in import_module(door).__all__]
            hint = f"; it is {elsewhere[0]}.{name}" if elsewhere else ""
            # With the name and the module, Python adds which name was meant.
            raise AttributeError(
                f"module {package!r} has no attribute {name!r}{hint}", name=name, obj=sys.modules[package]
            )
        value = getattr(import_module(f"{package}.{homes[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return offered, load, lambda: sorted(sys.modules[package].__all__)
