"""Whether the file names the frames and the topic that the log has, and lets the program speak and know the time."""

from __future__ import annotations

from collections.abc import Iterator

from beamfield.finding import Finding
from beamfield.stacks.doctor.subject import Subject

# Frames that amcl takes from others, and what they are mostly called; it makes the map's transform itself.
FRAMES = {"base_frame_id": "base", "odom_frame_id": "odom"}
MOST_SHOWN = 5
# Seconds since 1970; simulated time begins at 0.
SINCE_2001 = 1e9


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


def silent_program(subject: Subject) -> Iterator[Finding]:
    """Report a program that publishes no transform, and one that waits for simulated time beside a robot's log."""
    if _is(subject, "tf_broadcast", "false"):
        yield subject.finding(
            "no-broadcast", "info", f"tf_broadcast is false: {subject.file.stack} makes no transform from map to odom",
            "unless another node makes it, the robot is nowhere in the map, however good the pose that is published",
            "set it to true, unless one other node (an EKF that takes amcl_pose) makes the transform",
            own="tf_broadcast",
        )  # fmt: skip
    log = subject.log
    if _is(subject, "use_sim_time", "true") and log is not None and len(log) and log.stamps[0] > SINCE_2001:
        yield subject.finding(
            "simulated-time", "info", "use_sim_time is true, and the log's stamps are those of a real clock",
            "without a simulator's /clock the node's time stands still: its timers do not run",
            "set it to false on the robot, unless your launch file does", own="use_sim_time",
        )  # fmt: skip


def _is(subject: Subject, name: str, word: str) -> bool:
    entry = subject.file.section.entries.get(name)
    return entry is not None and str(entry.value).lower() == word


def _text(subject: Subject, name: str) -> str:
    entry = subject.file.section.entries.get(name)
    return entry.value if entry is not None and isinstance(entry.value, str) else ""


def _last(name: str) -> str:
    return name.rsplit("/", 1)[-1]
