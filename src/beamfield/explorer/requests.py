"""What the page may ask, checked: every number within its bounds, nothing else let in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from beamfield.errors import InvalidInputError

# A message longer than this is refused unread, in bytes.
LARGEST_MESSAGE = 20_000
# Requests that take long.
SLOW = frozenset({"heat", "building", "scores", "judge", "filter"})
# Poses farther out than this are a mistake, metres.
FARTHEST = 1e6


@dataclass(frozen=True)
class Request:
    """What was asked, and how."""

    name: str
    fields: Mapping[str, Any]

    @classmethod
    def parsed(cls, message: Any) -> Request:
        """Return a request from decoded JSON: an object with a name and further fields."""
        if not isinstance(message, dict) or not isinstance(message.get("name"), str):
            raise InvalidInputError("message: expected an object with a name")
        return cls(message["name"], {key: value for key, value in message.items() if key != "name"})

    def integer(self, name: str, n: int) -> int:
        """Return a whole number from 0 to n - 1."""
        value = self.fields.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < n:
            raise InvalidInputError(f"{name}: expected a whole number from 0 to {n - 1}")
        return value

    def integers(self, name: str, n: int, most: int) -> list[int]:
        """Return a list of at most so many whole numbers from 0 to n - 1."""
        values = self.fields.get(name)
        if not isinstance(values, list) or len(values) > most:
            raise InvalidInputError(f"{name}: expected a list of at most {most} whole numbers")
        return [Request("", {name: value}).integer(name, n) for value in values]

    def flag(self, name: str) -> bool:
        """Return true or false; false by default."""
        value = self.fields.get(name, False)
        if not isinstance(value, bool):
            raise InvalidInputError(f"{name}: expected true or false")
        return value

    def number(self, name: str, low: float, high: float) -> float:
        """Return a number within bounds."""
        value = self.fields.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise InvalidInputError(f"{name}: expected a number from {low:g} to {high:g}")
        return float(value)

    def pose(self) -> tuple[float, float, float]:
        """Return x, y and heading."""
        value = self.fields.get("pose")
        if not isinstance(value, list) or len(value) != 3 or not all(_is_number(one) for one in value):
            raise InvalidInputError("pose: expected three finite numbers")
        x, y, heading = map(float, value)
        return x, y, heading

    def parameters(self, number: int) -> Mapping[str, Any]:
        """Return what is changed in a set, by name; nothing by default. The set checks the values."""
        sets = self.fields.get("parameters", {})
        values = sets.get(str(number), {}) if isinstance(sets, dict) else None
        if not isinstance(values, dict):
            raise InvalidInputError("parameters: expected an object of numbers by the number of their set")
        return values


def _is_number(value: Any) -> bool:
    # NaN is not below a limit; a whole number may be too large to be a float.
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= FARTHEST
