"""What the program's own filter makes of a file's values: it is replayed on the log."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil

import numpy as np

from beamfield.finding import Finding
from beamfield.localization.replay import ReplayErrors
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import has_fill, hollowed
from beamfield.sensors import SensorLog
from beamfield.stacks.doctor.subject import Subject
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import StackFile
from beamfield.stacks.files.typed_values import typed_values
from beamfield.stacks.fit.replay_amount import replay_options
from beamfield.stacks.fit.replay_runs import SPREAD, half_cell_shift, shifted_map
from beamfield.stacks.fit.replay_segments import cut_segments

Progress = Callable[[str, int, int], None]

# Over all stretches. Values that follow a robot lose none of these runs; one may be chance.
RUNS, FEWEST_LOST = 24, 2
# Metres in the mean, from which on a robot counts as lost though no run is: stretches are short.
FAR = 0.5


def replayed(file: StackFile, grid: OccupancyGrid, log: SensorLog, *, progress: Progress | None = None) -> Finding:
    """Return how often the filter that a file sets up loses the robot on stretches of a log.

    The log has odometry and reference poses. FormatError if a value cannot be used, or the program's filter is not
    emulated; TooLittleDataError if the drive is too short.
    """
    subject = Subject(file, typed_values(file), grid, log=log)
    settings = read_filter_settings(file)
    options = replay_options(settings, log, seed=0)
    stretches = cut_segments(log, *settings.update_distances, most=options.most_stretches, longest=options.longest)
    own = settings.filter(_own_map(subject, grid) if subject.has_own_map else grid)
    seeds = range(ceil(min(RUNS, options.runs) / len(stretches)))
    runs: list[ReplayErrors] = []
    for done, stretch in enumerate(stretches):
        if progress is not None:
            progress("replaying the filter", done, len(stretches))
        runs += run_trials(own, stretch, seeds, spread=SPREAD).errors
    n_lost, error = sum(one.lost for one in runs), float(np.mean([one.mean for one in runs]))
    is_lost = n_lost >= FEWEST_LOST or error > FAR
    return subject.finding(
        "replayed", "warning" if is_lost else "info",
        f"replayed on {len(stretches)} stretches of this log, the filter of {subject.stack.title}, emulated, loses the "
        f"robot in {n_lost or 'none'} of {len(runs)} runs; {error:.3f} m from the reference poses in the mean",
        "with these values the robot gets lost on such a drive" if is_lost
        else "these values follow the robot on such a drive" + ("; one run may be chance" if n_lost else ""),
        "put right what else is found, then let beamfield calibrate --stack choose values by such replays" if is_lost
        else "nothing, unless that is not exact enough: beamfield calibrate --stack looks for better values",
        values={"lost": n_lost, "runs": len(runs), "error_m": error},
    )  # fmt: skip


def _own_map(subject: Subject, grid: OccupancyGrid) -> OccupancyGrid:
    """Return the map for the program alone, given everyone's."""
    is_filled = subject.model.solids_attract(subject.parameters) and has_fill(grid)
    return shifted_map(hollowed(grid) if is_filled else grid, half_cell_shift(subject.stack, grid))
