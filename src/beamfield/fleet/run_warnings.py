"""What the runs of a robot say of it beside its beams: that it was lost, or that its odometry is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from beamfield.finding import Finding
from beamfield.fleet.pose_trust import LOST, doubts_in
from beamfield.fleet.run_record import RunRecord
from beamfield.localization.robot_faults import OF_THE_ROBOT

# Warnings of a run that are about the robot, by how urgent they are: 1 and more is red. A lost one's is how far off it
# was, in metres; with a wrong sign, mount or delay it gets lost.
URGENCY = {
    LOST: 1.0, "odometry-sign": 1.0, "laser-mount": 1.0, "scan-delay": 1.0, "scan-parts-disagree": 0.5,
    "odometry-scale": 0.5, "odometry-turn-scale": 0.5, "odometry-drift": 0.5, "odometry-drift-at-rest": 0.5,
    "odometry-disagrees": 0.5, "odometry-reset": 0.5, "odometry-jumps": 0.5, "kidnapped": 0.5,
}  # fmt: skip


def run_warnings(runs: Sequence[RunRecord]) -> Iterator[tuple[float, Finding]]:
    """Yield the warnings about a robot in all its runs, used or not, each once, with how urgent it is."""
    for name in URGENCY:
        found = [(_urgency(one), run, one) for run in runs for one in run.findings if one.name == name]
        if name == "odometry-disagrees":
            # As it does with a wrong mount, too.
            found = [entry for entry in found if not any(one.name in OF_THE_ROBOT for one in entry[1].findings)]
        if found:
            # The first one of the worst.
            urgency, run, worst = max(found, key=lambda entry: entry[0])
            n = len({run.run for _, run, _ in found})
            where = f"run {run.run}" if len(runs) == 1 else f"{n} of {len(runs)} runs, as in {run.run}"
            yield urgency, replace(worst, text=f"In {where}: {worst.text}")
    doubted = [run for run in runs if not run.is_used and doubts_in(run.findings)]
    if doubted:
        first = doubted[0]
        which = f"Run {first.run}"
        if len(runs) > 1:
            which = f"{len(doubted)} of {len(runs)} runs, as {first.run},"
        yield (
            0.0,
            Finding(
                "poses-doubted",
                "warning",
                f"{which} cannot be used: {first.reason}",
                {"runs": float(len(doubted))},
                why="At wrong poses, or in a wrong map, beams say nothing of the range finder.",
                do="Look at the run with beamfield check; see whether the robot was lost, and whether the map is that "
                "of the place.",
            ),
        )


def _urgency(finding: Finding) -> float:
    return finding.values.get("largest_m", 1.0) if finding.name == LOST else URGENCY[finding.name]
