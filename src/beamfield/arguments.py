"""Arguments of the wrong type: refused with the argument's name, what was expected, and what was given.

`checked` costs next to nothing where a call succeeds: only when one fails with an error that is not ours are its
arguments held against the annotations. `check_fields` does so at once for the fields of a dataclass, which would
otherwise keep what does not belong there until it is used.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from functools import cache, wraps
from numbers import Integral
from typing import Any, TypeVar, cast, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.argument_kinds import advice, described, expect, expect_each, is_array_of_numbers, kind_of
from beamfield.errors import BeamfieldError, InvalidInputError

F = TypeVar("F", bound=Callable[..., Any])

# Beyond these, squares and quotients of metres overflow or vanish, and densities with them.
SMALLEST, LARGEST = 1e-12, 1e9


def checked(function: F) -> F:
    """Let a function name an argument of the wrong type instead of failing somewhere inside.

    Parameters
    ----------
    function
        Annotated; a method counts from its second argument on.

    Returns
    -------
    The function. Where a call of it fails and an argument does not fit its annotation, the error is an
    InvalidInputError that says so, with the first error as its cause.

    Examples
    --------
    >>> @checked
    ... def half(distance: float) -> float:
    ...     return distance / 2
    >>> half("far")
    Traceback (most recent call last):
    beamfield.errors.InvalidInputError: distance: expected a number, got the text 'far'
    """

    @wraps(function)
    def named(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except BeamfieldError:
            raise
        except Exception as error:  # compiled code has its own for arguments of the wrong type
            _blame(function, args, kwargs, error)
            raise

    return cast(F, named)


def check_fields(instance: Any) -> None:
    """Raise InvalidInputError if a field of a dataclass, in its `__post_init__`, does not match its annotation."""
    for name, default, hint, test in _checks(instance.__class__):
        value = getattr(instance, name, default)
        if value is not default and not test(value):
            expect(name, value, hint)


def as_floats(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return numbers as float64, or say that they are none.

    Returns
    -------
    The numbers in their shape; no copy of an array of doubles.

    Raises
    ------
    InvalidInputError
        If they are not numbers, or rows of different lengths.

    Examples
    --------
    >>> as_floats([1, 2.5], "ranges").tolist()
    [1.0, 2.5]
    >>> as_floats([1, None], "ranges")
    Traceback (most recent call last):
    beamfield.errors.InvalidInputError: ranges: expected an array of numbers, got the list [1, None]
    """
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values
    if not is_array_of_numbers(values):
        raise InvalidInputError(
            f"{name}: expected an array of numbers, got {described(values)}{advice(ArrayLike, values)}"
        )
    return np.asarray(values, dtype=np.float64)


def as_writeable(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an array as kernels take it, writeable and in C order: any other would have them compiled anew."""
    return values if values.flags.carray else np.require(values, requirements=["C", "A", "W"])


def as_count(value: Any, name: str, *, least: int, most: int | None = None) -> int:
    """Return a whole number, or say why it is none that will do.

    Raises
    ------
    InvalidInputError
        If it is not a whole number or beyond a bound.

    Examples
    --------
    >>> as_count(2.5, "n_beams", least=1)
    Traceback (most recent call last):
    beamfield.errors.InvalidInputError: n_beams: expected a whole number, got 2.5
    """
    if not isinstance(value, Integral):
        raise InvalidInputError(f"{name}: expected a whole number, got {described(value)}")
    count = int(value)
    if count < least or (most is not None and count > most):
        bounds = f"at least {least}" if most is None else f"{least} to {most}"
        raise InvalidInputError(f"{name}: expected {bounds}, got {count}")
    return count


def as_generator(rng: np.random.Generator | int | None) -> np.random.Generator:
    """Return a source of randomness: one, a seed of at least 0, or None for other numbers each time."""
    if rng is None or isinstance(rng, np.random.Generator):
        return np.random.default_rng(rng)
    if not isinstance(rng, Integral):
        raise InvalidInputError(f"rng: expected a Generator, a whole number or None, got {described(rng)}")
    return np.random.default_rng(as_count(rng, "rng", least=0))


def require(condition: object, name: str, expected: str, got: object) -> None:
    """Raise unless a condition holds: ``name: expected expected, got got``, a text in quotes."""
    if not condition:
        raise InvalidInputError(f"{name}: expected {expected}, got {repr(got) if isinstance(got, str) else got}")


def keep(instance: object, **values: object) -> None:
    """Set fields of a frozen dataclass, in its `__post_init__`; arrays become read-only."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(instance, name, value)


def restore(instance: object, state: dict[str, Any]) -> None:
    """Set the fields of a frozen dataclass that is unpickled or copied; arrays become read-only, as `keep` made them.

    NumPy brings them back writeable, which to the compiler is another type: kernels would be compiled anew.
    """
    keep(instance, **state)


def check_magnitude(name: str, sigma: float) -> None:
    """Refuse a standard deviation whose density cannot be computed: it has to be from 1e-12 to 1e9."""
    require(SMALLEST <= sigma <= LARGEST, name, f"a positive number from {SMALLEST:g} to {LARGEST:g}", sigma)


def _blame(function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any], error: Exception) -> None:
    """Raise if an argument does not fit; do nothing if the call itself is wrong or all arguments fit."""
    try:
        given = inspect.signature(function).bind(*args, **kwargs).arguments
    except TypeError:
        return
    hints = _hints(function)
    for name, value in given.items():
        if name in hints:
            try:
                expect(name, value, hints[name])
                expect_each(name, value, hints[name])
            except InvalidInputError as named:
                raise named from error


@cache
def _checks(cls: type) -> tuple[tuple[str, Any, Any, Callable[[Any], bool]], ...]:
    """Return name, default, annotation and test of each field of a dataclass: found out once for a class."""
    hints = _hints(cls)
    return tuple((item.name, item.default, hints[item.name], kind_of(hints[item.name]).test) for item in fields(cls))


@cache
def _hints(annotated: Any) -> dict[str, Any]:
    return get_type_hints(annotated)
