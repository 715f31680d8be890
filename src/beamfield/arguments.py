"""Arguments of the wrong type: refused with the argument's name, what was expected, and what was given.

`checked` costs next to nothing where a call succeeds: only when one fails with an error that is not ours are its
arguments held against the annotations. `check_fields` does so at once for the fields of a dataclass, which would
otherwise keep what does not belong there until it is used.
"""

from __future__ import annotations

import collections.abc
import inspect
import os
from collections.abc import Callable
from dataclasses import fields
from functools import cache, wraps
from numbers import Integral, Real
from types import UnionType
from typing import Any, Literal, NamedTuple, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.errors import BeamfieldError, InvalidInputError

F = TypeVar("F", bound=Callable[..., Any])

# What code raises that meets an argument of the wrong type.
_SYMPTOMS = (TypeError, ValueError, AttributeError, IndexError, KeyError, OverflowError, AssertionError)
_NUMBERS = "biuf"
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
        except _SYMPTOMS as error:
            _blame(function, args, kwargs, error)
            raise

    return cast(F, named)


def check_fields(instance: Any) -> None:
    """Raise if a field of a dataclass does not match its annotation.

    Parameters
    ----------
    instance
        The dataclass, in its `__post_init__`.

    Raises
    ------
    InvalidInputError
        If one does not.
    """
    for name, default, hint, test in _checks(instance.__class__):
        value = getattr(instance, name, default)
        if value is not default and not test(value):
            _expect(name, value, hint)


