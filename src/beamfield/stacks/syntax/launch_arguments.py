"""What roslaunch fills in: ``$(arg name)``, and elements that are there only under a condition."""

from __future__ import annotations

import re
from collections.abc import Mapping

# Of ROS 1 and of ROS 2.
_FILLED_IN = re.compile(r"\$\((?:arg|var)\s+([^()\s]+)\s*\)")
# The value without the variable; what the variable says is not known.
_OPTIONAL = re.compile(r"\$\(optenv\s+[^()\s]+\s+([^()]*)\)")
_MARK = "$("
# Arguments may refer to others; what grows longer than this is not a parameter.
_MAX_LENGTH = 1000


class LaunchArguments:
    """The arguments of a launch file, with the values they have if nobody gives others.

    So are environment variables that have a default in the file. Arguments and variables without one, packages' folders
    and expressions are not known.
    """

    def __init__(self) -> None:
        self._values: dict[str, str] = {}

    def declare(self, attributes: Mapping[str, str]) -> None:
        """Take note of an ``<arg>`` tag; nothing is known of one with a condition that is known only at the start."""
        name, given = attributes.get("name", ""), attributes.get("value", attributes.get("default"))
        value = None if given is None else self.fill_in(given)
        if not self.is_known(attributes):
            self._values.setdefault(name, f"$(arg {name})")
        elif value is not None:
            self._values.setdefault(name, value)

    def fill_in(self, text: str) -> str | None:
        """Return the text with its arguments filled in; None if one of them is not known."""
        if _MARK not in text:
            return text
        filled = _FILLED_IN.sub(lambda found: self._values.get(found.group(1), found.group()), text)
        filled = _OPTIONAL.sub(lambda found: found.group(1).strip(), filled)
        return None if _MARK in filled or len(filled) > _MAX_LENGTH else filled

    def is_known(self, attributes: Mapping[str, str]) -> bool:
        """Whether it is known before the start what a tag's ``if`` and ``unless`` say."""
        return all(self.fill_in(attributes.get(name, "")) is not None for name in ("if", "unless"))

    def is_there(self, attributes: Mapping[str, str]) -> bool:
        """Whether a tag's ``if`` and ``unless`` let it be there; what is not known does."""
        for name, wanted in (("if", True), ("unless", False)):
            value = self.fill_in(attributes.get(name, ""))
            if value and (value.strip().lower() in ("true", "1")) is not wanted:
                return False
        return True
