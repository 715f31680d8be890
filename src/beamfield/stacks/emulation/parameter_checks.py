"""Checks of stacks' parameters and emulators' options: accepted is what a program accepts and can compute with."""

from __future__ import annotations

from typing import Any

import numpy as np

from beamfield.errors import InvalidInputError

# What the driver of a robot may report for a missing return.
NO_RETURNS = ("inf", "range_max")


def check_numbers(
    parameters: Any,
    *,
    at_least_zero: tuple[str, ...] = (),
    positive: tuple[str, ...] = (),
    finite: tuple[str, ...] = (),
) -> None:
    """Convert the named fields of a frozen dataclass, in its `__post_init__`, to floats; raise if one is not valid.

    All must be finite, in the first two groups of the sign named.
    """
    for name in (*at_least_zero, *positive, *finite):
        value = getattr(parameters, name)
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise InvalidInputError(f"{name}: expected a finite number, got {value!r}")
        if (name in at_least_zero and value < 0) or (name in positive and value <= 0):
            kind = "positive number" if name in positive else "number >= 0"
            raise InvalidInputError(f"{name}: expected a {kind}, got {value!r}")
        object.__setattr__(parameters, name, float(value))


def check_counts(parameters: Any, **least: int) -> None:
    """Convert the named fields to integers; raise if one is not an integer or below the given bound."""
    for name, bound in least.items():
        value = getattr(parameters, name)
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < bound:
            raise InvalidInputError(f"{name}: expected an integer >= {bound}, got {value!r}")
        object.__setattr__(parameters, name, int(value))


def check_switches(parameters: Any, *names: str) -> None:
    """Raise if one of the named fields is not True or False."""
    for name in names:
        if not isinstance(getattr(parameters, name), bool):
            raise InvalidInputError(f"{name}: expected True or False, got {getattr(parameters, name)!r}")


def check_choice(parameters: Any, name: str, known: tuple[str, ...]) -> None:
    """Raise if the named field is not one of the known names."""
    if getattr(parameters, name) not in known:
        choices = ", ".join(map(repr, known))
        raise InvalidInputError(f"{name}: expected one of {choices}, got {getattr(parameters, name)!r}")
