"""Whether the file names the frames and the topic that the log has."""

from __future__ import annotations

from collections.abc import Iterator

from beamfield.finding import Finding
from beamfield.stacks.doctor.subject import Subject

# Frames that amcl takes from others, and what they are mostly called; it makes the map's transform itself.
FRAMES = {"base_frame_id": "base", "odom_frame_id": "odom"}
MOST_SHOWN = 5


def unknown_frames(subject: Subject) -> Iterator[Finding]:
    """Find a frame that no transform of the log has."""
    known = {_last(frame) for frame in subject.frames}
    for name, word in FRAMES.items():
        frame = _text(subject, name)
        # Launch files put the robot's name in front of frames, and with it the log has them.
        if known and frame and _last(frame) not in known:
            alike = [other for other in subject.frames if word in other] or list(subject.frames)
            yield subject.finding(
                "frame-not-in-log", "warning",
                f"{name} is {frame!r}, which the log's transforms do not have, but {', '.join(alike[:MOST_SHOWN])}",
                f"without transforms of that frame {subject.file.stack} takes no scan and publishes no pose",
                "write the name of the robot's own frame, unless your launch file does", own=name,
            )  # fmt: skip


def other_topic(subject: Subject) -> Iterator[Finding]:
    """Report that the log's scans are of another topic than the program's."""
    asked = _text(subject, "scan_topic")
    topic = "" if subject.log is None else subject.log.finder.name
    if asked and topic.startswith("/") and _last(asked) != _last(topic):
        yield subject.finding(
            "other-scan-topic", "info", f"scan_topic is {asked!r}, the scans of the log are of {topic!r}",
            "what is said here of readings holds for the log's; a filter in between may leave out some of them",
            f"record {asked!r}, too, and choose it with --sensor, unless your launch file remaps it", own="scan_topic",
        )  # fmt: skip


def _text(subject: Subject, name: str) -> str:
    entry = subject.file.section.entries.get(name)
    return entry.value if entry is not None and isinstance(entry.value, str) else ""


def _last(name: str) -> str:
    return name.rsplit("/", 1)[-1]
