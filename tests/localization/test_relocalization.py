"""A robot that is elsewhere is searched for beside its filter, which gives way only where another place is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.random.bit_generator import ISeedSequence

from beamfield.errors import InvalidInputError
from beamfield.localization.found import kidnapped
from beamfield.localization.particle_filter import FilterOptions, ParticleFilter
from beamfield.localization.particles import belief_poses
from beamfield.localization.relocalization import Relocalizer
from beamfield.localization.replay import PoseBelief, reference_start
from beamfield.localization.scan_localizer import Localization, ScanLocalizer
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.gaussian_motion import GaussianMotion
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import SensorLog


@pytest.fixture(scope="module")
def localizer(office) -> ScanLocalizer:
    model = LikelihoodFieldModel(office, LikelihoodFieldParameters(0.8, 0.1, 0.1), exponent=0.05)
    return ScanLocalizer(office, model, GaussianMotion(), FilterOptions(n_particles=1000), n_anywhere=20_000)


def run(localizer: ScanLocalizer, log: SensorLog, start: PoseBelief | None = None) -> Localization:
    return localizer.run(log, start or reference_start(log)[1], np.random.default_rng(0))


def off_by(found: Localization, log: SensorLog) -> np.ndarray:
    return np.hypot(*(found.poses - log.poses)[:, :2].T)


def test_a_robot_that_was_carried_elsewhere_is_found_again_and_it_is_said_when(localizer, drive):
    log, first = kidnapped(drive)
    found, without = run(localizer, log), run(replace(localizer, relocalize=False), log)
    assert off_by(found, log)[-20:].max() < 0.5 < off_by(without, log)[-20:].min()
    (finding,) = found.findings
    assert finding.name == "relocalized"
    assert finding.values["count"] == 1
    assert finding.values["first_s"] == pytest.approx(log.stamps[found.searched_from] - log.stamps[0])
    assert first < found.searched_from < len(log)
    assert off_by(found, log)[first : found.searched_from].min() > 0.5
    # The poses from before it was carried are right.
    assert off_by(found, log)[:first].max() < 0.5
    assert finding.text.startswith("Scans contradicted the filter's place, and agreed clearly better with another")
    assert "from then on, until the filter took the other place, the poses are wrong" in finding.why
    assert off_by(found, log)[found.searched_from] < 0.5
    # Lost, it is taken to drive through walls.
    assert [finding.name for finding in without.findings] == ["beyond-map"]


def test_a_wrong_start_is_put_right(localizer, drive):
    start = PoseBelief.around(drive.poses[len(drive) // 2] + [0.0, 0.0, 1.0])
    found = run(localizer, drive, start)
    assert [finding.name for finding in found.findings] == ["relocalized"]
    assert off_by(found, drive)[-20:].max() < 0.5


def test_a_robot_that_is_followed_has_the_same_poses_without(localizer, drive):
    found, without = (run(replace(localizer, relocalize=asked), drive) for asked in (True, False))
    assert np.array_equal(found.poses, without.poses)


def test_what_searches_draw_follows_from_the_state_of_the_source_alone(localizer, drive):
    log, _ = kidnapped(drive)

    class NoChildren(ISeedSequence):
        def generate_state(self, n_words, dtype=np.uint32):
            return np.random.SeedSequence(0).generate_state(n_words, dtype)

    rng = np.random.Generator(np.random.PCG64(NoChildren()))
    state = rng.bit_generator.state
    found = localizer.run(log, reference_start(log)[1], rng)
    rng.bit_generator.state = state
    again = localizer.run(log, reference_start(log)[1], rng)
    assert [finding.name for finding in found.findings] == ["relocalized"]
    assert np.array_equal(found.poses, again.poses)


def among_people(log: SensorLog) -> SensorLog:
    """Return the log with four of five readings shortened in its middle third."""
    rng, ranges = np.random.default_rng(3), np.array(log.ranges)
    middle = slice(len(log) // 3, 2 * len(log) // 3)
    hidden = rng.random(ranges[middle].shape) < 0.8
    ranges[middle] = np.where(hidden, rng.uniform(0.2, 0.7, hidden.shape) * ranges[middle], ranges[middle])
    return replace(log, ranges=ranges)


def test_a_robot_among_people_is_searched_for_but_stays_where_its_filter_says(localizer, drive, truth):
    log, rng = among_people(drive), np.random.default_rng(0)
    beam = BeamModel(localizer.grid, truth, exponent=0.05)

    def make() -> ParticleFilter:
        return ParticleFilter(beam, localizer.motion, localizer.options, rng=rng)

    own, again = make(), Relocalizer(localizer.grid, make, n_anywhere=20_000, rng=1)
    first, start = reference_start(log)
    own.start(belief_poses(start, 1000, rng))
    searching, before = [], own
    for scan, odometry in zip(log[first:], log.odometry[first:], strict=True):
        update = own.update(scan, odometry, scan.stamp)
        own, same = again.follow(own, update, scan, odometry, scan.stamp)
        assert own is before
        assert same is update
        searching.append(again.is_searching)
    assert sum(searching) > 20
    assert not searching[-1]
    assert np.hypot(*(own.pose - log.poses[-1])[:2]) < 0.3


def test_a_place_that_was_found_from_anywhere_is_kept_among_people(localizer, drive, truth):
    beam = BeamModel(localizer.grid, truth, exponent=0.05)
    log = among_people(drive)
    found = replace(localizer, model=beam, n_anywhere=50_000).run(log, None, np.random.default_rng(0))
    assert found.findings == ()
    assert off_by(found, log)[len(log) // 3 :].max() < 0.5


def test_cones_of_a_sonar_are_not_judged(localizer, drive):
    log, _ = kidnapped(drive)
    cones = replace(log, finder=replace(log.finder, opening_angle=0.2))
    assert [finding.name for finding in run(localizer, cones).findings] == ["beyond-map"]


def test_a_map_without_room_is_refused(localizer):
    with pytest.raises(InvalidInputError, match="no free cell"):
        Relocalizer(OccupancyGrid(np.ones((4, 4)), 0.1), lambda: None)
    with pytest.raises(InvalidInputError, match="n_anywhere"):
        Relocalizer(localizer.grid, lambda: None, n_anywhere=0)


def test_what_a_search_needs_is_refused_before_there_is_one(localizer):
    with pytest.raises(InvalidInputError, match=r"grid: .*read_map\(path\) reads one"):
        Relocalizer("map.yaml", lambda: None)
    with pytest.raises(InvalidInputError, match="make: expected a function, got a ParticleFilter"):
        Relocalizer(localizer.grid, ParticleFilter(localizer.model, localizer.motion))
    with pytest.raises(InvalidInputError, match="coarse: expected a MeasurementModel or None, got an OccupancyGrid"):
        Relocalizer(localizer.grid, lambda: None, coarse=localizer.grid)
