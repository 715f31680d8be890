"""Which topics of a bag belong to one robot: those of its namespace, and those of none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from beamfield.errors import InvalidInputError


def holds(topic: str, other: str) -> bool:
    """Return whether the namespace of one topic holds another topic: that of /odom holds all.

    Examples
    --------
    >>> holds("/robot1/tf", "/robot1/lidar/scan"), holds("/robot1/tf", "/robot2/scan"), holds("/tf", "/robot2/scan")
    (True, False, True)
    """
    return other.startswith(topic.rpartition("/")[0] + "/")


def transform_topics(path: Path, tf_topics: Sequence[str], scan_topics: Sequence[str]) -> list[str]:
    """Return the topics of transforms that the scans' robot listens to: those whose namespace holds the scans, or all.

    Robots with a namespace of their own publish frames of the same names, each on a topic of its own.
    InvalidInputError, which names the path, if the scans are of several robots.
    """
    heard = {scan: {tf for tf in tf_topics if holds(tf, scan)} for scan in scan_topics}
    most = max(heard.values(), key=len, default=set())
    if not all(topics <= most for topics in heard.values()):
        listed = ", ".join(map(repr, scan_topics))
        raise InvalidInputError(
            f"{path}: the scans are of several robots, whose transforms are on topics of their own; choose one by "
            f"sensor_topic: the bag has {listed}"
        )
    return [topic for topic in tf_topics if topic in most] or list(tf_topics)
