"""Where the world differs from the map: new obstacles, missing walls, glass, and people who pass, place by place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from beamfield.arguments import check_magnitude, checked
from beamfield.calibration.block_errors import share_interval
from beamfield.calibration.selection import Selection, SelectionOptions, select_scans
from beamfield.calibration.time_split import LONGEST_BLOCK_S, block_length
from beamfield.errors import InvalidInputError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.indices import as_indices
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.place_beams import PlaceBeams, judge_beams
from beamfield.scan_fit.place_tallies import Lattice, tally_short, tally_walls
from beamfield.scan_fit.place_visits import Tally, TwoKinds, Visits
from beamfield.sensors import SensorLog
from beamfield.short_repr import short_repr

Kind = Literal["new obstacle", "missing wall", "no return (glass?)", "passing (people)", "undecided"]
KINDS: tuple[Kind, ...] = (
    "new obstacle", "missing wall", "no return (glass?)", "passing (people)", "undecided",
)  # fmt: skip
"""What a place can be; the first three differ from the map for good."""
Reading = Literal["short", "beyond", "no return"]
LASTING: dict[Reading, Kind] = {
    "short": "new obstacle", "beyond": "missing wall", "no return": "no return (glass?)",
}  # fmt: skip
"""What a place is whose readings differ in most visits."""

# A square differs in a visit if so many of its beams do. A table leg fills a fifth of a square.
SHORT_SHARE, WALL_SHARE = 0.1, 0.5
# A sensor that loses many beams does so at all walls: one is glass where so many times as many do not return.
TIMES_Z_MAX = 1.5
# How long somebody stands in one place, and how long an error of the poses lasts: on average, seconds.
STAY_S, POSE_ERROR_S = 30.0, 5.0
# A place differs for good from this probability on, in at least two visits.
SURE = 0.95
# A table lists so many places; JSON has them all.
MOST_LISTED = 12
FEWEST_VISITS = 2
LEVEL = 0.95
NEIGHBOURS = np.ones((3, 3), bool)


@dataclass(frozen=True, eq=False)
class ChangedPlace:
    """One place where readings differ from what the map expects.

    Parameters
    ----------
    kind
        "new obstacle": readings end before the mapped obstacle in most visits; "missing wall": they go beyond it (the
        wall is gone, a door is open, or it is glass that the beams pass); "no return (glass?)": a mapped obstacle from
        which nothing returns (glass, black or shiny surfaces); "passing (people)": an obstacle in few of the visits;
        "undecided": one of these, but only at times (a door), or in too few visits to tell.
    reading
        How its readings differ: "short", "beyond" the mapped obstacle, or "no return".
    x, y
        Middle of the readings that differ, metres in the map frame.
    width, height
        Extent of nine tenths of these readings along x and y, metres.
    rate
        Share of the beams with the chance to tell that differ: short readings that end there over beams that crossed
        the place or ended there; or readings beyond, or without return, over beams that test the mapped surface.
    interval
        95% interval of the rate, from how it varies between visits; (0, 1) for a single visit.
    readings, beams
        The numbers behind the rate.
    visits_changed, visits
        In how many blocks of time the place differed, and in how many it was seen by at least ten beams.
    probability
        That it differs for good (in most visits), given the visits.
    corners
        (m, 2) lower left corners of the squares of `ChangedPlaces.side` that make up the place, metres.
    """

    kind: Kind
    reading: Reading
    x: float
    y: float
    width: float
    height: float
    rate: float
    interval: tuple[float, float]
    readings: int
    beams: int
    visits_changed: int
    visits: int
    probability: float
    corners: FloatArray

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class ChangedPlaces:
    """Result of `find_changed_places`.

    Parameters
    ----------
    places
        In the order of `KINDS`, and those with the most readings first.
    side
        Side of the squares that places are made of, metres.
    reference_error
        How wrong the poses were taken to be, metres.
    n_scans, visit_s
        Scans that were used, and the length of a block of time, seconds.
    findings
        Warnings.
    """

    places: tuple[ChangedPlace, ...]
    side: float
    reference_error: float
    n_scans: int
    visit_s: float
    findings: tuple[Finding, ...]

    __repr__ = short_repr

    def of_kind(self, kind: Kind) -> tuple[ChangedPlace, ...]:
        """Return the places of one kind."""
        return tuple(place for place in self.places if place.kind == kind)

    @property
    def lasting(self) -> tuple[ChangedPlace, ...]:
        """The places that differ from the map for good, those with the most readings first."""
        chosen = (place for kind in KINDS[:3] for place in self.of_kind(kind))
        return tuple(sorted(chosen, key=lambda place: -place.readings))

    def summary(self) -> str:
        """Return how many places there are of each kind, and the worst, as text to print."""
        counts = ", ".join(_counted(len(self.of_kind(kind)), kind) for kind in KINDS)
        lines = [f"places where the world differs from the map: {counts}"]
        if self.lasting:
            lines.append("  kind                   x [m]    y [m]  size [m]    rate  95% interval   visits")
        for place in self.lasting[:MOST_LISTED]:
            size, (low, high) = f"{place.width:.1f} x {place.height:.1f}", place.interval
            lines.append(
                f"  {place.kind:<19s} {place.x:8.2f} {place.y:8.2f}  {size:<10s} {place.rate:5.0%}  "
                f"{low:4.0%} to {high:4.0%}   {place.visits_changed} of {place.visits}"
            )
        if len(self.lasting) > MOST_LISTED:
            lines.append(f"  and {len(self.lasting) - MOST_LISTED} more")
        return "\n".join([*lines, *(finding.full_text for finding in self.findings)])


@checked
def find_changed_places(
    log: SensorLog,
    grid: OccupancyGrid,
    parameters: BeamParameters,
    *,
    scans: ArrayLike | None = None,
    reference_error: float = 0.04,
    block_s: float | None = None,
) -> ChangedPlaces:
    """Find the places where a log's readings differ from the map: where a map is out of date.

    Parameters
    ----------
    log
        Scans of a laser (not a sonar: where in its cone an echo arose is not known) with poses in the map.
    grid
        The map.
    parameters
        The beam model learned for this sensor and map.
    scans
        Indices or a mask (t,) of the scans to use, for example those at which the robot was not lost; None: all. Of
        these, scans of a standing or quickly turning robot are left out, as in calibration.
    reference_error
        How wrong the poses may be: standard deviation per axis in metres, and a quarter of it in radians. What such an
        error explains is not a change.
    block_s
        Length of a block of time, which counts as one visit, seconds; None: 20 s, or a twelfth of a shorter log.

    Returns
    -------
    The places.

    Raises
    ------
    InvalidInputError
        If the sensor is a sonar, the map has no obstacle, no scan has a pose on the map, or an argument is out of
        range.

    Notes
    -----
    - A reading is short if the model does not call it a hit, and its end point lies in free space, farther from every
      mapped obstacle than three standard deviations of pose and range together. A reading is beyond a wall if it is
      longer, by as much, than the expected range of all rays within two standard deviations of the pose. A beam whose
      expected range changes by more within these, as at grazing incidence, says nothing about the wall. Walls are
      glass from which half of the beams do not return, or half as many again as z_max says of all.
    - Visits count, not beams: a person who stands somewhere once makes five hundred readings in one visit, furniture
      some in every visit. How often windows of 0.5 m differ is a mixture of two kinds, learned from all windows that
      beams crossed: those that differ for good, and all others, where what comes may stand still for half a minute. A
      window differs for good if it does so in at least two visits, in at least half of them, and with a probability of
      0.95.
    - Squares of 0.25 m in such windows that adjoin are one place. What is thinner than the tolerance, or as near to a
      mapped obstacle, is not found, and behind glass nobody knows.

    References
    ----------
    Probabilistic Robotics, section 6.3.1: unexpected objects make ranges shorter; section 6.3.3, (6.27): the
    probability of each cause.

    Examples
    --------
    >>> from beamfield.simulation.floor_plan import draw_floor_plan
    >>> from beamfield.simulation.log import simulate_log
    >>> from beamfield.sensors import RangeFinder
    >>> finder = RangeFinder.from_bearings(np.linspace(-1.5, 1.5, 31), max_range=10.0)
    >>> model = BeamParameters(0.9, 0.02, 0.03, 0.05, sigma_hit=0.03, lambda_short=0.5)
    >>> office = draw_floor_plan(seed=3)
    >>> log = simulate_log(office, finder, model, duration=60.0).only_sensor()
    >>> find_changed_places(log, office, model).lasting
    ()
    """
    check_magnitude("reference_error", reference_error)
    if log.finder.opening_angle > 0.0:
        raise InvalidInputError("log: expected a laser; where in a sonar's cone an echo arose is not known")
    chosen = np.arange(len(log)) if scans is None else as_indices(scans, len(log), "scans")
    selection = select_scans(log.select(chosen), grid, SelectionOptions(min_scans=0))
    used = chosen[selection.used]
    lattice, visit_s = Lattice.over(grid), block_length(log.stamps[used], block_s)
    if not len(used):
        return ChangedPlaces((), lattice.side, reference_error, 0, visit_s, (_no_scan(selection),))
    beams = judge_beams(
        log, grid, parameters, used, reference_error=reference_error, longest_error=lattice.side, block_s=visit_s
    )
    silent = max(WALL_SHARE, min(TIMES_Z_MAX * parameters.z_max, 1.0))
    places = [
        place
        for evidence in (
            _Evidence("short", beams, lattice, beams.short, beams.ends, SHORT_SHARE, visit_s / STAY_S),
            _Evidence("beyond", beams, lattice, beams.through, beams.walls, WALL_SHARE, visit_s / POSE_ERROR_S),
            _Evidence("no return", beams, lattice, beams.silent, beams.walls, silent, visit_s / POSE_ERROR_S),
        )
        for place in _places(evidence)
    ]
    places.sort(key=lambda place: (KINDS.index(place.kind), -place.readings))
    findings = tuple(_findings(places, len(np.unique(beams.visit)), visit_s))
    return ChangedPlaces(tuple(places), lattice.side, reference_error, len(used), visit_s, findings)


class _Evidence(NamedTuple):
    """Readings of one kind: which differ, and where; `ages` is how many mean stays a block of time lasts."""

    reading: Reading
    beams: PlaceBeams
    lattice: Lattice
    differ: NDArray[np.bool_]
    points: FloatArray
    least_share: float
    ages: float

    def tally(self, labels: NDArray[np.int32]) -> Tally:
        """Count beams per place and visit; `labels` (rows, cols) is the place of each square, -1 for none."""
        if self.reading == "short":
            return tally_short(self.beams, self.lattice, labels)
        return tally_walls(self.beams, self.lattice, labels, self.differ)


def _places(evidence: _Evidence) -> Iterator[ChangedPlace]:
    """Join squares that differ to places, and say what each is."""
    n = evidence.lattice.rows * evidence.lattice.cols
    shape = evidence.lattice.shape
    from scipy import ndimage  # takes a third of a second to import

    visits = evidence.tally(np.arange(n, dtype=np.int32).reshape(shape)).visits(evidence.least_share)
    sometimes = (visits.counts(n)[0] > 0).reshape(shape)
    if not sometimes.any():
        return
    windows = visits.in_windows(shape[1])
    kinds = TwoKinds.learn(windows, stay=float(np.exp(-evidence.ages)))
    differed, visited = windows.counts(n)
    enough = (differed >= FEWEST_VISITS) & (2 * differed >= visited)
    sure = (enough & (kinds.probability(windows, n) >= SURE)).reshape(shape)
    # Each stands for itself and its neighbours to the right and above.
    lasting = sometimes & ndimage.binary_dilation(sure, np.array([[0, 0, 0], [0, 1, 1], [0, 1, 1]]))
    labels, n_lasting = ndimage.label(lasting, NEIGHBOURS)
    others, n_others = ndimage.label(sometimes & ~lasting, NEIGHBOURS)
    labels = np.where(others > 0, others + n_lasting, labels).astype(np.int32) - 1
    visits = visits.joined(labels.reshape(-1).astype(np.int64))
    probability = kinds.probability(visits, n_lasting + n_others)
    yield from _described(evidence, labels, visits, n_lasting, probability)


def _described(
    evidence: _Evidence, labels: NDArray[np.int32], visits: Visits, n_lasting: int, probability: FloatArray
) -> Iterator[ChangedPlace]:
    tally = evidence.tally(labels)
    differed, visited = visits.counts(len(probability))
    flat, at = labels.reshape(-1), evidence.lattice.squares(evidence.points)
    place_of_beam = np.where(evidence.differ & (at >= 0), flat[np.maximum(at, 0)], -1)
    for number in range(len(probability)):
        mine = tally.place == number
        readings, beams = tally.readings[mine], tally.beams[mine]
        points = evidence.points[place_of_beam == number]
        x, y = points.mean(axis=0).tolist()
        width, height = np.ptp(np.quantile(points, [0.05, 0.95], axis=0), axis=0).tolist()
        yield ChangedPlace(
            kind=_kind(evidence.reading, number < n_lasting, float(probability[number])),
            reading=evidence.reading,
            x=x,
            y=y,
            width=width,
            height=height,
            rate=float(readings.sum() / beams.sum()),
            interval=_rate_interval(readings, beams),
            readings=int(readings.sum()),
            beams=int(beams.sum()),
            visits_changed=int(differed[number]),
            visits=int(visited[number]),
            probability=float(probability[number]),
            corners=evidence.lattice.corners(np.flatnonzero(flat == number)),
        )


def _kind(reading: Reading, lasting: bool, probability: float) -> Kind:
    if lasting:
        return LASTING[reading]
    return "passing (people)" if reading == "short" and probability <= 1.0 - SURE else "undecided"


def _rate_interval(readings: NDArray[np.int64], beams: NDArray[np.int64]) -> tuple[float, float]:
    """Return the interval of a rate from how it varies between visits; never narrower than for independent beams."""
    n_visits, total = len(beams), float(beams.sum())
    if n_visits < 2:
        return 0.0, 1.0
    rate = float(readings.sum()) / total
    if rate >= 1.0:  # as one reading per visit
        return (0.5 * (1.0 - LEVEL)) ** (1.0 / n_visits), 1.0
    variance = n_visits / (n_visits - 1) * float(((readings - rate * beams) ** 2).sum()) / total**2
    wider = float(stdtrit(n_visits - 1, 0.5 + 0.5 * LEVEL)) / 1.959964
    return share_interval(rate, max(variance, rate * (1.0 - rate) / total) * wider**2, 1.0 - LEVEL)


def _no_scan(selection: Selection) -> Finding:
    return Finding(
        "no-usable-scan",
        "warning",
        f"No place could be compared with the map: {selection.describe()}.",
        why="Nothing is known of where the map is wrong.",
        do="Use a log in which the robot drives through the map, with reference poses.",
    )


def _findings(places: list[ChangedPlace], n_visits: int, visit_s: float) -> Iterator[Finding]:
    lasting = [place for place in places if place.kind in KINDS[:3]]
    if lasting:
        counts = {kind: sum(place.kind == kind for place in lasting) for kind in KINDS[:3]}
        worst = max(lasting, key=lambda place: place.readings)
        yield Finding(
            "map-changed",
            "warning",
            f"The world differs from the map in {len(lasting)} place{'s' if len(lasting) > 1 else ''} ("
            + ", ".join(_counted(n, kind) for kind, n in counts.items() if n)
            + f"), most at x {worst.x:.1f} m, y {worst.y:.1f} m.",
            {"n_places": float(len(lasting)), "x": worst.x, "y": worst.y},
            why="Readings there speak against the true pose, and a robot may get lost.",
            do="Update the map in these places, or map the building anew.",
        )
    if visit_s < 0.95 * LONGEST_BLOCK_S:
        yield Finding(
            "short-visits",
            "info",
            f"Visits are blocks of only {visit_s:.3g} s, because the log is short.",
            {"visit_s": visit_s, "n_visits": float(n_visits)},
            why="Somebody who stands still for longer looks like furniture.",
            do=f"Record {12 * LONGEST_BLOCK_S / 60.0:.0f} minutes or more, and pass each place several times.",
        )


def _counted(n: int, kind: Kind) -> str:
    """Return a number of places in words, such as "2 missing walls"; the other kinds have no plural."""
    return f"{n} {kind}{'s' if n != 1 and kind in KINDS[:2] else ''}"