def as_floats(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return numbers as float64, or say that they are none.

    Parameters
    ----------
    values
        Of any shape.
    name
        How to call them in the error.

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
    if isinstance(values, np.ndarray) and values.dtype == np.float64:
        return values
    if not _is_array_of_numbers(values):
        raise InvalidInputError(
            f"{name}: expected an array of numbers, got {_described(values)}{_advice(ArrayLike, values)}"
        )
    return np.asarray(values, dtype=np.float64)


def as_count(value: Any, name: str, *, least: int, most: int | None = None) -> int:
    """Return a whole number, or say why it is none that will do.

    Parameters
    ----------
    value
        An integer, of Python's or NumPy's kinds.
    name
        How to call it in the error.
    least, most
        Bounds; None: there is none.

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
        raise InvalidInputError(f"{name}: expected a whole number, got {_described(value)}")
    count = int(value)
    if count < least or (most is not None and count > most):
        bounds = f"at least {least}" if most is None else f"{least} to {most}"
        raise InvalidInputError(f"{name}: expected {bounds}, got {count}")
    return count


def as_generator(rng: np.random.Generator | int | None) -> np.random.Generator:
    """Return a source of randomness.

    Parameters
    ----------
    rng
        One; a seed, at least 0; or None for other numbers each time.

    Raises
    ------
    InvalidInputError
        If it is none of these.
    """
    if rng is None or isinstance(rng, np.random.Generator):
        return np.random.default_rng(rng)
    return np.random.default_rng(as_count(rng, "rng", least=0))


def require(condition: object, name: str, expected: str, got: object) -> None:
    """Raise unless a condition holds.

    Parameters
    ----------
    condition
        What must be true of the argument.
    name, expected, got
        Of the argument: its name, what it should be, and what it is (a text is shown in quotes).

    Raises
    ------
    InvalidInputError
        ``name: expected expected, got got``.
    """
    if not condition:
        raise InvalidInputError(f"{name}: expected {expected}, got {repr(got) if isinstance(got, str) else got}")


def keep(instance: object, **values: object) -> None:
    """Set fields of a frozen dataclass, in its `__post_init__`; arrays become read-only."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(instance, name, value)


def check_magnitude(name: str, sigma: float) -> None:
    """Refuse a standard deviation whose density cannot be computed.

    Parameters
    ----------
    name
        What it is.
    sigma
        Metres, radians or another unit.

    Raises
    ------
    InvalidInputError
        If it is not from 1e-12 to 1e9.
    """
    if not SMALLEST <= sigma <= LARGEST:
        raise InvalidInputError(f"{name}: expected a positive number from {SMALLEST:g} to {LARGEST:g}, got {sigma}")


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
                _expect(name, value, hints[name])
                _expect_each(name, value, hints[name])
            except InvalidInputError as named:
                raise named from error


@cache
def _checks(cls: type) -> tuple[tuple[str, Any, Any, Callable[[Any], bool]], ...]:
    """Return name, default, annotation and test of each field of a dataclass: found out once for a class."""
    hints = _hints(cls)
    return tuple((item.name, item.default, hints[item.name], _kind_of(hints[item.name]).test) for item in fields(cls))


@cache
def _hints(annotated: Any) -> dict[str, Any]:
    return get_type_hints(annotated)


def _expect(name: str, value: Any, hint: Any) -> None:
    kind = _kind_of(hint)
    if not kind.test(value):
        raise InvalidInputError(f"{name}: expected {kind.words}, got {_described(value)}{_advice(hint, value)}")


def _expect_each(name: str, values: Any, hint: Any) -> None:
    """Raise if an item of a sequence does not match."""
    if get_origin(hint) in (collections.abc.Sequence, list) and get_args(hint):
        for index, value in enumerate(values):
            _expect(f"{name}[{index}]", value, get_args(hint)[0])


class _Kind(NamedTuple):
    """What may stand where an annotation is: a test, and in words; what the annotation leaves open, may."""

    test: Callable[[Any], bool]
    words: str


@cache
def _kind_of(hint: Any) -> _Kind:
    if isinstance(hint, TypeVar):
        hint = hint.__bound__ or Any
    origin, inner = get_origin(hint), get_args(hint)
    if hint == ArrayLike or origin is np.ndarray:
        return _Kind(_is_array_of_numbers, "an array of numbers")
    if origin in (Union, UnionType):
        kinds = [_kind_of(one) for one in inner]
        words = " or ".join(dict.fromkeys(kind.words for kind in kinds))
        return _Kind(lambda value: any(kind.test(value) for kind in kinds), words)
    if origin is Literal:
        # Which of the values it is, is checked where it is used, and said better there.
        types = tuple({type(one) for one in inner})
        return _Kind(lambda value: isinstance(value, types), " or ".join(map(repr, inner)))
    if hint in _SIMPLE:
        return _SIMPLE[hint]
    if origin is tuple and inner and inner[-1] is not Ellipsis:
        kinds = [_kind_of(one) for one in inner]
        words = f"({', '.join(kind.words for kind in kinds)})"
        return _Kind(lambda v: _is_row(v) and len(v) == len(kinds) and all(k.test(o) for k, o in zip(kinds, v)), words)  # noqa: B905
    if origin in (collections.abc.Sequence, list, tuple):
        return _Kind(_is_row, "a sequence")
    kind = origin or hint
    words = "a function" if kind is Callable else _with_article(getattr(kind, "__name__", str(hint)))
    if kind is Any or not isinstance(kind, type):
        return _Kind(lambda _: True, words)
    if getattr(kind, "_is_protocol", False):
        members = _members(kind)
        return _Kind(lambda value: all(hasattr(value, member) for member in members), words)
    return _Kind(lambda value: isinstance(value, kind), words)


def _members(protocol: type) -> set[str]:
    """Return the names of what a protocol asks for."""
    own = {name for base in protocol.__mro__ for name in vars(base) if getattr(base, "_is_protocol", False)}
    return {name for name in own if not name.startswith("_")}


def _is_row(value: Any) -> bool:
    return isinstance(value, collections.abc.Sequence | np.ndarray) and not isinstance(value, str | bytes)


def _is_scalar_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in _NUMBERS


def _is_array_of_numbers(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype.kind in _NUMBERS
    if isinstance(value, collections.abc.Mapping | set | frozenset):
        return False
    try:
        return np.asarray(value).dtype.kind in _NUMBERS
    except (ValueError, TypeError):
        return False


def _advice(hint: Any, value: Any) -> str:
    """Return what to do with a value that often stands where another belongs, or nothing."""
    kind = type(value).__name__
    if isinstance(value, str | os.PathLike):
        kind = "path"
    elif isinstance(value, np.ndarray | list | tuple):
        kind = "array"
    hint = hint.__bound__ if isinstance(hint, TypeVar) else hint
    for one in (hint,) if hint == ArrayLike else get_args(hint) or (hint,):
        name = "array" if one == ArrayLike else getattr(get_origin(one) or one, "__name__", "")
        if kind == "dict" and name.endswith("Parameters"):
            return f": {name}(**values) makes them"
        if text := _WHAT_TO_DO.get((name, kind)):
            return f": {text}"
    return _lacking(get_origin(hint) or hint, value)


def _lacking(kind: Any, value: Any) -> str:
    """Return what keeps a value from being what a protocol asks for, if it has some of it."""
    members = _members(kind) if getattr(kind, "_is_protocol", False) else set()
    missing = sorted(name for name in members if not hasattr(value, name))
    return f" without {' and '.join(map(repr, missing))}" if len(missing) < len(members) else ""


# Given (what belongs there, what stands there).
_WHAT_TO_DO = {
    ("OccupancyGrid", "path"): "read_map(path) reads one",
    ("OccupancyGrid", "array"): "OccupancyGrid.from_ros(cells, resolution) makes one",
    ("SensorLog", "path"): "read_log(path).only_sensor() reads one",
    ("SensorLog", "ScanLog"): "choose a sensor of it with .only_sensor(name)",
    ("ScanLog", "path"): "read_log(path) reads one",
    ("Track", "path"): "read_trajectory(path) reads one",
    ("LandmarkMap", "path"): "read_landmarks(path) reads one",
    ("LineMap", "path"): "read_line_map(path) reads one",
    ("BeamParameters", "path"): "read_beam_model(path) reads them",
    ("LikelihoodFieldParameters", "path"): "read_likelihood_field(path) reads them",
    ("LikelihoodFieldParameters", "BeamParameters"): "LikelihoodFieldParameters.from_beam_parameters(...) makes some",
    ("LandmarkParameters", "path"): "read_landmark_model(path) reads them",
    ("RangeFinder", "array"): "RangeFinder.from_bearings(bearings, max_range) makes one",
    ("RangeFinder", "Scan"): "it is the scan's .finder",
    ("RangeFinder", "Generator"): "the sensor comes before the randomness, sample(poses, finder, rng)",
    ("Scan", "array"): "Scan(ranges, finder) makes one, and it comes before the poses",
    ("Scan", "SensorLog"): "log[i] is one of its scans",
    ("array", "Scan"): "the scan comes first, then the poses",
}


def _described(value: Any) -> str:
    """Return what was given in a few words."""
    if value is None or isinstance(value, bool | int | float | complex | np.number | np.bool_):
        return _short(repr(value) if not isinstance(value, np.generic) else str(value))
    if isinstance(value, str):
        return f"the text {_short(repr(value))}"
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} with shape {value.shape}"
    if isinstance(value, list | tuple | dict | set):
        return f"the {type(value).__name__} {_short(repr(value))}"
    return _with_article(type(value).__name__)


_SIMPLE = {
    float: _Kind(lambda value: isinstance(value, float | int | Real) or _is_scalar_array(value), "a number"),
    int: _Kind(lambda value: isinstance(value, int | Integral), "a whole number"),
    bool: _Kind(lambda value: isinstance(value, bool | np.bool_), "True or False"),
    str: _Kind(lambda value: isinstance(value, str), "a text"),
    type(None): _Kind(lambda value: value is None, "None"),
    None: _Kind(lambda value: value is None, "None"),
}


def _with_article(noun: str) -> str:
    return f"{'an' if noun[:1] in 'AEIOUaeiou' else 'a'} {noun}"


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
