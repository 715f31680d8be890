"""A particle filter run over a log of scans, from its first scan to its last."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from beamfield.arguments import as_count, check_fields, checked
from beamfield.errors import TooLittleDataError
from beamfield.finding import Finding, Severity, worst_first
from beamfield.geometry import FloatArray
from beamfield.localization.coarse_model import CoarseModel
from beamfield.localization.distance_scale import DistanceScale, ScaleEstimate
from beamfield.localization.mapped_area import MappedArea, MappedAreaModel
from beamfield.localization.moving_objects import without_crowd_so_far
from beamfield.localization.particle_filter import FilterOptions, ParticleFilter, Update
from beamfield.localization.particles import Estimate, free_poses, normal_poses
from beamfield.localization.recovery import PoseSource
from beamfield.localization.relocalization import Relocalizer
from beamfield.localization.replay import PoseBelief, Replay
from beamfield.localization.short_readings import ShortReadings
from beamfield.localization.trajectory_trust import scale_finding
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import agreement_at
from beamfield.maps.raycast import RayCaster
from beamfield.models.base import MeasurementModel
from beamfield.models.motion import MotionModel
from beamfield.sensors import Scan, SensorLog
from beamfield.short_repr import short_repr

# A place found from anywhere is wrong where the readings of so many scans that were used agree no better with the map,
# in the mean. Robots that are followed: 0.27 or more on 16 logs; wrong places: 0.2 or less
# (docs/evidence/localization.md). After so many, a robot among people or in a changed map keeps its place.
JUDGED_SCANS, CONTRADICTED = 20, 0.25
# For a few scans, one of many thousand poses fits in any building: a robot counts as found only after so many more that
# were used, and after JUDGED_SCANS where an earlier place proved wrong. In the maps of ten other offices, places were
# found for the last 1 to 11 scans of a log.
PROVING_SCANS = 12
# So small a share of scans beyond the map is not worth a word: a cell may be unknown where a robot drives.
FEW = 0.01

# So many standard deviations from 0, the error of the odometry's distances is worth a word.
SURE_OF_SCALE = 2.0

# Called after each measurement used: the index of its scan, and what it did.
Watch = Callable[[int, Update], None]


@dataclass(frozen=True, eq=False)
class Localization(Replay):
    """What our filter said while a log ran.

    Parameters
    ----------
    findings
        What was wrong with the log and what was done about it.
    searched_from
        Index of the scan from which on the robot was searched for the last time, or found elsewhere; 0 if the first
        search, or the start, was not given up.
    distance_scale
        The relative error of the odometry's distances, by the particles at the end; None if they have none.
    """

    findings: tuple[Finding, ...] = ()
    searched_from: int = 0
    distance_scale: ScaleEstimate | None = None

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class ScanLocalizer:
    """Localizes a robot in a map by the scans and the odometry of a log: a `ReplayedFilter`.

    Parameters
    ----------
    grid
        The map: where a robot that can be anywhere may be.
    model
        Weighs scans.
    motion
        Moves particles.
    options
        Of the filter; by default, all of the odometry's distances may be off alike.
    n_anywhere
        Particles to begin with where the start is not known. They are weighed once; from then on there are 5000 to
        50,000 until the robot is found, and then as many as the options say.
    coarse
        Weighs scans where the start is not known, until the robot is found; None: a `CoarseModel`.
    source
        Where poses come from in a recovery.
    short_readings
        Leaves out readings of people; None uses all.
    relocalize
        Whether a robot is searched for on the whole map where scans contradict its place.

    Raises
    ------
    InvalidInputError
        If n_anywhere < 1, or the options ask for a recovery and there is no source.
    """

    grid: OccupancyGrid
    model: MeasurementModel[Scan]
    motion: MotionModel
    options: FilterOptions = field(default_factory=lambda: FilterOptions(distance_scale=DistanceScale()))
    n_anywhere: int = field(default=200_000, kw_only=True)
    coarse: MeasurementModel[Scan] | None = field(default=None, kw_only=True)
    source: PoseSource[Scan] | None = field(default=None, kw_only=True)
    short_readings: ShortReadings | None = field(default=None, kw_only=True)
    relocalize: bool = field(default=True, kw_only=True)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        as_count(self.n_anywhere, "n_anywhere", least=1, most=10_000_000)
        self._filter(0)

    @checked
    def run(
        self, log: SensorLog, start: PoseBelief | None, rng: np.random.Generator, *, watch: Watch | None = None
    ) -> Localization:
        """Filter a log.

        In a log of which 12% or more of the readings are of what moves, such as people, by the scans before each, these
        are left out, unless the model has a share of short readings.

        Parameters
        ----------
        log
            With odometry; the reference poses are not looked at.
        start
            Where the robot is at the first scan; None if it can be anywhere in the map's free cells. A place that is
            found, but that the next 20 scans of a laser contradict, is given up, and the robot searched for again; one
            that was given, or found before, is kept until another proves better (`Relocalizer`).
        rng
            Source of all randomness.
        watch
            Called after each measurement used.

        Returns
        -------
        The poses published at the scans (NaN where a scan has no odometry), the belief at each update, and findings.

        Raises
        ------
        TooLittleDataError
            If no scan has odometry.
        InvalidInputError
            If the start is not known and the map has no free cell.
        """
        if not log.has_odometry:
            raise TooLittleDataError("log: no scan has odometry, which moves the particles; expected some")
        # Who explains short readings learns from them where nothing stands in front.
        explains_people = getattr(getattr(self.model, "parameters", None), "z_short", 0.0) > 0.0
        log, crowd = (log, ()) if explains_people else _without_crowd_so_far(log)
        own, coarse = self._filter(rng), None if start is not None else self.coarse or CoarseModel(self.grid)
        own.start(self._cloud(start, rng), coarse=coarse)
        place, searched_from = _FoundPlace(self.grid), 0
        again = self._relocalizer(rng) if self.relocalize and self.grid.free.any() else None
        relocalized = list[float]()
        poses: FloatArray = np.full((len(log), 3), np.nan)
        # Of the clouds, which are large, mean and covariance are kept.
        used, clouds, sizes, seconds = [], list[Estimate](), [], []
        counts = Counter[str]()
        # The last scan given to the filter, and the first at which it was sure of its place.
        given, sure = -1, 0
        for i, scan in enumerate(log):
            if not np.isfinite(log.odometry[i]).all():
                counts["no-odometry"] += 1
                continue
            if given >= 0 and _is_repeated(log, i, given):
                counts["repeated-scans"] += 1
            else:
                given = i
                begin = time.thread_time()
                update = own.update(scan, log.odometry[i], scan.stamp)
                if coarse is not None and not place.is_settled:
                    if update is not None and own.is_found and place.is_wrong(scan, own.pose):
                        counts["searched-again"] += 1
                        counts["odometry-jumps"] += own.odometry_jumps
                        own.start(self._cloud(None, rng), coarse=coarse)
                        update = own.update(scan, log.odometry[i], scan.stamp)
                        place, searched_from = _FoundPlace(self.grid), i
                elif again is not None:
                    before = own
                    own, update = again.follow(own, update, scan, log.odometry[i], scan.stamp)
                    if own is not before:
                        searched_from = i
                        relocalized.append(float(scan.stamp - log.stamps[0]))
                        counts["odometry-jumps"] += before.odometry_jumps - own.odometry_jumps
                if update is not None:
                    used.append(i)
                    seconds.append(time.thread_time() - begin)
                    clouds.append(update.belief.whole)
                    sizes.append(len(update.belief))
                    counts["impossible-scans"] += update.is_impossible
                    if watch is not None:
                        watch(i, update)
            poses[i] = own.pose
            sure = sure if own.is_found else i + 1
        counts["odometry-jumps"] += own.odometry_jumps
        proving = JUDGED_SCANS if searched_from > 0 else PROVING_SCANS
        is_judged = own.is_found and coarse is not None and log.finder.opening_angle == 0.0
        is_late = is_judged and place.n_scans < proving
        counts["found-late"] = place.n_scans if is_late else 0
        counts["not-found"] = int(not own.is_found or (is_late and place.n_scans == 0))
        # Where it was taken to be before it was found, or found elsewhere, says nothing.
        known = poses[max(searched_from, sure) :]
        known = known[np.isfinite(known).all(axis=1)]
        n_beyond = int(self._area.is_beyond(known).sum())
        counts["beyond-map"] = n_beyond if n_beyond > FEW * len(log) and own.is_found and not is_late else 0
        scale = _scale_finding(own.distance_scale) if own.is_found and not is_late else ()
        counts["stamps-back"] = int((np.diff(log.stamps) < 0.0).sum())
        return Localization(
            poses,
            np.array(used, np.int64),
            np.reshape([cloud.pose for cloud in clouds], (-1, 3)),
            np.reshape([cloud.covariance for cloud in clouds], (-1, 3, 3)),
            np.array(sizes, np.int64),
            np.array(seconds),
            findings=worst_first([*_findings(counts, len(log), relocalized), *crowd, *scale]),
            searched_from=searched_from,
            distance_scale=own.distance_scale,
        )

    def _filter(self, rng: np.random.Generator | int) -> ParticleFilter[Scan]:
        return ParticleFilter(
            MappedAreaModel(self.model, self._area), self.motion, self.options,
            source=self.source, short_readings=self.short_readings, rng=rng,
        )  # fmt: skip

    @cached_property
    def _area(self) -> MappedArea:
        return MappedArea(self.grid)

    def _relocalizer(self, rng: np.random.Generator) -> Relocalizer:
        # Searches draw from a source of their own: a robot that is followed has the same poses without them. It is not
        # spawned: not all generators can, and what they spawn does not follow from their state.
        source = np.random.default_rng(deepcopy(rng).integers(2**63))
        return Relocalizer(
            self.grid,
            lambda: self._filter(source),
            coarse=self.coarse,
            n_anywhere=max(self.n_anywhere, self.options.n_particles),
            rng=source,
        )

    def _cloud(self, start: PoseBelief | None, rng: np.random.Generator) -> FloatArray:
        if start is None:
            return free_poses(self.grid, max(self.n_anywhere, self.options.n_particles), rng)
        return normal_poses(start, self.options.n_particles, rng)


class _FoundPlace:
    """Tells by the first scans since a robot was found whether it is there."""

    def __init__(self, grid: OccupancyGrid) -> None:
        self._grid = grid
        self._shares: list[float] = []

    @property
    def n_scans(self) -> int:
        """How many scans have been judged, at most `JUDGED_SCANS`."""
        return len(self._shares)

    @property
    def is_settled(self) -> bool:
        """Whether all have been judged; of a place that was not wrong then, no more are."""
        return self.n_scans == JUDGED_SCANS

    @cached_property
    def _caster(self) -> RayCaster:
        return RayCaster(self._grid)

    def is_wrong(self, scan: Scan, pose: FloatArray) -> bool:
        """Return whether the scans contradict the place, one taken at a pose included; cones of a sonar never do."""
        share = agreement_at(scan, self._caster, pose)
        if np.isfinite(share) and scan.finder.opening_angle == 0.0:
            self._shares.append(share)
        return self.is_settled and float(np.mean(self._shares)) < CONTRADICTED


# Filters run over a log many times.
_without_crowd_so_far = lru_cache(maxsize=2)(without_crowd_so_far)


def _is_repeated(log: SensorLog, i: int, given: int) -> bool:
    """Return whether a scan is an earlier one once more, stamp and readings."""
    return bool(log.stamps[i] == log.stamps[given] and np.array_equal(log.ranges[i], log.ranges[given], equal_nan=True))


_BEST_GUESS = (
    "The poses are a best guess. Drive on, or give a start; beamfield trajectory searches by the whole log, beamfield "
    "likelihood by one scan."
)
# Severity, what was seen, why it matters and what was done.
_TEXTS: Mapping[str, tuple[Severity, str, str]] = {
    "no-odometry": (
        "warning",
        "The odometry is missing for {n} of {t} scans.",
        "No pose is given there; the next odometry bridges the gap.",
    ),
    "odometry-jumps": (
        "warning",
        "The odometry jumped {times} farther than a robot can drive or turn.",
        "The jumps were not followed: the particles stayed, spread by 0.3 m and 0.3 rad.",
    ),
    "not-found": (
        "warning",
        "The robot has not been found: at the end the filter is sure of no place.",
        _BEST_GUESS,
    ),
    "found-late": (
        "warning",
        "The filter is sure of its place, but only for the last {n} scans used: so few fit somewhere in any map.",
        _BEST_GUESS,
    ),
    "searched-again": (
        "warning",
        "The filter was sure {times} of a place that the scans then contradicted.",
        "The robot was searched for again, on the whole map; poses before that are wrong.",
    ),
    "beyond-map": (
        "warning",
        "In {n} of {t} scans the robot is where the map is unknown, or beyond its edges.",
        "There only the odometry moved it. Map that part, too, if it was there; if it was not, it was lost.",
    ),
    "stamps-back": (
        "warning",
        "The stamps run backwards {times}.",
        "The order of the log was kept: time only tells a fast robot from a jump of the odometry.",
    ),
    "repeated-scans": ("info", "{n} of {t} scans repeat the one before, stamp and readings.", "They were used once."),
    "impossible-scans": (
        "warning",
        "{n} scans used are impossible at every particle.",
        "They changed no weight. Give the model some z_rand, or begin with a wider cloud.",
    ),
}


def _findings(counts: Mapping[str, int], n_scans: int, relocalized: Sequence[float]) -> Iterator[Finding]:
    def words(n: int) -> dict[str, object]:
        return {"n": n, "t": n_scans, "times": "once" if n == 1 else f"{n} times"}

    def finding(name: str, severity: Severity, text: str, done: str) -> Finding:
        # Found late is not found, as far as it matters.
        named, n = "not-found" if name == "found-late" else name, counts[name]
        return Finding(named, severity, text.format(**words(n)), {"count": float(n)}, do=done)

    yield from (finding(name, *texts) for name, texts in _TEXTS.items() if counts[name])
    if relocalized:
        yield _elsewhere(relocalized)


def _scale_finding(scale: ScaleEstimate | None) -> Iterator[Finding]:
    if scale is not None and abs(scale.mean) > SURE_OF_SCALE * scale.deviation:
        yield from scale_finding(scale.mean)


def _elsewhere(relocalized: Sequence[float]) -> Finding:
    times = ", ".join(f"{second:.1f} s" for second in relocalized)
    return Finding(
        "relocalized",
        "warning",
        "Scans contradicted the filter's place, and agreed clearly better with another on the map, which it took "
        f"{times} after the first scan.",
        {"count": float(len(relocalized)), "first_s": relocalized[0]},
        why="The start was wrong, or the robot was carried, slipped or lost: from then on, until the filter took the "
        "other place, the poses are wrong.",
        do="beamfield trajectory fits the whole drive, and says when the robot was carried or slipped.",
    )
