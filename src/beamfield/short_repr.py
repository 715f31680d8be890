"""The `repr` of what people hold: a few lines, whatever it holds itself."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any

import numpy as np

WIDTH = 110
LONGEST = 150  # characters of a value
FEW = 4  # numbers that are shown one by one
MANY = 1_000_000  # numbers of which none is looked at


def short_repr(instance: Any) -> str:
    """Return the class and the fields of a dataclass or named tuple; arrays and collections by their size.

    Parameters
    ----------
    instance
        That whose `__repr__` this is. A dataclass' fields that have their default are left out.

    Examples
    --------
    >>> from beamfield.sensors import RangeFinder
    >>> RangeFinder.from_bearings(np.linspace(-1.0, 1.0, 181), max_range=12.0)
    RangeFinder(mounts=<181 x 3 numbers, -1 to 1>, max_range=12.0)
    """
    if is_dataclass(instance):
        every = ((item, getattr(instance, item.name)) for item in fields(instance) if item.repr)
        shown = [(item.name, value) for item, value in every if not _is_default(item, value)]
    else:
        shown = list(zip(instance._fields, instance, strict=True))
    text = ", ".join(f"{name}={_brief(value)}" for name, value in shown)
    return "\n".join(textwrap.wrap(f"{type(instance).__name__}({text})", WIDTH, subsequent_indent="    "))


def _is_default(item: Field[Any], value: Any) -> bool:
    if item.default_factory is not MISSING:
        default = item.default_factory()
        return np.array_equal(value, default) if isinstance(default, np.ndarray) else bool(value == default)
    # After pickling a default is equal, but no longer the same object.
    return value is item.default or (isinstance(value, float | int | str) and bool(value == item.default))


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return _brief_array(value)
    if isinstance(value, float):
        # Stamps are large, and six digits of them leave out days.
        return repr(float(f"{value:.6g}" if abs(value) < 1e5 else f"{value:.3f}"))
    shown = short_repr(value) if is_dataclass(value) else repr(value)
    text = " ".join(shown.split()) if not isinstance(value, Mapping | tuple | list) or len(value) <= FEW else ""
    if text and len(text) <= LONGEST:
        return text
    if isinstance(value, str):
        return f"{text[: LONGEST - 3]}..."
    if isinstance(value, Mapping):
        names = ", ".join(repr(name) for name in list(value)[:FEW])
        return f"<{len(value)} by name: {names}{', ...' if len(value) > FEW else ''}>"
    if isinstance(value, Sequence):
        kinds = {type(item).__name__ for item in value}
        return f"<{len(value)} {kinds.pop() if len(kinds) == 1 else 'items'}>"
    return f"<{type(value).__name__}>"


def _brief_array(array: np.ndarray[Any, Any]) -> str:
    if array.size <= FEW and array.ndim == 1:
        return str(array.tolist())
    size = " x ".join(str(n) for n in array.shape)
    if array.dtype.kind not in "iuf" or not 0 < array.size <= MANY:
        return f"<{size} {'True or False' if array.dtype.kind == 'b' else 'numbers'}>"
    finite = array[np.isfinite(array)]
    bounds = f", {finite.min():.4g} to {finite.max():.4g}" if finite.size else ""
    rest = array.size - finite.size
    return f"<{size} numbers{bounds}{f', {rest} not finite' if rest else ''}>"
