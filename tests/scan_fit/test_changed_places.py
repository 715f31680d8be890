"""Changed places: furniture, a removed wall, glass and a person in a room, each found for what it is and where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.changed_places import ChangedPlaces, _rate_interval, find_changed_places
from beamfield.scan_fit.place_beams import judge_beams
from beamfield.scan_fit.place_visits import Tally, TwoKinds, Visits
from beamfield.sensors import RangeFinder, SensorLog

MODEL = BeamParameters(0.9, 0.03, 0.03, 0.04, sigma_hit=0.03, lambda_short=0.5)
LASER = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 90, endpoint=False), 12.0)


def room(*boxes: tuple[float, float, float, float]) -> OccupancyGrid:
    """A room of 8 x 6 m with boxes (x low, y low, x high, y high) in it, cells of 0.1 m."""
    cells = np.zeros((60, 80))
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    for box in boxes:
        col, row, col_end, row_end = (round(10.0 * value) for value in box)
        cells[row:row_end, col:col_end] = 100
    return OccupancyGrid.from_ros(cells, 0.1)


FURNITURE, STUB = (1.5, 4.3, 1.9, 4.7), (6.6, 2.2, 6.8, 3.6)
MAP, WORLD = room(STUB), room(FURNITURE)


def drive(world: OccupancyGrid, duration: float = 240.0) -> SensorLog:
    """Drive round the middle of the room, once in half a minute, two scans a second, with noise of 3 cm."""
    rng = np.random.default_rng(4)
    stamps = np.arange(0.0, duration, 0.5)
    angle = 2.0 * np.pi * stamps / 30.0
    poses = np.column_stack([4.0 + 1.2 * np.cos(angle), 3.0 + 1.2 * np.sin(angle), angle + 0.5 * np.pi])
    ranges = RayCaster(world).expected_ranges(poses, LASER)
    return SensorLog(
        LASER, stamps, ranges + rng.normal(0.0, 0.03, ranges.shape), poses, np.full((len(stamps), 3), np.nan)
    )


def ends(log: SensorLog) -> np.ndarray:
    """Return (t, k, 2) where beams end."""
    rays = compose(log.poses[:, None], log.finder.mounts)
    return rays[..., :2] + log.ranges[..., None] * np.stack([np.cos(rays[..., 2]), np.sin(rays[..., 2])], axis=-1)


def with_glass(log: SensorLog) -> SensorLog:
    """Nothing returns from the lower wall between x = 2.5 and 4 m."""
    x, y = np.moveaxis(ends(log), -1, 0)
    return replace(log, ranges=np.where((y < 0.3) & (x > 2.5) & (x < 4.0), np.inf, log.ranges))


def with_person(log: SensorLog) -> SensorLog:
    """Somebody of 0.4 m stands at (6.5, 1.2) for a quarter of a minute."""
    rays = compose(log.poses[:, None], log.finder.mounts)
    to = np.array([6.5, 1.2]) - rays[..., :2]
    along = to[..., 0] * np.cos(rays[..., 2]) + to[..., 1] * np.sin(rays[..., 2])
    aside = np.hypot(*np.moveaxis(to, -1, 0)) ** 2 - along**2
    there = ((log.stamps > 62.0) & (log.stamps < 77.0))[:, None]
    blocked = there & (along > 0.0) & (aside < 0.04) & (along < log.ranges)
    return replace(log, ranges=np.where(blocked, along - np.sqrt(np.maximum(0.04 - aside, 0.0)), log.ranges))


@pytest.fixture(scope="module")
def changed() -> ChangedPlaces:
    return find_changed_places(with_person(with_glass(drive(WORLD))), MAP, MODEL)


def only(found: ChangedPlaces, kind) -> object:
    (place,) = found.of_kind(kind)
    return place


class TestRoom:
    def test_furniture_is_a_new_obstacle_in_every_visit(self, changed):
        place = only(changed, "new obstacle")
        assert (place.x, place.y) == pytest.approx((1.7, 4.5), abs=0.2)
        assert place.width < 0.6
        assert place.visits_changed == place.visits == 12
        assert place.probability > 0.99
        assert 0.3 < place.interval[0] < place.rate < place.interval[1] <= 1.0
        assert place.readings == round(place.rate * place.beams)

    def test_a_wall_that_is_gone_is_missing(self, changed):
        place = only(changed, "missing wall")
        assert (place.x, place.y) == pytest.approx((6.65, 2.9), abs=0.2)
        assert place.height == pytest.approx(1.3, abs=0.3)
        assert place.rate > 0.95
        assert place.visits_changed == place.visits

    def test_a_wall_without_return_may_be_glass(self, changed):
        place = only(changed, "no return (glass?)")
        assert (place.x, place.y) == pytest.approx((3.25, 0.1), abs=0.15)
        assert place.width == pytest.approx(1.35, abs=0.3)
        assert place.rate > 0.8

    def test_who_stands_there_once_passes_by(self, changed):
        place = only(changed, "passing (people)")
        assert (place.x, place.y) == pytest.approx((6.4, 1.3), abs=0.25)
        assert place.visits_changed <= 2
        assert place.visits >= 10
        assert place.readings > 30
        assert place.probability < 0.01

    def test_squares_of_a_place_hold_its_readings(self, changed):
        for place in changed.places:
            low, high = place.corners.min(axis=0), place.corners.max(axis=0) + changed.side
            assert (low <= (place.x, place.y)).all()
            assert (high >= (place.x, place.y)).all()

    def test_the_worst_are_listed_and_the_findings_say_so(self, changed):
        assert [place.readings for place in changed.lasting] == sorted(
            (p.readings for p in changed.lasting), reverse=True
        )
        assert [finding.name for finding in changed.findings] == ["map-changed"]
        text = changed.summary()
        assert "1 new obstacle, 1 missing wall, 1 no return (glass?), 1 passing (people)" in text
        assert len([line for line in text.splitlines() if line.endswith("12 of 12")]) == 3
        assert changed.findings[0].full_text in text


@pytest.mark.parametrize(
    "error", [(0.0, 0.0, 0.0), (0.06, -0.05, 0.015), (-0.05, 0.06, -0.015)], ids=["exact", "a", "b"]
)
def test_a_room_as_mapped_has_no_changed_places_though_poses_are_off(error):
    log = drive(room(STUB, FURNITURE))
    found = find_changed_places(log.with_poses(log.poses + error), room(STUB, FURNITURE), MODEL)
    assert found.lasting == ()
    assert found.findings == ()


def test_a_larger_error_of_the_poses_is_tolerated_only_where_it_is_stated():
    log = drive(room(STUB))
    off = log.with_poses(log.poses + np.array([0.25, 0.2, 0.0]))
    assert find_changed_places(off, MAP, MODEL).lasting
    assert not find_changed_places(off, MAP, MODEL, reference_error=0.15).lasting


def test_maps_and_poses_that_move_together_change_nothing(changed):
    turn = (3.0, -2.0, np.pi / 2)
    log = with_person(with_glass(drive(WORLD)))
    moved = find_changed_places(log.with_poses(compose(turn, log.poses)), replace(MAP, origin=np.array(turn)), MODEL)
    assert [place.kind for place in moved.places] == [place.kind for place in changed.places]
    for one, other in zip(moved.places, changed.places, strict=True):
        assert (one.x, one.y) == pytest.approx((3.0 - other.y, -2.0 + other.x), abs=0.05)
        assert one.readings == pytest.approx(other.readings, rel=0.1)


def test_walls_from_which_as_many_beams_do_not_return_as_elsewhere_are_no_glass():
    log = with_glass(drive(MAP))
    lost = np.random.default_rng(1).random(log.ranges.shape) < 0.6
    sparse = replace(log, ranges=np.where(lost, np.inf, log.ranges))
    model = replace(MODEL, z_hit=0.36, z_max=0.57)
    place = only(find_changed_places(sparse, MAP, model), "no return (glass?)")
    assert (place.x, place.y) == pytest.approx((3.25, 0.05), abs=0.3)
    assert place.rate > 0.9


def test_one_visit_is_too_few():
    found = find_changed_places(drive(WORLD, 20.0), MAP, MODEL, block_s=20.0)
    assert found.lasting == found.findings == ()
    assert {place.reading for place in found.of_kind("undecided")} >= {"short", "beyond"}
    (short,) = find_changed_places(drive(WORLD, 20.0), MAP, MODEL, block_s=18.9).findings
    assert (short.name, short.values["visit_s"], short.values["n_visits"]) == ("short-visits", 18.9, 2.0)
    assert "Record 4 minutes or more" in short.do
    assert all(place.interval == (0.0, 1.0) for place in found.places)


def test_only_the_given_scans_count():
    log = drive(WORLD)
    assert find_changed_places(log, MAP, MODEL, scans=log.stamps < 100.0).n_scans == 200
    assert find_changed_places(log, MAP, MODEL, scans=[0, 30, 60]).n_scans == 3


def test_a_robot_that_only_spins_cannot_tell():
    log = drive(WORLD, 20.0)
    spinning = log.with_poses(np.column_stack([log.poses[:, :2], 1.5 * np.arange(len(log))]))
    found = find_changed_places(spinning, MAP, MODEL)
    assert found.places == ()
    assert [finding.name for finding in found.findings] == ["no-usable-scan"]
    assert "turning too fast" in found.summary()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reference_error": 0.0}, "reference_error"),
        ({"block_s": -1.0}, "block_s"),
        ({"scans": np.zeros(3, bool)}, "scans"),
        ({"scans": []}, "no scan has a reference pose"),
        ({"grid": OccupancyGrid(np.zeros((60, 80)), 0.1)}, "no occupied cell"),
    ],
    ids=["error", "block", "mask", "none", "empty-map"],
)
def test_bad_input_is_named(change, message):
    arguments = {"log": drive(WORLD, 10.0), "grid": MAP, "parameters": MODEL} | change
    with pytest.raises(InvalidInputError, match=message):
        find_changed_places(**arguments)


def test_a_sonar_is_refused():
    log = drive(WORLD, 5.0)
    with pytest.raises(InvalidInputError, match="sonar"):
        find_changed_places(replace(log, finder=replace(LASER, opening_angle=0.3)), MAP, MODEL)


def test_each_beam_is_judged_by_hand():
    """One pose, four beams: as mapped, short of the wall, beyond the stub, no return from the stub."""
    finder = RangeFinder.from_bearings([np.pi, 2.5, 0.0, 0.1], 12.0)
    pose = np.array([[4.0, 3.0, 0.0]])
    log = SensorLog(finder, [0.0], [[3.9, 1.5, 3.9, np.inf]], pose, pose)
    beams = judge_beams(log, MAP, MODEL, np.array([0]), reference_error=0.04, longest_error=0.25, block_s=1.0)
    assert beams.short.tolist() == [False, True, False, False]
    assert beams.tested.tolist() == [True, False, True, True]
    assert beams.through.tolist() == [False, False, True, False]
    assert beams.silent.tolist() == [False, False, False, True]
    assert beams.followed.tolist() == [3.9, 1.5, 3.9, 0.0]
    np.testing.assert_allclose(beams.ends[1], [4.0 + 1.5 * np.cos(2.5), 3.0 + 1.5 * np.sin(2.5)])
    np.testing.assert_allclose(beams.walls[2], [6.6, 3.0])


class TestVisits:
    def test_the_mixture_is_learned_back_and_its_probability_is_reliable(self, rng):
        """6000 places in 10 visits: 5% differ in 85% of them, others in 2%, where a third stays with 0.6 a block."""
        n, v = 6000, 10
        lasting = rng.random(n) < 0.05
        differs = rng.random((n, v)) < np.where(lasting, 0.85, 0.02)[:, None]
        for i in range(1, v):
            differs[:, i] |= ~lasting & differs[:, i - 1] & (rng.random(n) < 0.3 * 0.6)
        place, visit = np.divmod(np.arange(n * v), v)
        few = rng.random(n * v) < 0.4  # most places are visited a few times only
        visits = Visits(place[few], visit[few], differs.ravel()[few])
        kinds = TwoKinds.learn(visits, stay=0.6)
        assert kinds.share == pytest.approx(0.05, abs=0.01)
        assert kinds.lasting == pytest.approx(0.85, abs=0.03)
        assert kinds.passing == pytest.approx(0.02, abs=0.004)
        probability = kinds.probability(visits, n)
        for low, high in ((0.0, 0.05), (0.05, 0.5), (0.5, 0.95), (0.95, 1.0)):
            mine = (probability >= low) & (probability <= high)
            assert lasting[mine].mean() == pytest.approx(probability[mine].mean(), abs=0.1)

    def test_nothing_that_lasts_is_learned_from_people(self, rng):
        visits = Visits(np.repeat(np.arange(3000), 6), np.tile(np.arange(6), 3000), rng.random(18000) < 0.02)
        kinds = TwoKinds.learn(visits, stay=0.5)
        assert kinds.share < 0.001
        assert (kinds.probability(visits, 3000) > 0.95).sum() <= 1

    def test_who_comes_anew_in_a_crowd_is_not_taken_for_somebody_who_stands(self, rng):
        lasting = np.repeat(rng.random(3000) < 0.03, 4)
        differs = rng.random(12000) < np.where(lasting, 0.85, 0.15)
        visits = Visits(np.repeat(np.arange(3000), 4), np.tile(np.arange(4), 3000), differs)
        assert TwoKinds.learn(visits, stay=0.8).standing < 0.1

    def test_a_visit_needs_beams_and_a_place_differs_by_share(self):
        tally = Tally(*(np.array(c) for c in ([0, 0, 0, 0], [0, 1, 2, 3], [9, 10, 100, 100], [9, 2, 9, 10])))
        visits = tally.visits(0.1)
        assert visits.visit.tolist() == [1, 2, 3]
        assert visits.differs.tolist() == [True, False, True]

    def test_a_window_differs_if_one_of_its_squares_does(self):
        """A lattice of 3 columns; the square in the middle of its second row differs in visit 5."""
        visits = Visits(np.array([4, 8]), np.array([5, 5]), np.array([True, False]))
        windows = visits.in_windows(3)
        assert dict(zip(windows.place.tolist(), windows.differs.tolist(), strict=True)) == {
            0: True, 1: True, 3: True, 4: True, 5: False, 7: False, 8: False,
        }  # fmt: skip

    def test_gaps_count_from_the_visit_before_if_the_place_differed_then(self):
        visits = Visits(np.array([1, 0, 0, 0, 0]), np.array([9, 8, 2, 3, 5]), np.array([1, 1, 1, 0, 1], bool))
        assert visits.gaps.tolist() == [np.inf, 3.0, np.inf, 1.0, np.inf]


def test_intervals_of_rates_hold_the_truth(rng):
    """Rates of 0.3 that vary from visit to visit, in 5 to 12 visits of 20 to 200 beams."""
    held, n = 0, 400
    for _ in range(n):
        beams = rng.integers(20, 200, rng.integers(5, 13))
        low, high = _rate_interval(rng.binomial(beams, rng.beta(3.0, 7.0, len(beams))), beams)
        held += low <= 0.3 <= high
    assert 0.90 <= held / n <= 0.995
    assert _rate_interval(np.array([5]), np.array([7])) == (0.0, 1.0)
    low, high = _rate_interval(np.array([5, 5, 5]), np.array([5, 5, 5]))
    assert (low, high) == pytest.approx((0.025 ** (1 / 3), 1.0))
