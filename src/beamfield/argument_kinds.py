"""What may stand where an annotation is, and how to say what stands there instead."""

from __future__ import annotations

import collections.abc
import os
from collections.abc import Callable
from functools import cache
from numbers import Integral, Real
from types import UnionType
from typing import Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.errors import InvalidInputError

_NUMBERS = "biuf"
_MASKED = np.ma.MaskedArray
# From NumPy 2.5 on NDArray[...] is an alias that keeps its array to itself.
_ARRAYS = (np.ndarray, get_origin(NDArray[np.float64]))


def expect(name: str, value: Any, hint: Any) -> None:
    """Raise if a value does not match an annotation."""
    kind = kind_of(hint)
    if not kind.test(value):
        raise InvalidInputError(f"{name}: expected {kind.words}, got {described(value)}{advice(hint, value)}")


def expect_each(name: str, values: Any, hint: Any) -> None:
    """Raise if an item of a sequence does not match."""
    if get_origin(hint) in (collections.abc.Sequence, list) and get_args(hint):
        for index, value in enumerate(values):
            expect(f"{name}[{index}]", value, get_args(hint)[0])


class Kind(NamedTuple):
    """What may stand where an annotation is: a test, and in words; what the annotation leaves open, may."""

    test: Callable[[Any], bool]
    words: str


@cache
def kind_of(hint: Any) -> Kind:
    """Return what an annotation asks for."""
    if isinstance(hint, TypeVar):
        hint = hint.__bound__ or Any
    origin, inner = get_origin(hint), get_args(hint)
    if hint == ArrayLike or origin in _ARRAYS:
        return Kind(is_array_of_numbers, "an array of numbers")
    if origin in (Union, UnionType):
        kinds = [kind_of(one) for one in inner]
        words = " or ".join(dict.fromkeys(kind.words for kind in kinds))
        return Kind(lambda value: any(kind.test(value) for kind in kinds), words)
    if origin is Literal:
        # Which of the values it is, is checked where it is used, and said better there.
        types = tuple({type(one) for one in inner})
        return Kind(lambda value: isinstance(value, types), " or ".join(map(repr, inner)))
    if hint in _SIMPLE:
        return _SIMPLE[hint]
    if origin is tuple and inner and inner[-1] is not Ellipsis:
        kinds = [kind_of(one) for one in inner]
        words = f"({', '.join(kind.words for kind in kinds)})"
        return Kind(lambda v: _is_row(v) and len(v) == len(kinds) and all(k.test(o) for k, o in zip(kinds, v)), words)  # noqa: B905
    if origin in (collections.abc.Sequence, list, tuple):
        return Kind(_is_row, "a sequence")
    kind = origin or hint
    words = "a function" if kind is Callable else _with_article(getattr(kind, "__name__", str(hint)))
    if kind is Any or not isinstance(kind, type):
        return Kind(lambda _: True, words)
    if getattr(kind, "_is_protocol", False):
        members = _members(kind)
        return Kind(lambda value: all(hasattr(value, member) for member in members), words)
    return Kind(lambda value: isinstance(value, kind), words)


def _members(protocol: type) -> set[str]:
    """Return the names of what a protocol asks for."""
    own = {name for base in protocol.__mro__ for name in vars(base) if getattr(base, "_is_protocol", False)}
    return {name for name in own if not name.startswith("_")}


def _is_row(value: Any) -> bool:
    return isinstance(value, collections.abc.Sequence | np.ndarray) and not isinstance(value, str | bytes)


def _is_scalar_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in _NUMBERS


def is_array_of_numbers(value: Any) -> bool:
    """Return whether it is one, or can be made one."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind in _NUMBERS and not _is_masked(value)
    if isinstance(value, collections.abc.Mapping | set | frozenset):
        return False
    # Rows of a masked array; looking at each of a list's items would take as long as to make an array of them.
    if type(value) is list and value and type(value[0]) is _MASKED and any(map(_is_masked, value)):
        return False
    try:
        return np.asarray(value).dtype.kind in _NUMBERS
    except (ValueError, TypeError):
        return False


def _is_masked(value: Any) -> bool:
    """Return whether it is an array with numbers that are masked: NumPy would go on with what is below the mask."""
    return isinstance(value, _MASKED) and bool(np.ma.is_masked(value))


def advice(hint: Any, value: Any) -> str:
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
    ("OccupancyGrid", "RangeTable"): "the table is BeamModel's caster=, beside the grid",
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
    ("array", "Particles"): "its .poses are",
    ("array", "PoseBelief"): "localization.belief_poses(belief, n, rng) draws poses from it",
    ("RangeTablePlan", "OccupancyGrid"): "RangeTable.build(grid) makes a table",
    ("RangeNoise", "float"): "RangeNoise(sigma_range) makes one",
    ("Generator", "int"): "np.random.default_rng(seed) makes one",
}


def described(value: Any) -> str:
    """Return what was given in a few words."""
    if value is None or isinstance(value, bool | int | float | complex | np.number | np.bool_):
        return _short(repr(value) if not isinstance(value, np.generic) else str(value))
    if isinstance(value, str):
        return f"the text {_short(repr(value))}"
    if _is_masked(value):
        n = np.count_nonzero(np.ma.getmaskarray(value))
        as_floats = "" if value.dtype.kind == "f" else ".astype(float)"
        return f"an array with {n} of {value.size} masked: {as_floats}.filled(np.nan) has NaN there"
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} with shape {value.shape}"
    if isinstance(value, list | tuple | dict | set):
        return f"the {type(value).__name__} {_short(repr(value))}"
    return _with_article(type(value).__name__)


_SIMPLE = {
    float: Kind(lambda value: isinstance(value, float | int | Real) or _is_scalar_array(value), "a number"),
    int: Kind(lambda value: isinstance(value, int | Integral), "a whole number"),
    bool: Kind(lambda value: isinstance(value, bool | np.bool_), "True or False"),
    str: Kind(lambda value: isinstance(value, str), "a text"),
    type(None): Kind(lambda value: value is None, "None"),
    None: Kind(lambda value: value is None, "None"),
}


def _with_article(noun: str) -> str:
    return f"{'an' if noun[:1] in 'AEIOUaeiou' else 'a'} {noun}"


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
