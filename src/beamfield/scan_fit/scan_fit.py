"""Does this scan fit the map? A p-value per scan, calibrated on the user's own good scans."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import checked, require
from beamfield.data_frame import data_frame
from beamfield.geometry import FloatArray, as_poses, compose
from beamfield.scan_fit.lost import LostRates, lost_probability
from beamfield.scan_fit.reference import ScanFitReference
from beamfield.scan_fit.statistics import FitModel, FitStatistics, Progress, fit_statistics, grid_of
from beamfield.sensors import RangeFinder, Scan, SensorLog, usable_ranges
from beamfield.short_repr import short_repr

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What can keep a scan from being judged, or make its p-value certain.
PROBLEMS = ("", "no pose", "no measurement", "off the map", "inside a wall", "no mapped obstacle in view")


@dataclass(frozen=True)
class ScanFit:
    """How well one scan fits the map at one pose.

    Parameters
    ----------
    p_value
        Share of good scans that fit as badly, in (0, 1]; NaN without a reference or if the scan says nothing.
    surprise, misfit, through, short
        As in `FitStatistics`; NaN if the scan says nothing.
    n_beams
        Beams that count.
    problem
        "" or why the scan cannot be judged ("no measurement"; "no mapped obstacle in view" if unknown space hides all
        or, for a field, no reading ends anywhere) or should not be believed ("off the map", "inside a wall").
    """

    p_value: float
    surprise: float
    misfit: float
    through: float
    short: float
    n_beams: int
    problem: str = ""


@dataclass(frozen=True, eq=False)
class ScanFits:
    """How well the scans of a log fit.

    Parameters
    ----------
    stamps
        (t,) seconds.
    statistics
        The statistics of each scan.
    p_value
        (t,) NaN where the scan says nothing.
    lost
        (t,) running probability that the robot is lost, given the scans so far.
    problem
        (t,) index into `PROBLEMS`; 0 for none.
    """

    stamps: FloatArray
    statistics: FitStatistics
    p_value: FloatArray
    lost: FloatArray
    problem: NDArray[np.int8]

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.stamps)

    def summary(self) -> str:
        """Return how many scans fit, whether the robot was lost, and the worst scans, as text to print."""
        from beamfield.report.results import fits_summary

        return fits_summary(self)

    def plot(self) -> Figure:
        """Return a Matplotlib figure: p-value and lost probability over time."""
        from beamfield.report.results import plot_fits

        return plot_fits(self)

    def save(self, path: str | Path) -> None:
        """Write one line per scan, as CSV.

        Parameters
        ----------
        path
            The file; one that is there is replaced.
        """
        from beamfield.report.results import save_fits

        save_fits(self, path)

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with one row per scan and the columns of the CSV; needs pandas."""
        s, problem = self.statistics, np.array(PROBLEMS)[self.problem]
        columns = {"stamp": self.stamps, "misfit": s.misfit, "p_value": self.p_value, "lost": self.lost}
        columns |= {"surprise": s.surprise, "through": s.through, "short": s.short}
        return data_frame({**columns, "n_beams": s.n_beams, "problem": problem})

    def share_that_fits(self, level: float = 0.05) -> float:
        """Return the share of judged scans whose p-value is above a level.

        Parameters
        ----------
        level
            In (0, 1). Of good scans about this share lies at or below it.

        Returns
        -------
        In [0, 1]; NaN if no scan could be judged.
        """
        judged = self.p_value[~np.isnan(self.p_value)]
        return float((judged > level).mean()) if len(judged) else float("nan")

    def longest_lost(self) -> tuple[float, float] | None:
        """Return the longest stretch of scans at which the robot is more likely lost than not.

        Returns
        -------
        Stamps of its first and last scan, seconds; None if there is none.
        """
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.lost > 0.5, [0]])))
        spans = [(float(self.stamps[a]), float(self.stamps[b - 1])) for a, b in edges.reshape(-1, 2)]
        return max(spans, key=lambda span: span[1] - span[0], default=None)

    def worst(self, n: int = 5, *, apart_s: float = 0.0) -> NDArray[np.int64]:
        """Return the worst scans: those with the largest misfit.

        Not the lowest p-values: of a log that is judged by itself, scans near its ends have more good scans to be
        compared with, and so lower ones.

        Parameters
        ----------
        n
            At most so many.
        apart_s
            Each is further than this from those before it, seconds.

        Returns
        -------
        Indices, worst first; scans that could not be judged are not among them.
        """
        chosen: list[int] = []
        order = np.argsort(-np.nan_to_num(self.statistics.misfit, nan=-np.inf), kind="stable")
        for i in order[~np.isnan(self.p_value[order])]:
            if len(chosen) == n:
                break
            if all(abs(self.stamps[i] - self.stamps[j]) > apart_s for j in chosen):
                chosen.append(int(i))
        return np.array(chosen, dtype=np.int64)


