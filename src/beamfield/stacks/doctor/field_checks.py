"""How a program works out the distances of its field."""

from __future__ import annotations

from collections.abc import Iterator

from beamfield.finding import Finding
from beamfield.stacks.doctor.subject import Subject


def uninitialised_queue(subject: Subject) -> Iterator[Finding]:
    """Say that nav2's distances depend on how it was built."""
    if subject.file.stack == "nav2" and subject.is_field:
        yield subject.finding(
            "distance-queue-uninitialised", "info",
            "nav2 since April 2025 (commit def640f3d) never sets the distance by which it sorts obstacles in its queue",
            "the queue's order depends on what is in memory: distances come out right or metres too long, from build "
            "to build and from start to start; here they are taken as meant",
            "nothing in this file: look for a release that sets occ_dist of obstacle cells to 0 in map_cspace.cpp, or "
            "build one",
        )  # fmt: skip
