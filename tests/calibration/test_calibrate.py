from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.calibration import cross_fit, hit_forms
from beamfield.calibration.beam_table import build_beam_table
from beamfield.calibration.calibrate import Calibration, CalibrationOptions, calibrate
from beamfield.calibration.cross_fit import build_cross_fit_maps
from beamfield.calibration.pose_refinement import refine_poses, refinement_findings
from beamfield.calibration.selection import select_scans
from beamfield.calibration.time_split import held_out_mask, time_blocks
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import between, compose, interpolate_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.report.text_table import readings_line
from beamfield.report.verdict import verdict, verdict_level
from beamfield.simulation.floor_plan import draw_floor_plan
from tests.threads import forced_threads

OPTIONS = CalibrationOptions()


@pytest.fixture(scope="session")
def result(drive, office) -> Calibration:
    return calibrate(drive, office, OPTIONS)


def names(calibration: Calibration) -> list[str]:
    return [finding.name for finding in calibration.findings]


def test_the_true_parameters_come_back_within_their_intervals(result, truth):
    for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short"):
        low, high = result.intervals.intervals[name]
        assert low <= getattr(truth, name) <= high, name
        assert high > low, name


def test_a_log_without_offset_or_slope_keeps_the_chapters_form(result):
    chosen = [c.name for c in result.candidates if c.chosen]
    assert chosen == ["chapter"]
    assert [c.name for c in result.candidates] == [
        "chapter", "sigma slope", "range offset", "range offset + sigma slope",
    ]  # fmt: skip
    assert result.parameters.range_offset == result.parameters.sigma_slope == 0.0


def test_the_fit_beats_the_defaults_on_held_out_beams(result):
    assert [s.name for s in result.scores] == ["fit", "nav2 defaults", "ROS 1 defaults", "uniform"]
    assert all(s.behind_fit > 3 * s.behind_fit_se for s in result.scores[1:])


def test_fit_and_held_out_blocks_share_no_block_of_time(result):
    blocks = time_blocks(result.table.stamps)
    assert not set(blocks[result.held_out]) & set(blocks[~result.held_out])
    assert result.n_fit == (~result.held_out & ~result.table.hits_nothing).sum()


def test_the_pit_of_simulated_beams_is_uniform(result):
    assert result.pit_deviation < 0.02


def test_a_good_log_gives_no_warning_about_map_or_poses(result):
    assert not {"walls-too-thick", "map-scale", "reference-slides", "pose-in-wall", "pose-error-in-sigma"} & set(
        names(result)
    )


def test_every_beam_of_the_used_scans_is_accounted_for(result, drive):
    used = int(result.selection.used.sum()) * drive.finder.n_beams
    assert len(result.table) + result.table.n_no_measurement + result.table.n_unknown == used


def test_the_same_seed_gives_the_same_result_on_any_number_of_threads_and_progress_stage_by_stage(
    result, drive, office
):
    seen: list[tuple[str, int, int]] = []
    with forced_threads(2):
        again = calibrate(drive, office, OPTIONS, progress=lambda *step: seen.append(step))
    assert again.parameters == result.parameters
    assert again.intervals.intervals == result.intervals.intervals
    np.testing.assert_array_equal(again.pit, result.pit)
    stages = list(dict.fromkeys(stage for stage, _, _ in seen))
    assert stages == ["casting rays", "learning", "intervals", "refining poses"]
    for stage in stages:
        steps = [(done, total) for name, done, total in seen if name == stage]
        assert steps[-1][0] == steps[-1][1]


def test_a_range_offset_is_found_and_kept_whatever_its_form_is_called(drive, office, truth, monkeypatch):
    monkeypatch.setattr(hit_forms, "_form_name", lambda *_: "a form")
    shifted = np.where(np.isfinite(drive.ranges), drive.ranges + 0.08, drive.ranges)
    log = replace(drive, ranges=shifted)
    found = calibrate(log, office, replace(OPTIONS, refine=False))
    assert found.parameters.range_offset == pytest.approx(0.08, abs=0.01)
    low, high = found.intervals.intervals["range_offset"]
    assert 0.0 < low < 0.08 < high
    assert found.parameters.sigma_hit == pytest.approx(truth.sigma_hit, rel=0.1)
    off = calibrate(log, office, replace(OPTIONS, refine=False, range_offset="off", sigma_slope="off"))
    assert len(off.candidates) == 1
    assert off.parameters.range_offset == 0.0
    assert off.scores[0].log_likelihood < found.scores[0].log_likelihood


