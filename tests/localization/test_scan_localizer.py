"""A filter run over whole logs: simulated ones with exact truth, and broken ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import between
from beamfield.io.read_map import read_map
from beamfield.localization.mapped_area import MappedArea
from beamfield.localization.particle_filter import FilterOptions
from beamfield.localization.recovery import Recovery
from beamfield.localization.replay import PoseBelief, judge_replay, reference_start
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.gaussian_motion import USUAL_MOTION, GaussianMotion
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.log import simulate_log
from tests.real.posed_logs import wean_log


@pytest.fixture(scope="module")
def localizer(office) -> ScanLocalizer:
    model = LikelihoodFieldModel(office, LikelihoodFieldParameters(0.8, 0.1, 0.1), exponent=0.05)
    return ScanLocalizer(office, model, GaussianMotion(), FilterOptions(n_particles=1000))


def run(localizer: ScanLocalizer, log: SensorLog, start="reference", seed=0):
    start = reference_start(log)[1] if start == "reference" else start
    return localizer.run(log, start, np.random.default_rng(seed))


def test_a_simulated_robot_is_followed_and_its_truth_lies_in_the_cloud(localizer, drive):
    found = run(localizer, drive)
    assert repr(found).startswith("Localization(poses=<")
    errors = judge_replay(found, drive.poses)
    assert errors.mean < 0.08
    assert errors.inside > 0.9
    assert not errors.lost


def test_the_beam_model_follows_it_as_well(localizer, drive, truth):
    model = BeamModel(localizer.grid, truth, n_beams=20, exponent=0.1)
    errors = judge_replay(run(replace(localizer, model=model), drive[:240]), drive.poses[:240])
    assert errors.mean < 0.08
    assert not errors.lost


def test_a_crowd_hardly_moves_it(localizer, office, truth):
    crowd = BeamParameters(0.35, 0.60, 0.02, 0.03, sigma_hit=0.05, lambda_short=0.3)
    finder = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 91), 10.0)
    log = simulate_log(office, finder, crowd, duration=60.0, scan_rate=5.0, seed=2, dependence=Dependence(0.3, 1.0))
    log = log.only_sensor()
    found = run(localizer, log)
    # With all readings it is 0.29 m.
    assert judge_replay(found, log.poses).mean < 0.15
    assert "moving-objects" in {one.name for one in found.findings}
    # A model that explains short readings has use for them.
    beams = replace(localizer, model=BeamModel(office, truth, n_beams=20, exponent=0.1))
    assert "moving-objects" not in {one.name for one in run(beams, log[:40]).findings}


def test_the_same_seed_gives_the_same_bits(localizer, drive):
    first, again, other = (run(localizer, drive[:60], seed=seed) for seed in (1, 1, 2))
    for name in ("poses", "updates", "means", "covariances", "particles"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.poses, other.poses)


def test_what_is_published_between_updates_is_the_last_belief_moved_on(localizer, drive):
    seen = {}
    found = localizer.run(
        drive[:80],
        reference_start(drive)[1],
        np.random.default_rng(0),
        watch=lambda i, update: seen.update({i: update}),
    )
    assert list(seen) == found.updates.tolist()
    assert len(seen) < 60
    for k, i in enumerate(found.updates):
        assert found.poses[i] == pytest.approx(seen[i].belief.best_cluster.pose)
        assert found.means[k] == pytest.approx(seen[i].belief.whole.pose)
        assert found.particles[k] == len(seen[i].belief)
    assert len(found.seconds) == len(found.updates)


def broken(log: SensorLog, **columns) -> SensorLog:
    changed = {}
    for name, change in columns.items():
        array = np.array(getattr(log, name))
        changed[name] = change(array)
        if changed[name] is None:
            changed[name] = array
    return replace(log, **changed)


def test_reset_odometry_gaps_and_repeated_scans_are_said_and_survived(localizer, drive):
    log = drive[:240]
    cases = {
        "odometry-jumps": broken(
            log, odometry=lambda a: a.__setitem__(slice(100, None), a[100:] + np.array([40.0, -7.0, 0.0]))
        ),
        "no-odometry": broken(log, odometry=lambda a: a.__setitem__(slice(50, 70), np.nan)),
        "stamps-back": broken(log, stamps=lambda a: a - 1000.0 * (np.arange(len(a)) > 90)),
        "repeated-scans": log[np.repeat(np.arange(240), 2)],
    }
    for name, bad in cases.items():
        found = run(localizer, bad)
        assert [finding.name for finding in found.findings] == [name]
        assert found.findings[0].do
        errors = judge_replay(found, bad.poses)
        assert errors.mean < 0.12, name
        assert not errors.lost
        known = np.isfinite(bad.odometry).all(axis=1)
        assert np.array_equal(np.isfinite(found.poses).all(axis=1), known)
    assert run(localizer, log).findings == ()


def test_a_scan_that_comes_twice_is_used_once_its_odometry_is_known(localizer, drive):
    twice = drive[np.repeat(np.arange(40), 2)]
    odometry = twice.odometry.copy()
    odometry[::2] = np.nan
    found, once = run(localizer, replace(twice, odometry=odometry)), run(localizer, drive[:40])
    assert (found.updates // 2).tolist() == once.updates.tolist()
    assert [finding.name for finding in found.findings] == ["no-odometry"]


def test_scans_that_are_impossible_everywhere_are_said(localizer, drive):
    sure = LikelihoodFieldModel(localizer.grid, LikelihoodFieldParameters(1.0, 0.0, 0.001))
    found = run(replace(localizer, model=sure), drive[:20])
    assert found.findings[0].name == "impossible-scans"
    assert np.isfinite(found.poses).all()


def test_a_log_without_odometry_and_a_map_without_room_are_refused(localizer, drive):
    with pytest.raises(TooLittleDataError, match="odometry"):
        run(localizer, replace(drive, odometry=np.full((len(drive), 3), np.nan)))
    solid = replace(localizer, grid=OccupancyGrid(np.ones((4, 4)), 0.1))
    with pytest.raises(InvalidInputError, match="no free cell"):
        run(solid, drive[:5], start=None)
    with pytest.raises(InvalidInputError, match="source"):
        replace(localizer, options=FilterOptions(recovery=Recovery()))
    cut_short = run(replace(localizer, n_anywhere=20_000), drive[:2], start=None)
    assert [finding.name for finding in cut_short.findings] == ["not-found"]
    assert "sure of no place" in cut_short.findings[0].text
    with pytest.raises(InvalidInputError, match="n_anywhere"):
        replace(localizer, n_anywhere=0)


def test_a_start_off_the_map_does_not_stop_the_filter(localizer, drive):
    found = run(localizer, drive[:40], start=PoseBelief.around([500.0, 500.0, 0.0]))
    assert np.isfinite(found.poses).all()
    assert len(found.updates) > 5


def test_a_place_that_scans_contradict_is_given_up_and_the_robot_found_elsewhere(localizer, drive):
    class Misleading:
        """Sure of a wrong place at the first scan; a field from then on."""

        is_normalized = False
        elsewhere = drive.poses[0] + [3.0, 1.0, 2.0]

        def log_likelihood(self, z, poses):
            if z.stamp == drive.stamps[0]:
                return -50.0 * np.abs(between(self.elsewhere, poses)).sum(axis=1)
            return localizer.model.log_likelihood(z, poses)

    options = FilterOptions(n_particles=1000, least_effective=0.0)
    found = run(replace(localizer, options=options, coarse=Misleading(), n_anywhere=50_000), drive, start=None)
    assert [finding.name for finding in found.findings] == ["searched-again"]
    off = np.hypot(*(found.poses - drive.poses)[:, :2].T)
    assert off[: found.searched_from].mean() > 1.0
    assert off[-50:].max() < 0.3


def test_a_robot_that_is_found_late_is_told_from_one_that_is_not_found(localizer, drive):
    found = run(replace(localizer, n_anywhere=20_000), drive, start=None)
    first = found.updates[np.trace(found.covariances[:, :2, :2], axis1=1, axis2=2) < 0.1][0]
    last = found.updates[found.updates > first][4]
    (late,) = run(replace(localizer, n_anywhere=20_000), drive[: last + 1], start=None).findings
    assert late.name == "not-found"
    assert late.text.startswith("The filter is sure of its place, but only for the last ")
    assert 1 <= late.values["count"] < 12


def test_guesses_before_the_robot_is_found_are_no_drives_beyond_the_map(localizer, drive, monkeypatch):
    judged = []

    def is_beyond(area, poses):
        judged.append(poses)
        return area_is_beyond(area, poses)

    area_is_beyond = MappedArea.is_beyond
    monkeypatch.setattr(MappedArea, "is_beyond", is_beyond)
    found = run(replace(localizer, n_anywhere=20_000), drive, start=None)
    narrow = (found.covariances[:, [0, 1], [0, 1]].sum(axis=1) <= 0.25) & (found.covariances[:, 2, 2] <= 0.25)
    first = found.updates[narrow][0]
    assert first > 0
    np.testing.assert_array_equal(judged[-1], found.poses[first:])


@pytest.mark.real
def test_wean_hall_is_followed_and_found_from_anywhere_though_a_wrong_place_fits_better_for_a_minute(data):
    grid, log = read_map(data / "wean_hall/derived_wean.yaml"), wean_log(data, 5)
    log = log[reference_start(log)[0] :]
    # As learned on log 1.
    model = LikelihoodFieldModel(grid, LikelihoodFieldParameters(0.87, 0.12, 0.066), n_beams=60, exponent=0.072)
    localizer = ScanLocalizer(grid, model, USUAL_MOTION)
    errors = judge_replay(run(localizer, log), log.poses)
    assert errors.mean < 0.12
    assert not errors.lost
    found, too_sure = run(localizer, log, start=None), run(replace(localizer, coarse=model), log, start=None)
    off, astray = (np.hypot(*(one.poses - log.poses)[:, :2].T) for one in (found, too_sure))
    sure = np.trace(found.covariances[:, :2, :2], axis1=1, axis2=2) < 0.5**2
    assert found.updates[sure][0] > 0.5 * len(log)
    assert np.nanmax(off[found.updates][sure]) < 0.6
    # For ten scans only, which proves nothing; the wrong place is not told by its readings, but leads beyond the map.
    assert [finding.name for finding in found.findings] == ["not-found"]
    assert "only for the last 10 scans used" in found.findings[0].text
    assert [finding.name for finding in too_sure.findings] == ["beyond-map"]
    assert np.nanmin(astray[len(log) // 2 :]) > 5.0