@checked
def judge_scan(model: FitModel, scan: Scan, pose: ArrayLike, reference: ScanFitReference | None = None) -> ScanFit:
    """Judge how well a scan fits the map at a pose.

    Parameters
    ----------
    model
        `BeamModel`, `SonarModel` or `LikelihoodFieldModel`.
    scan
        The scan; its finder says where the beams start.
    pose
        (3,) the robot's pose in the map, metres and radians.
    reference
        What good scans look like, from `calibrate_scan_fit`; without it there is no p-value, only statistics.

    Returns
    -------
    ScanFit
        With p-value NaN and `problem` set if no beam counts.

    Raises
    ------
    InvalidInputError
        If the pose is not finite (3,), or the reference was made with another model.

    Notes
    -----
    The p-value is about one scan: one in twenty good scans has p < 0.05. It falls for a wrong pose, a changed map and a
    crowd alike; `through` tells the first two from the last, because people never lengthen a range. For the question
    whether the robot is lost, use `lost_probability` over successive scans.

    Examples
    --------
    >>> from beamfield.maps.occupancy import OccupancyGrid
    >>> from beamfield.models.beam import BeamModel
    >>> from beamfield.models.beam_parameters import BeamParameters
    >>> from beamfield.sensors import RangeFinder
    >>> room = np.zeros((40, 60))
    >>> room[[0, -1]] = room[:, [0, -1]] = 100
    >>> model = BeamModel(OccupancyGrid.from_ros(room, 0.1), BeamParameters(0.8, 0.1, 0.05, 0.05, 0.1, 0.5))
    >>> finder = RangeFinder.from_bearings(np.linspace(-3.0, 3.0, 60), max_range=8.0)
    >>> scan = model.sample([[2.0, 1.0, 0.3]], finder, np.random.default_rng(1))[0]
    >>> right, wrong = (judge_scan(model, scan, pose) for pose in ([2.0, 1.0, 0.3], [3.0, 2.5, 2.0]))
    >>> wrong.misfit > 2.0 * right.misfit
    True
    """
    robot = as_poses(pose, "pose")
    require(robot.size == 3, "pose", "shape (3,)", robot.shape)
    robot = robot.reshape(1, 3)
    if reference is not None:
        reference.require_model(model, scan.finder.max_range)
    statistics = fit_statistics(model, scan.ranges[None, :], scan.finder, robot)
    p_value = float("nan") if reference is None else float(reference.p_values(statistics.misfit)[0])
    problem = PROBLEMS[_problems(model, robot, scan.ranges[None, :], scan.finder, statistics)[0]]
    values = {item.name: getattr(statistics, item.name)[0].item() for item in fields(statistics)}
    return ScanFit(p_value, **values, problem=problem)


@checked
def judge_log(
    model: FitModel,
    log: SensorLog,
    reference: ScanFitReference,
    *,
    is_own: bool = False,
    rates: LostRates | None = None,
    statistics: FitStatistics | None = None,
    progress: Progress | None = None,
) -> ScanFits:
    """Judge every scan of a log at its reference pose.

    Parameters
    ----------
    model, log, reference
        The model, the log, and what good scans look like.
    is_own
        Whether the reference was learned from this log: then no scan is compared with its neighbours in time.
    rates
        How often the robot gets lost and is found, for `lost_probability`.
    statistics
        Statistics of all scans, if they are known already.
    progress
        Called with (done, total) scans.

    Returns
    -------
    One judgement per scan.

    Raises
    ------
    InvalidInputError
        If the reference was made with another model.
    """
    reference.require_model(model, log.finder.max_range)
    if statistics is None:
        statistics = fit_statistics(model, log.ranges, log.finder, log.poses, progress=progress)
    misfit = statistics.misfit
    p_value = reference.own_p_values(misfit, log.stamps) if is_own else reference.p_values(misfit)
    lost = lost_probability(statistics.surprise, log.stamps, reference.evidence, rates)
    problems = _problems(model, log.poses, log.ranges, log.finder, statistics)
    return ScanFits(log.stamps, statistics, p_value, lost, problems)


def _problems(
    model: FitModel, poses: FloatArray, ranges: FloatArray, finder: RangeFinder, statistics: FitStatistics
) -> NDArray[np.int8]:
    posed = np.asarray(np.isfinite(poses).all(axis=1))
    problem = np.zeros(len(poses), np.int8)
    problem[statistics.n_beams == 0] = PROBLEMS.index("no mapped obstacle in view")
    grid = grid_of(model)
    if grid is not None and finder.n_beams:
        origins = compose(np.where(posed[:, None], poses, 0.0), finder.mounts[0])[:, :2]
        problem[grid.look_up(grid.occupied, origins)] = PROBLEMS.index("inside a wall")
        problem[grid.look_up(np.zeros(grid.shape, bool), origins, outside=True)] = PROBLEMS.index("off the map")
    problem[np.isnan(usable_ranges(ranges, finder)).all(axis=1)] = PROBLEMS.index("no measurement")
    problem[~posed] = PROBLEMS.index("no pose")
    return problem
