"""Texts of the library in the words of the command line, where its parameters are options; poses for people."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

# What a Python caller passes -> what is typed instead. Only names that mean nothing else in a sentence.
_OPTIONS = {
    "base_frame": "--base-frame",
    "block_s": "--block",
    "fit_scale": "--scale",
    "lone_poses": "--lone-poses",
    "map_frame": "--map-frame",
    "max_gigabytes": "--max-size",
    "max_unpacked": "--max-unpacked",
    "n_replicates": "--replicates",
    "no_return": "--no-return",
    "poses_topic": "--poses-topic",
    "sensor_topic": "--sensor",
}
# Not in a path, a quotation or a longer name.
_NAME = re.compile(rf"(?<![\w/.'\"-])({'|'.join(_OPTIONS)})(?![\w/.'\"-])(?:='([^']*)')?")
# As the beginning of an error these are what was given.
_LEADING = {
    "figure": "--only",
    "headings": "--headings",
    "hit": "--hit",
    "model": "--model",
    "mount": "--mount",
    "passed": "--passed",
    "resolution": "--resolution",
    "roughness": "--roughness",
    "scan": "--scan",
    "scheduler": "--scheduler",
    "section": "--section",
    "sites": "--sites",
    "stack": "--stack",
}
# These are words of models and files as well: they are options where they stand for a value to give.
_GIVEN = re.compile(r"(?<=give )(?P<name>max_range|min_range|mount|section)\b|(?<![\w/.'\"-])stamps='(?P<rule>[^']*)'")


def in_options(text: str) -> str:
    """Return a text of the library with its parameters as the options that are typed instead.

    Examples
    --------
    >>> in_options("read it with lone_poses='odometry', and give max_range")
    'read it with --lone-poses odometry, and give --max-range'
    """
    head, colon, rest = text.partition(":")
    text = f"{_LEADING.get(head, head)}{colon}{rest}"
    text = _NAME.sub(lambda found: _OPTIONS[found[1]] + (f" {found[2]}" if found[2] is not None else ""), text)
    return _GIVEN.sub(
        lambda found: f"--{found['name'].replace('_', '-')}" if found["name"] else f"--stamps {found['rule']}", text
    )


def pose_text(pose: Sequence[float]) -> str:
    """Return a pose (x, y, heading in radians) for people."""
    return f"x {pose[0]:.2f} m, y {pose[1]:.2f} m, heading {math.degrees(pose[2]):.1f} deg"
