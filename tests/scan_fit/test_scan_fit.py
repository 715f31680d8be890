"""Scan fit: expectations by sampling, p-values uniform on fresh good scans, wrong poses and silent scans found out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import between
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.sonar import SonarModel
from beamfield.scan_fit.reference import ScanFitReference, calibrate_scan_fit
from beamfield.scan_fit.scan_fit import PROBLEMS, judge_log, judge_scan
from beamfield.scan_fit.statistics import _field_surprise, fit_statistics
from beamfield.scan_fit.surprise import beam_side, beam_surprise
from beamfield.scan_fit.wrong_poses import wrong_poses
from beamfield.sensors import RangeFinder, Scan
from beamfield.simulation.log import simulate_log

PARAMETERS = (
    BeamParameters(0.78, 0.12, 0.03, 0.07, 0.05, 0.6),
    BeamParameters(0.60, 0.01, 0.19, 0.20, 0.014, 0.0, 0.04, 0.013),
    BeamParameters(0.88, 0.07, 0.004, 0.046, 0.08, 0.39, 0.26, 0.135),
)


@pytest.fixture(scope="module")
def model(office, truth) -> BeamModel:
    return BeamModel(office, truth)


@pytest.fixture(scope="module")
def reference(model, drive) -> ScanFitReference:
    return calibrate_scan_fit(model, drive, inputs={"log": {"name": "drive", "sha256": "0"}})


@pytest.fixture(scope="module")
def fresh(office, truth, drive):
    return simulate_log(office, drive.finder, truth, duration=150.0, scan_rate=4.0, seed=77).only_sensor()


def test_an_end_point_of_a_field_loses_what_its_distance_costs():
    """One beam at an obstacle, one 0.3 m before it, one 1.5 m: log of the density at 0 over that there, less 0.5."""
    corridor = OccupancyGrid.from_ros([[0] * 20 + [100]], 0.1)
    for exponent in (1.0, 0.25):
        field = LikelihoodFieldModel(corridor, LikelihoodFieldParameters(0.7, 0.3, 0.2), exponent=exponent, n_beams=2)
        finder = RangeFinder.from_bearings(np.zeros(5), 8.0)
        ranges = np.array([[1.9, 1.6, 0.4, 8.0, np.nan]])
        beams = _field_surprise(field, ranges, np.array([[0.15, 0.05, 0.0]]), finder)
        hit = 0.7 / (0.2 * np.sqrt(2.0 * np.pi))
        peak, near = hit + 0.3 / 8.0, hit * np.exp(-0.5 * 1.5**2) + 0.3 / 8.0
        assert beams.used.tolist() == [[True, True, True, False, False]]
        # The last is log(1.43 / 0.0375) - 0.5 = 3.1.
        wanted = [-0.5, np.log(peak / near) - 0.5, np.log(peak / 0.0375) - 0.5, 0.0, 0.0]
        np.testing.assert_allclose(beams.excess[0], wanted, atol=1e-6)


class TestBeamSurprise:
    @pytest.mark.parametrize("parameters", PARAMETERS, ids=["short", "sharp", "wide"])
    @pytest.mark.parametrize("expected", [0.0, 0.03, 0.3, 3.0, 7.37, 11.97])
    def test_expectations_are_those_of_drawn_readings(self, parameters, expected, rng):
        z_star = np.full(100_000, expected)
        beams = beam_surprise(sample_beams(z_star, 12.0, parameters, rng), z_star, 12.0, parameters)
        for values in (beams.excess, beams.through, beams.short):
            noise = values.std() / np.sqrt(len(values))
            assert abs(values.mean()) < 4.0 * noise + 0.004

    @pytest.mark.parametrize(("z_star", "lambda_short"), [(300.0, 1.0), (900.0, 5.0), (30.0, 0.2)])
    def test_expectations_hold_where_short_readings_are_near_and_the_limit_is_far(self, z_star, lambda_short, rng):
        parameters = BeamParameters(0.6, 0.3, 0.02, 0.08, 0.05, lambda_short)
        drawn = np.full(400_000, z_star)
        beams = beam_surprise(sample_beams(drawn, 1000.0, parameters, rng), drawn, 1000.0, parameters)
        assert abs(beams.excess.mean()) < 4.0 * beams.excess.std() / np.sqrt(len(drawn)) + 0.001

    def test_one_impossible_reading_counts_no_more_than_a_wrong_one(self):
        never_max = BeamParameters(0.9, 0.05, 0.0, 0.05, 0.05, 0.5)
        beams = beam_surprise(np.array([12.0]), np.array([3.0]), 12.0, never_max)
        assert 1.0 < beams.excess[0] < 2.5

    def test_a_missing_return_where_nothing_is_mapped_agrees(self):
        z, z_star = np.array([12.0, 5.0]), np.array([12.0, 12.0])
        beams = beam_surprise(z, z_star, 12.0, PARAMETERS[0])
        assert beams.excess[0] < 0.0 < 0.5 < beams.excess[1]
        assert beam_side(z, z_star, 12.0, PARAMETERS[0]).tolist() == [0, 1]

    def test_sides_are_told_apart(self):
        z = np.array([3.0, 1.0, 5.0, 12.0, np.nan])
        assert beam_side(z, np.full(5, 3.0), 12.0, PARAMETERS[0]).tolist() == [0, 1, 2, 3, -1]

    @pytest.mark.parametrize(("i", "mean", "sigma"), [(0, 3.0, 0.05), (2, 3.26, np.hypot(0.08, 0.135 * 3.0))])
    def test_the_band_of_hits_is_three_sigma_wide_on_either_side(self, i, mean, sigma):
        z = mean + sigma * np.array([-3.05, -2.95, 2.95, 3.05])
        assert beam_side(z, np.full(4, 3.0), 12.0, PARAMETERS[i]).tolist() == [1, 0, 0, 2]


class TestPValue:
    def test_it_is_uniform_on_fresh_good_scans(self, model, reference, fresh):
        p_value = judge_log(model, fresh, reference).p_value
        # Successive scans of a simulated log with independent beams are nearly independent.
        assert kstest(p_value, "uniform").statistic < 0.09
        assert 0.02 < (p_value <= 0.05).mean() < 0.09

    def test_own_scans_are_not_judged_by_their_neighbours(self, model, reference, drive):
        own = judge_log(model, drive, reference, is_own=True).p_value
        assert kstest(own, "uniform").statistic < 0.09
        alone = calibrate_scan_fit(model, drive.select(np.arange(len(drive)) < 200))
        assert np.nanmin(judge_log(model, drive, alone).p_value) >= alone.smallest_p_value

    def test_wrong_poses_do_not_fit(self, model, reference, fresh, office):
        poses = wrong_poses(fresh.poses, np.arange(len(fresh)) // 10, office, np.random.default_rng(3))
        fits = judge_log(model, fresh.with_poses(poses), reference)
        assert (fits.p_value <= 0.05).mean() > 0.9
        assert fits.lost[-100:].mean() > 0.9

    def test_one_scan_gets_what_it_gets_in_the_log(self, model, reference, fresh):
        fits = judge_log(model, fresh, reference)
        for i in (0, 17, 200):
            one = judge_scan(model, fresh.scan(i), fresh.poses[i], reference)
            assert one.p_value == fits.p_value[i]
            assert one.misfit == pytest.approx(fits.statistics.misfit[i], rel=1e-12)
            assert one.problem == ""

    def test_the_worst_scans_fit_worst_though_others_are_compared_with_more_good_ones(self, model, reference, fresh):
        poses = fresh.poses + np.array([0.3, 0.3, 0.0])
        middle = slice(len(fresh) // 2, len(fresh) // 2 + 5)
        poses[middle] += [1.0, 1.0, 0.5]
        fits = judge_log(model, replace(fresh, poses=poses), reference, is_own=True)
        assert fits.p_value[0] < fits.p_value[middle].min()
        assert fits.worst(3).tolist() == np.argsort(-fits.statistics.misfit)[:3].tolist()

    def test_a_missing_wall_goes_through_and_a_crowd_does_not(self, model, fresh):
        i = 40
        scan, pose = fresh.scan(i), fresh.poses[i]
        crowd = Scan(np.where(np.arange(61) < 30, 0.6, scan.ranges), scan.finder)
        expected = model.expected(pose[None, :], scan.finder)[0]
        gone = Scan(np.where(np.arange(61) < 30, np.minimum(expected + 1.5, 9.9), scan.ranges), scan.finder)
        assert judge_scan(model, crowd, pose).short > 0.3 > 0.1 > judge_scan(model, crowd, pose).through
        assert judge_scan(model, gone, pose).through > 0.3 > 0.1 > judge_scan(model, gone, pose).short

    def test_a_group_of_wrong_beams_is_stranger_than_the_same_number_scattered(self, model, fresh):
        pose = fresh.poses[40]
        expected = model.expected(pose[None, :], fresh.finder)[0]
        number = np.arange(61)
        misfit = [
            judge_scan(model, Scan(np.where(wrong, 0.5 * expected, expected), fresh.finder), pose).misfit
            for wrong in (number < 15, number % 4 == 0)
        ]
        assert misfit[0] > 1.3 * misfit[1]


class TestOtherModels:
    def test_likelihood_fields_are_judged_too(self, office, drive, fresh):
        field = LikelihoodFieldModel(office, LikelihoodFieldParameters(0.8, 0.1, 0.1))
        reference = calibrate_scan_fit(field, drive)
        fits = judge_log(field, fresh, reference)
        assert kstest(fits.p_value, "uniform").statistic < 0.12
        assert np.isnan(fits.statistics.through).all()
        poses = wrong_poses(fresh.poses, np.arange(len(fresh)) // 10, office, np.random.default_rng(3))
        assert (judge_log(field, fresh.with_poses(poses), reference).p_value <= 0.05).mean() > 0.8

    def test_sonars_are_judged_too(self, office):
        ring = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 91.0, 20.0)), 5.0, opening_angle=0.4)
        parameters = PARAMETERS[0]
        logs = [simulate_log(office, ring, parameters, duration=80.0, scan_rate=4.0, seed=s) for s in (1, 2)]
        first, second = (log.only_sensor() for log in logs)
        model = SonarModel(office, parameters)
        reference = calibrate_scan_fit(model, first)
        assert kstest(judge_log(model, second, reference).p_value, "uniform").statistic < 0.12

    def test_unknown_space_says_nothing(self, office, truth, drive):
        hidden = replace(office, probability=np.where(office.occupied, np.float32(1.0), np.float32(np.nan)))
        statistics = fit_statistics(BeamModel(hidden, truth), drive.ranges[:5], drive.finder, drive.poses[:5])
        assert (statistics.n_beams == 0).all()
        assert np.isnan(statistics.misfit).all()


class TestWrongPoses:
    def test_each_stretch_is_moved_as_a_whole_and_far_enough(self, office, drive):
        stretch = np.arange(len(drive)) // 20
        wrong = wrong_poses(drive.poses, stretch, office, np.random.default_rng(0), share_near=1.0)
        for number in np.unique(stretch):
            mine = stretch == number
            step, moved = (between(p[mine][:-1], p[mine][1:]) for p in (drive.poses, wrong))
            np.testing.assert_allclose(step, moved, atol=1e-9)
            middle = np.flatnonzero(mine)[mine.sum() // 2]
            off = between(drive.poses[middle], wrong[middle])
            assert np.hypot(*off[:2]) > 0.49 or abs(off[2]) > np.radians(19.9)

    def test_a_map_without_free_cells_is_an_error(self, office, drive):
        solid = replace(office, probability=np.ones((10, 10)))
        with pytest.raises(InvalidInputError, match="no free cell"):
            wrong_poses(drive.poses, np.zeros(len(drive), int), solid, np.random.default_rng(0))


class TestReference:
    def test_it_comes_back_from_json_bit_by_bit(self, model, reference, fresh):
        back = ScanFitReference.from_json(reference.to_json())
        assert back.inputs == {"log": {"name": "drive", "sha256": "0"}}
        assert back.to_json() == reference.to_json()
        first, second = (judge_log(model, fresh, r) for r in (reference, back))
        np.testing.assert_array_equal(first.p_value, second.p_value)
        np.testing.assert_array_equal(first.lost, second.lost)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("{", "Expecting"),
            ("[]", "schema"),
            ('{"schema": "beamfield-scan-fit/1"}', "'evidence' is missing"),
        ],
        ids=["no-json", "no-mapping", "no-entries"],
    )
    def test_a_bad_document_is_refused(self, text, message):
        with pytest.raises(InvalidInputError, match=message):
            ScanFitReference.from_json(text)

    def test_numbers_of_the_wrong_kind_are_refused(self, reference):
        text = reference.to_json().replace('"gap_s": ', '"gap_s": "x", "old": ')
        with pytest.raises(InvalidInputError, match="could not convert"):
            ScanFitReference.from_json(text)

    def test_another_model_is_refused(self, office, reference, fresh):
        with pytest.raises(InvalidInputError, match="another model: lambda_short"):
            judge_scan(BeamModel(office, PARAMETERS[0].__class__(0.8, 0.1, 0.03, 0.07, 0.05, 0.7)), fresh.scan(0),
                     fresh.poses[0], reference)  # fmt: skip

    def test_six_digits_of_the_model_are_enough(self, office, reference, truth, fresh):
        def with_noise(factor):
            return BeamModel(office, replace(truth, sigma_hit=factor * truth.sigma_hit))

        reference.require_model(with_noise(1.0 + 4e-6), fresh.finder.max_range)
        with pytest.raises(InvalidInputError, match="another model: sigma_hit"):
            reference.require_model(with_noise(1.0 + 1e-4), fresh.finder.max_range)

    def test_too_few_good_scans_are_too_little_data(self, model, drive):
        with pytest.raises(TooLittleDataError, match="need 20"):
            calibrate_scan_fit(model, drive.select(np.arange(0, 300, 20)))

    def test_a_log_without_poses_is_refused(self, model, drive):
        with pytest.raises(InvalidInputError, match="reference pose"):
            calibrate_scan_fit(model, drive.with_poses(np.full((len(drive), 3), np.nan)))

    def test_landmarks_have_no_free_space_to_be_lost_in(self, drive, truth):
        with pytest.raises(InvalidInputError, match="occupancy grid"):
            calibrate_scan_fit(SonarModel(LandmarkMap(np.zeros((1, 2))), truth), drive)


class TestBadInput:
    def test_a_scan_without_measurement_is_flagged_never_judged(self, model, reference, fresh):
        fit = judge_scan(model, Scan(np.full(61, np.nan), fresh.finder), fresh.poses[0], reference)
        assert fit.problem == "no measurement"
        assert np.isnan([fit.p_value, fit.misfit, fit.surprise]).all()
        assert fit.n_beams == 0

    def test_poses_off_the_map_and_in_walls_are_flagged(self, model, office, reference, fresh):
        far = judge_scan(model, fresh.scan(0), [1e4, 0.0, 0.0], reference)
        assert far.problem == "off the map"
        assert far.p_value <= 0.05
        row, col = np.argwhere(office.occupied)[100]
        x, y = office.to_map([col + 0.5, row + 0.5])
        assert judge_scan(model, fresh.scan(0), [x, y, 0.0], reference).problem == "inside a wall"

    def test_a_scan_that_sees_only_unknown_space_is_not_said_to_lack_measurements(self, truth):
        room = np.full((40, 40), -1)
        room[20, 20:] = 100
        model = BeamModel(OccupancyGrid.from_ros(room, 0.1), truth)
        scan = Scan([1.0, 2.0], RangeFinder.from_bearings([-0.1, 0.1], max_range=8.0))
        for pose, problem in (([1.0, 1.0, 0.0], "no mapped obstacle in view"), ([-1.0, 1.0, 0.0], "off the map")):
            fit = judge_scan(model, scan, pose)
            assert (fit.n_beams, fit.problem) == (0, problem)

    def test_silent_scans_of_a_log_get_no_p_value_and_no_evidence(self, model, reference, fresh):
        ranges, poses = np.array(fresh.ranges), np.array(fresh.poses)
        ranges[10], poses[20] = np.nan, np.nan
        fits = judge_log(model, replace(fresh, ranges=ranges, poses=poses), reference)
        assert PROBLEMS[fits.problem[10]] == "no measurement"
        assert PROBLEMS[fits.problem[20]] == "no pose"
        assert np.isnan(fits.p_value[[10, 20]]).all()
        assert np.isfinite(fits.lost).all()
        assert set(fits.worst(300)).isdisjoint({10, 20})

    def test_a_pose_that_is_no_number_is_refused(self, model, fresh):
        with pytest.raises(InvalidInputError, match="finite"):
            judge_scan(model, fresh.scan(0), [0.0, np.nan, 0.0])

    def test_shapes_must_fit(self, model, fresh):
        with pytest.raises(InvalidInputError, match="shapes"):
            fit_statistics(model, fresh.ranges, fresh.finder, fresh.poses[:-1])

    def test_an_unknown_kind_of_model_is_refused(self, fresh):
        with pytest.raises(
            InvalidInputError, match="model: expected a RangeMixtureModel or a LikelihoodFieldModel, got"
        ):
            fit_statistics(object(), fresh.ranges, fresh.finder, fresh.poses)  # type: ignore[arg-type]


def test_a_scan_without_beams_says_nothing():
    model = BeamModel(OccupancyGrid.from_ros([[0, 0, 100]], 0.5), BeamParameters(0.7, 0.1, 0.1, 0.1, 0.1, 0.5))
    fit = judge_scan(model, Scan([], RangeFinder.from_bearings([], 5.0)), [0.2, 0.2, 0.0])
    assert (fit.problem, fit.n_beams) == ("no measurement", 0)
    assert np.isnan([fit.misfit, fit.p_value]).all()