def test_poses_that_are_off_are_found_and_said_to_raise_sigma(drive, office, rng):
    noise = np.column_stack([rng.normal(0, 0.08, (len(drive), 2)), rng.normal(0, 0.01, len(drive))])
    log = drive.with_poses(compose(drive.poses, noise))
    found = calibrate(log, office, OPTIONS)
    (finding,) = (one for one in found.findings if one.name == "pose-error-in-sigma")
    assert "that beamfield trajectory writes: --poses takes them" in finding.do
    # A fit to maps drawn from the log leaves beams out that count here: its sigma_hit is the smaller one.
    (finding,) = (one for one in refinement_findings(found.refinement, drawn=True) if one.name == "pose-error-in-sigma")
    assert "Use the smaller sigma_hit" not in finding.do
    assert found.refinement.sigma_after < 0.8 * found.refinement.sigma_before
    moved = np.hypot(*found.refinement.shifts[:, :2].T)
    assert np.median(moved) == pytest.approx(0.08 * np.sqrt(np.log(4)), rel=0.35)


def test_reference_poses_that_are_late_are_found_and_timed(drive, office, truth):
    late = interpolate_poses(drive.stamps, drive.poses, drive.stamps - 0.15)
    scans = np.arange(4, len(drive), 4)
    refined = refine_poses(drive.with_poses(late), office, scans, truth)
    assert refined.delay == pytest.approx(0.15, abs=0.03)
    finding = next(f for f in refinement_findings(refined) if f.name == "stamps-skewed")
    assert "0.15 s older" in finding.text or "0.14 s older" in finding.text


def test_refinement_leaves_true_poses_where_they_are(drive, office, truth):
    scans = np.arange(0, len(drive), 10)
    refined = refine_poses(drive, office, scans, truth)
    assert np.median(np.hypot(*refined.shifts[:, :2].T)) < 0.03
    (finding,) = refinement_findings(refined)
    assert finding.severity == "info"


def test_a_map_at_the_wrong_scale_is_found(drive, office):
    wrong = OccupancyGrid(office.probability, office.resolution * 0.97, office.origin * 0.97)
    log = drive.with_poses(drive.poses * np.array([0.97, 0.97, 1.0]))
    assert "map-scale" in names(calibrate(log, wrong, replace(OPTIONS, refine=False)))


def test_a_map_of_another_place_is_said_to_be_useless(drive):
    elsewhere = draw_floor_plan(seed=11)
    turned = compose([15.0, 0.0, 1.3], between(drive.poses[0], drive.poses))
    found = calibrate(drive.with_poses(turned), elsewhere, replace(OPTIONS, refine=False))
    assert {"map-says-nothing", "poses-off-map"} <= set(names(found))
    assert verdict(found).startswith("Do not use these values yet: the readings do not fit this map")
    assert verdict_level(found) == "bad"


def test_the_verdict_on_a_good_fit_is_good(result):
    assert verdict_level(result) in ("good", "care")
    assert verdict(result).startswith("The fit beats nav2's defaults")


def test_a_held_parameter_stays(drive, office):
    found = calibrate(drive, office, replace(OPTIONS, hold={"z_rand": 0.1}, refine=False))
    assert found.parameters.z_rand == pytest.approx(0.1, abs=1e-12)
    assert "z_rand" not in found.intervals.intervals


def test_a_map_without_obstacles_is_refused(drive):
    empty = OccupancyGrid(np.zeros((400, 800)), 0.05)
    with pytest.raises(InvalidInputError, match="no occupied cell"):
        calibrate(drive, empty, OPTIONS)


def test_a_log_far_too_short_is_too_little_data(drive, office):
    with pytest.raises(TooLittleDataError, match=r"beams in the fit blocks, need 500.*scans used"):
        calibrate(drive.select(np.arange(0, len(drive), 40)), office, OPTIONS)


def test_readings_without_a_measurement_do_not_vanish_from_z_max_in_silence(drive, office, rng, result):
    """A sensor that writes NaN where nothing came back."""
    ranges = drive.ranges.copy()
    ranges[rng.random(ranges.shape) < 0.26] = np.nan
    finder = replace(drive.finder, min_range=0.6)
    found = calibrate(replace(drive, ranges=ranges, finder=finder), office, replace(OPTIONS, refine=False))
    (nan,) = (finding for finding in found.findings if finding.name == "nan-readings")
    assert nan.severity == "warning"
    assert nan.values["share"] == pytest.approx(0.26, abs=0.01)
    assert "z_max" in nan.why
    assert found.table.n_nan == np.isnan(ranges[found.selection.used]).sum()
    assert found.table.n_too_close == (ranges[found.selection.used] < 0.6).sum() > 0
    assert found.table.n_readings == ranges[found.selection.used].size
    assert f"{found.table.n_nan:,} (26." in readings_line(found)
    assert "nan-readings" not in names(result)


def test_too_little_to_draw_maps_from_does_not_ask_about_a_map_that_was_not_given(drive, monkeypatch):
    sparse = drive.select(np.arange(0, len(drive), 12))
    monkeypatch.setattr(cross_fit, "GROUP_SCANS", 1)
    with pytest.raises(TooLittleDataError, match="give a map") as error:
        calibrate(sparse, build_cross_fit_maps(sparse), OPTIONS)
    assert "is it the map of this place" not in str(error.value)


def test_a_map_in_which_most_rays_hit_nothing_is_asked_about(drive, office):
    elsewhere = np.zeros(office.shape)
    elsewhere[0, 0] = 1.0
    with pytest.raises(TooLittleDataError, match=r"hit nothing; is it the map of this place, and are the poses in its"):
        calibrate(drive, OccupancyGrid(elsewhere, office.resolution, office.origin), OPTIONS)
    with pytest.raises(TooLittleDataError) as error:
        calibrate(drive.select(np.arange(0, len(drive), 40)), office, OPTIONS)
    assert "?" not in str(error.value)


def test_a_first_reading_without_return_among_the_held_out_ones_blames_neither_map_nor_forms(drive, office):
    used = select_scans(drive, office).used
    fitted = np.zeros(len(drive), bool)
    fitted[used] = ~held_out_mask(drive.stamps[used])
    returned = np.where(fitted[:, None] & (drive.ranges >= drive.finder.max_range), np.nan, drive.ranges)
    found = calibrate(replace(drive, ranges=returned), office, replace(OPTIONS, refine=False))
    assert found.parameters.z_max == 0.0
    assert found.scores[0].log_likelihood == -np.inf
    assert found.scores[0].behind_fit == 0.0
    assert np.isfinite([candidate.gain for candidate in found.candidates]).all()
    assert "fit-not-better" in names(found)
    assert "map-says-nothing" not in names(found)


@pytest.mark.parametrize(
    ("option", "value"), [("unknown", "wall"), ("range_offset", "yes"), ("sigma_slope", "1"), ("seed", -1)]
)
def test_options_that_do_not_exist_are_refused_by_name_and_value(option, value):
    with pytest.raises(InvalidInputError, match=rf"{option}.*{value}"):
        CalibrationOptions(**{option: value})


class TestBeamTable:
    def test_rows_are_the_beams_of_the_chosen_scans_in_order(self, drive, office):
        table = build_beam_table(drive, office, [3, 10], unknown="free")
        assert set(table.scan) == {3, 10}
        row = int(np.flatnonzero((table.scan == 10) & (table.beam == 20))[0])
        assert table.ranges[row] == min(drive.ranges[10, 20], 10.0)
        assert table.stamps[row] == drive.stamps[10]
        expected = RayCaster(office).expected_ranges(drive.poses[10], drive.finder)[20]
        assert table.expected_ranges[row] == expected

    def test_no_measurement_and_too_close_are_left_out_and_counted(self, drive, office):
        ranges = drive.ranges.copy()
        ranges[0, :5] = np.nan
        ranges[0, 5] = -np.inf
        table = build_beam_table(replace(drive, ranges=ranges), office, [0], unknown="free")
        assert table.n_no_measurement == 6
        assert len(table) == drive.finder.n_beams - 6

    def test_rays_that_enter_unknown_space_first_are_left_out_unless_asked_for(self, drive, office):
        state = office.probability.copy()
        state[:, 300:320] = np.nan
        veiled = OccupancyGrid(state, office.resolution, office.origin)
        scans = np.arange(0, len(drive), 20)
        skip, free, stop = (
            build_beam_table(drive, veiled, scans, unknown=rule) for rule in ("skip", "free", "occupied")
        )
        assert skip.n_unknown > 0
        assert len(skip) + skip.n_unknown == len(free) == len(stop)
        assert (stop.expected_ranges <= free.expected_ranges).all()
        assert (stop.expected_ranges < free.expected_ranges).sum() == skip.n_unknown
