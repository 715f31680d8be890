"""Replay decides: what it repairs, what it leaves alone, and what it is judged on."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.calibration.odometry.learning import calibrate_odometry
from beamfield.calibration.odometry.result import OdometryOptions
from beamfield.calibration.odometry.windows import update_scans
from beamfield.cli.calibrate_replay import replay_fit
from beamfield.errors import TooLittleDataError
from beamfield.finding import Finding
from beamfield.localization.replay import MEASURES, ReplayErrors
from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.localization.replay_trials import run_trials
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.omni_motion import OmniMotion
from beamfield.report.replay_choice import despite_error, replay_as_dict, replay_markup, replay_tables, replay_verdict
from beamfield.report.stack_findings import other_motion, small_z_hit
from beamfield.report.stack_result import StackResult
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.log import simulate_log
from beamfield.stacks.beluga.motion import BelugaMotion
from beamfield.stacks.f1tenth.filter import F1tenthFilterParameters
from beamfield.stacks.f1tenth.motion import F1tenthMotion
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.filters.amcl_filter import AmclFilterParameters
from beamfield.stacks.fit import replay_runs
from beamfield.stacks.fit.kept_runs import KeptRuns, kept_runs
from beamfield.stacks.fit.motion_candidates import MotionCandidates, motion_candidates
from beamfield.stacks.fit.replay_amount import ReplayOptions, replay_options
from beamfield.stacks.fit.replay_choice import ReplayChoice, _of_equals, choose_by_replay
from beamfield.stacks.fit.replay_cost import clipped, costs
from beamfield.stacks.fit.replay_runs import Key, Replays, ReplaySetting
from beamfield.stacks.fit.replay_segments import cut_segments
from beamfield.stacks.mrpt.filter import MrptFilterParameters
from beamfield.stacks.mrpt.motion import MrptMotion
from beamfield.stacks.nav2.motion import DIFFERENTIAL as NAV2_DIFFERENTIAL
from beamfield.stacks.nav2.motion import OMNI as NAV2_OMNI
from beamfield.stacks.nav2.motion import Nav2Motion
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.registry import STACKS
from beamfield.stacks.ros1.motion import Ros1Motion
from tests.conftest import TRUTH

FEW = ReplayOptions(runs=10, most_stretches=2, longest=12)
GOOD = {f"alpha{i}": 0.02 for i in range(1, 5)}
ABSURD = {f"alpha{i}": 2.0 for i in range(1, 5)}
KIND = "likelihood_field_prob"
SENSOR = Nav2Parameters(laser_model_type=KIND, max_beams=20)
OWN = Key("before", "before", 0.0, "before")
RUN = ReplayErrors(mean=0.1, median=0.1, p95=0.2, end=0.1, lost=False, yaw_mean_deg=1.0, yaw_median_deg=1.0,
                   yaw_p95_deg=2.0, yaw_rmse_deg=1.2, nees_median=2.4, inside=0.9, inside_noisy=0.95,
                   sd_position=0.1, particles=500.0, updates=100)  # fmt: skip


@pytest.fixture(scope="module")
def drive(office) -> SensorLog:
    finder = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 31), 10.0, name="laser")
    return simulate_log(office, finder, TRUTH, duration=60.0, scan_rate=3.0, seed=5).only_sensor()


def nav2_filter(**motion: float) -> FilterSettings:
    return FilterSettings("nav2", KIND, SENSOR, Nav2Motion(**motion), AmclFilterParameters(100, 200))


@pytest.fixture(scope="module")
def stretches(drive):
    return cut_segments(drive, 0.25, 0.2, most=FEW.most_stretches, longest=FEW.longest)


@pytest.fixture(scope="module")
def repaired(office, stretches):
    told: list[tuple[str, int, int]] = []
    choice = choose_by_replay(
        nav2_filter(**ABSURD), {"before": (KIND, SENSOR)}, MotionCandidates({"before": {}, "alpha 0.02": GOOD}, None),
        0.5 * office.resolution,
        stretches, office, FEW, progress=lambda *words: told.append(words),
    )  # fmt: skip
    assert {"replay: racing 3 settings", "replay: judging the choice"} < {stage for stage, _, _ in told}
    assert all(0 <= done < total for _, done, total in told)
    return choice


def test_absurd_motion_noise_is_repaired(repaired, office):
    assert repaired.is_better
    assert repaired.chosen.key.motion == "alpha 0.02"
    assert repaired.chosen.filter.motion == Nav2Motion(**GOOD)
    assert repaired.error.after < 0.7 * repaired.error.before
    assert repaired.error.is_lower
    assert repaired.chosen.key.origin in (0.0, 0.5 * office.resolution)
    # Each part is judged for itself: the motion noise is what was wrong.
    assert repaired.parts["motion"].is_lower
    assert "sensor" not in repaired.parts


def test_for_a_file_that_goes_with_the_moved_map_all_is_replayed_with_it(office, stretches):
    half = 0.5 * office.resolution
    noises = MotionCandidates({"before": {}, "alpha 0.02": GOOD}, None)
    asked = nav2_filter(**ABSURD), {"before": (KIND, SENSOR)}, noises, half, stretches, office, FEW
    choice = choose_by_replay(*asked, is_moved=True)
    assert choice.before.key == Key("before", "before", half, "before")
    assert choice.chosen.key == Key("before", "alpha 0.02", half, "before")
    assert choice.n_settings == 2
    assert choice.parts.keys() == {"motion"}
    assert "2 settings of sensor and motion noise were replayed" in replay_tables(choice)
    # The runs before are those of a filter that reads the moved map.
    there = replace(office, origin=office.origin + np.array([half, half, 0.0]))
    alone = choose_by_replay(asked[0], asked[1], MotionCandidates({"before": {}}, None), 0.0, stretches, there, FEW)
    assert choice.error.before == alone.error.before


def test_a_map_painted_black_where_nothing_is_known_is_set_right(office, drive):
    shape = tuple(n + 160 for n in office.shape)
    cells = np.ones(shape, np.float32)
    cells[80:-80, 80:-80] = np.where(office.free, 0.0, 1.0)
    black = replace(office, probability=cells, origin=office.origin - np.array([*[80 * office.resolution] * 2, 0.0]))
    stretches = cut_segments(drive, 0.25, 0.2, most=3, longest=25)
    own = replace(nav2_filter(), model="likelihood_field", sensor=Nav2Parameters(max_beams=30))
    asked = own, {"before": (own.model, own.sensor)}, MotionCandidates({"before": {}}, None), 0.0, stretches, black
    choice = choose_by_replay(*asked, FEW, hollow=True)
    assert choice.is_better
    assert choice.before.key == OWN
    assert choice.chosen.key == Key("before", "before", 0.0, "before", "hollow")
    assert choice.chosen.changes_map
    assert choice.n_settings == 2
    assert choice.parts.keys() == {"solids"}
    assert choice.error.after < 0.8 * choice.error.before
    assert replay_as_dict(choice)["chosen"]["black_areas_unknown"] is True
    assert replay_verdict(choice).startswith("Use the corrected map with nav2's defaults: replayed")
    printed = replay_tables(choice)
    assert "2 settings of sensor, motion noise and black areas of the map were replayed" in printed
    assert "chosen: sensor before, motion noise before, map's black areas unknown" in printed
    # For a file whose filter reads such a map already, there is nothing to choose.
    there = choose_by_replay(*asked, FEW, hollow=True, is_moved=True)
    assert there.before.key == there.chosen.key == Key("before", "before", 0.0, "before", "hollow")
    assert there.n_settings == 1


def test_values_that_nothing_beats_are_kept(office, stretches):
    own = nav2_filter(**GOOD)
    worse = replace(SENSOR, z_hit=0.0, z_rand=1.0)  # says nothing
    motions = MotionCandidates({"before": {}, "absurd": ABSURD}, GOOD)
    choice = choose_by_replay(
        own, {"before": (KIND, SENSOR), "fitted": (KIND, worse)}, motions, 0.0, stretches, office, FEW
    )
    assert not choice.is_better
    assert choice.chosen is choice.finalist is choice.before
    assert choice.chosen.filter.motion == own.motion
    assert choice.error.difference == 0.0
    assert replay_verdict(choice).startswith("Keep nav2's defaults: replayed in nav2's own filter")
    of_a_file = replace(choice.before, filter=replace(own, path=Path("nav2.yaml")))
    theirs = replace(choice, before=of_a_file, finalist=of_a_file)
    assert replay_verdict(theirs).startswith("Keep the values you have: replayed in nav2's own filter")
    assert "none of 4 settings did better" in replay_verdict(choice)


@pytest.mark.parametrize(("kind", "recovery"), [(KIND, "off"), ("likelihood_field", "before")])
def test_poses_drawn_at_random_are_left_out_where_they_lead_astray(office, stretches, kind, recovery):
    rates = {"recovery_alpha_slow": 0.01, "recovery_alpha_fast": 0.99}
    sensor = replace(SENSOR, laser_model_type=kind, z_hit=0.95, z_rand=0.05, sigma_hit=0.05, max_beams=31)
    own = replace(nav2_filter(**GOOD), model=kind, sensor=sensor, particles=AmclFilterParameters(100, 200, **rates))
    choice = choose_by_replay(
        own, {"before": (kind, sensor)}, MotionCandidates({"before": {}}, None), 0.0, stretches, office, FEW
    )
    assert choice.chosen.key.recovery == recovery
    assert choice.is_better == (recovery == "off")
    assert choice.chosen.filter.recovery_rates == ((0.0, 0.0) if recovery == "off" else (0.01, 0.99))
    assert choice.n_settings == 2
    assert "settings of sensor, motion noise and recovery were replayed" in replay_tables(choice)


@pytest.fixture
def runs(monkeypatch) -> list[int]:
    """The seeds that are run."""
    seen: list[int] = []

    def counted(replayed, log, seeds, **options):
        seen.extend(seeds)
        return run_trials(replayed, log, seeds, **options)

    monkeypatch.setattr(replay_runs, "run_trials", counted)
    return seen


def test_seeds_that_are_missing_are_run_and_no_others(office, stretches, runs):
    own = ReplaySetting(OWN, nav2_filter())
    stepwise, at_once = (Replays(stretches[:1], office, 10, 7, KeptRuns()) for _ in range(2))
    first = stepwise.of([own], 1)[own.key]
    (grown,), (whole,) = stepwise.of([own], 3)[own.key], at_once.of([own], 3)[own.key]
    assert runs == [7, 8, 9, 7, 8, 9]
    assert grown.seeds == whole.seeds
    np.testing.assert_array_equal(grown.column("mean"), whole.column("mean"))
    assert first[0].seeds == stepwise.of([own], 1)[own.key][0].seeds == (7,)


def test_models_are_made_once_or_of_large_maps_one_at_a_time(office, stretches, monkeypatch):
    plain = ReplaySetting(OWN, nav2_filter())
    settings = [
        plain, replace(plain, key=OWN._replace(origin=0.1)),
        ReplaySetting(OWN._replace(motion="alpha 0.02"), nav2_filter(**GOOD)),
    ]  # fmt: skip
    made: list[FilterSettings] = []
    emulator = FilterSettings.emulator
    monkeypatch.setattr(FilterSettings, "emulator", lambda self, grid: made.append(self) or emulator(self, grid))
    replays = Replays(stretches, office, 2, 0, KeptRuns())
    small = [replays.of(settings, n) for n in (1, 2)][-1]
    assert len(made) == 2
    # Runs with the same model come one after the other, so that each is made once a call.
    monkeypatch.setattr(replay_runs, "MOST_CELLS", office.probability.size)
    replays, n_small = Replays(stretches, office, 2, 0, KeptRuns()), len(made)
    large = replays.of(settings, 2)
    assert len(made) == n_small + 2
    assert len(replays._run._emulators) == 1
    for key, trials in small.items():
        for one, other in zip(trials, large[key], strict=True):
            np.testing.assert_array_equal(one.column("mean"), other.column("mean"))
    # Other processes make theirs.
    assert not pickle.loads(pickle.dumps(replays._run))._emulators


def test_an_interrupted_replay_goes_on_where_it_was(repaired, office, stretches, tmp_path, runs):
    before, motions = nav2_filter(**ABSURD), MotionCandidates({"before": {}, "alpha 0.02": GOOD}, None)
    inputs = before, {"before": (KIND, SENSOR)}, motions, 0.5 * office.resolution, stretches, office, FEW

    def interrupt(stage: str, done: int, _: int) -> None:
        if stage.startswith("replay: comparing the best") and done == 1:
            raise KeyboardInterrupt

    def choose(given=inputs, progress=None):
        runs.clear()
        with kept_runs(tmp_path / "cache", given) as kept:
            return choose_by_replay(*given, progress, kept)

    with pytest.raises(KeyboardInterrupt):
        choose(progress=interrupt)
    begun = len(runs)
    (left,) = (tmp_path / "cache").iterdir()
    content = left.read_bytes()
    resumed = choose()
    assert 0 < begun < begun + len(runs) == 4 * 2 * 10  # of four settings all seeds on each stretch, none twice
    assert not list((tmp_path / "cache").iterdir())
    for measure in set(MEASURES) - {"update_ms"}:
        for one, other in zip(repaired.trials_finalist, resumed.trials_finalist, strict=True):
            np.testing.assert_array_equal(one.column(measure), other.column(measure))
    assert replay_as_dict(resumed) == replay_as_dict(repaired)
    # Other inputs find nothing, and leave alone what is not theirs.
    left.write_bytes(content)
    with kept_runs(tmp_path / "cache", (*inputs[:-1], replace(FEW, seed=1))) as kept:
        assert kept.find((0, OWN, range(2))) is None
    assert left.read_bytes() == content


def test_what_was_decided_is_told_with_its_interval_and_parts(repaired):
    text, document = replay_verdict(repaired), replay_as_dict(repaired)
    assert "Use the new values: replayed in nav2's own filter, emulated, on 2 stretches of this log, 20 runs" in text
    assert f"{repaired.error.before:.3f} m before and {repaired.error.after:.3f} m after" in text
    assert document["error"]["high"] < 0.0
    assert document["chosen"]["parameters"]["alpha3"] == 0.02
    assert document["without"].keys() == repaired.parts.keys()
    assert "4 settings of sensor, motion noise and map origin were replayed" in replay_tables(repaired)
    assert all("alpha 0.02" in said for said in (replay_markup(repaired), replay_tables(repaired)))


def test_where_only_the_map_is_corrected_the_verdict_says_so(repaired):
    moved = replace(repaired.finalist, key=OWN._replace(origin=-0.025))
    said = replay_verdict(replace(repaired, finalist=moved))
    assert said.startswith("Use the corrected map with nav2's defaults: replayed")


def test_of_a_stretch_only_what_follows_the_lead_in_is_judged(drive):
    stretches = cut_segments(drive, 0.1, 0.1, most=4, longest=1000)
    assert len(stretches) == 4
    judged = [np.flatnonzero(np.isfinite(stretch.poses[:, 0])) for stretch in stretches]
    stamps = [stretch.stamps[scans] for stretch, scans in zip(stretches, judged, strict=True)]
    for lead_in, stretch, scans in zip((1, 2, 2, 2), stretches, judged, strict=True):
        updates = update_scans(stretch.odometry, 0.1, 0.1)
        assert scans[0] == 0
        assert np.searchsorted(updates, scans[1]) / len(updates) == pytest.approx(lead_in / (lead_in + 1), abs=0.05)
    for one, other in pairwise(stamps):
        assert one[-1] < other[1]  # no scan judges two


def test_stretches_of_a_long_log_are_cut_to_what_is_affordable(drive):
    for parts, stretch in zip((3, 3), cut_segments(drive, 0.1, 0.1, most=2, longest=13), strict=True):
        assert len(update_scans(stretch.odometry, 0.1, 0.1)) == pytest.approx(13 * parts, abs=2)


def test_a_short_drive_is_too_little(drive):
    with pytest.raises(TooLittleDataError, match="a replay needs 36 updates of the filter with reference poses"):
        cut_segments(drive[:40], 0.25, 0.2, most=4, longest=40)


def test_motion_candidates_are_the_logs_and_common_alphas(drive):
    found = motion_candidates(nav2_filter(), drive, 0.01).by_name
    assert found["before"] == {}
    assert found["alpha 0.1"] == {f"alpha{i}": 0.1 for i in range(1, 5)}
    assert list(found["alphas 0.2 and 0.02"].values()) == [0.2, 0.2, 0.02, 0.02]
    assert all(value >= 0.02 for value in found["learned"].values())
    assert len({tuple(values.values()) for values in found.values()}) == len(found)


@pytest.mark.parametrize(
    ("stack", "own", "key", "omni", "prefix"),
    [
        ("nav2", Nav2Motion(), "robot_model_type", "nav2_amcl::OmniMotionModel", "alpha"),
        ("nav2", Nav2Motion("differential"), "robot_model_type", "omnidirectional", "alpha"),
        ("nav2", Nav2Motion(NAV2_OMNI), "robot_model_type", NAV2_OMNI, "alpha"),
        ("beluga", BelugaMotion(), "robot_model_type", "omnidirectional_drive", "alpha"),
        ("beluga", BelugaMotion(NAV2_DIFFERENTIAL), "robot_model_type", NAV2_OMNI, "alpha"),
        ("ros1", Ros1Motion(), "odom_model_type", "omni-corrected", "odom_alpha"),
    ],
)
def test_an_omni_model_is_tried_for_robots_that_cannot_move_sideways(drive, stack, own, key, omni, prefix):
    settings = FilterSettings(stack, KIND, None, own, AmclFilterParameters())
    found = motion_candidates(settings, drive, 0.01).by_name["omni 0.02 and 0.005"]
    alphas = [0.02, 0.02, 0.005, 0.02, 0.02]
    assert found == {key: omni} | {f"{prefix}{i}": alpha for i, alpha in enumerate(alphas, start=1)}
    formula = replace(own, **found).formula
    assert isinstance(formula, OmniMotion)
    assert (formula.alpha1, formula.alpha3, formula.alpha4, formula.alpha5) == (0.02, 0.005, 0.02, 0.02)
    assert not formula.variance_as_deviation


def test_an_omni_model_with_a_formula_of_its_own_stays(drive):
    settings = FilterSettings("ros1", KIND, None, Ros1Motion("omni"), AmclFilterParameters())
    assert all("odom_model_type" not in values for values in motion_candidates(settings, drive, 0.01).by_name.values())


def test_where_alphas_mean_something_else_they_stand_for_the_same_noise(drive):
    settings = FilterSettings("ros1", KIND, None, Ros1Motion(), AmclFilterParameters())
    found = motion_candidates(settings, drive, 0.01).by_name
    literal = {name: values["odom_alpha3"] for name, values in found.items() if name.startswith("alpha")}
    # A deviation of alpha x step^2 instead of sqrt(alpha) x step: ten times the alpha at steps of 0.3 m or so.
    assert literal["alpha 0.1"] > literal["alpha 0.05"] > 0.2


def test_programs_without_alphas_get_as_much_noise_in_their_own_names(drive):
    found = {}
    for stack, motion, particles in (
        ("mrpt", MrptMotion(), MrptFilterParameters(rate_hz=1.0)),
        ("f1tenth", F1tenthMotion(), F1tenthFilterParameters()),
    ):
        settings = FilterSettings(stack, "", None, motion, particles)
        assert settings.update_distances == (0.0, 0.0)
        assert len(settings.at_ticks(drive)) < len(drive) or stack == "f1tenth"
        found[stack] = motion_candidates(settings, drive, 0.01).by_name
        assert found[stack].keys() >= {"before", "learned", "alpha 0.1"}
    assert found["mrpt"]["alpha 0.1"]["a1"] > found["mrpt"]["alpha 0.05"]["a1"] > 0.0
    assert found["f1tenth"]["learned"]["motion_dispersion_theta"] < 0.25


def test_a_motion_model_without_alphas_stays(drive):
    settings = FilterSettings("beluga", KIND, None, BelugaMotion("stationary"), AmclFilterParameters())
    assert motion_candidates(settings, drive, 0.01) == ({"before": {}}, None)


def give_runs(monkeypatch: pytest.MonkeyPatch, runs: Callable[[Key], list[ReplayTrials]]) -> None:
    """Let settings have these runs, on each stretch, instead of being replayed."""

    class Known(Replays):
        def of(self, settings, *_):
            return {one.key: runs(one.key) for one in settings}

    monkeypatch.setattr("beamfield.stacks.fit.replay_choice.Replays", Known)


def sure_runs(*errors: float) -> list[ReplayTrials]:
    """Return runs that hardly differ on each stretch, by their errors."""
    return [
        ReplayTrials(f"room {i}", tuple(range(12)), tuple(replace(RUN, mean=error + 0.0001 * n) for n in range(12)))
        for i, error in enumerate(errors)
    ]


def test_a_sensor_that_loses_robots_does_not_hide_what_is_better_for_sure(office, monkeypatch):
    def runs(key: Key) -> list[ReplayTrials]:
        error = {"before": 0.3, "fitted": 0.1}[key.sensor] * (0.6 if key.motion == "alpha 0.02" else 1.0)
        loses = key.sensor == "fitted"
        errors = [replace(RUN, mean=error * (1.0 + 0.01 * i), lost=loses and i % 2 == 0) for i in range(12)]
        return [ReplayTrials("hall", tuple(range(12)), tuple(errors))] * 2

    give_runs(monkeypatch, runs)
    sensors = {"before": (KIND, SENSOR), "fitted": (KIND, replace(SENSOR, z_hit=0.9))}

    def choose(**motions: dict[str, float]) -> ReplayChoice:
        noises = MotionCandidates({"before": {}, **motions}, None)
        return choose_by_replay(nav2_filter(), sensors, noises, 0.0, [None, None], office, FEW)

    choice = choose(**{"alpha 0.02": GOOD})
    assert choice.is_better
    assert choice.chosen.key == Key("before", "alpha 0.02", 0.0, "before")
    assert choice.n_settings == 4
    # Where nothing else helps, what came nearest is told.
    nothing = choose()
    assert not nothing.is_better
    assert nothing.finalist.key.sensor == "fitted"


def test_a_sensor_that_only_some_stretches_choose_does_not_hide_what_is_better_for_sure(office, monkeypatch):
    # Two rooms choose the fitted sensor, which is lost in the hall; over all three the user's own is best.
    errors = {("before", "before"): (0.3,) * 3, ("before", "alpha 0.02"): (0.18,) * 3,
              ("fitted", "before"): (0.3, 0.3, 1.0), ("fitted", "alpha 0.02"): (0.1, 0.1, 1.0)}  # fmt: skip

    give_runs(monkeypatch, lambda key: sure_runs(*errors[key.sensor, key.motion]))
    sensors = {"before": (KIND, SENSOR), "fitted": (KIND, replace(SENSOR, z_hit=0.9))}
    noises = MotionCandidates({"before": {}, "alpha 0.02": GOOD}, None)
    choice = choose_by_replay(nav2_filter(), sensors, noises, 0.0, [None] * 3, office, FEW)
    assert choice.is_better
    assert choice.chosen.key == Key("before", "alpha 0.02", 0.0, "before")
    assert choice.error.after == pytest.approx(0.18, abs=0.001)


def test_motion_noise_that_only_the_choice_likes_stays_as_it_was(office, monkeypatch):
    # One noise for each room, worse in the other than the user's, and one that is a little better in both.
    errors = {"before": (0.054, 0.054), "of room": (0.035, 0.08), "of hall": (0.08, 0.035), "of both": (0.045, 0.045)}

    give_runs(monkeypatch, lambda key: sure_runs(*(errors[key.motion] if key.sensor == "fitted" else (0.2, 0.2))))
    noises = MotionCandidates({name: {"alpha1": 0.01 * i} for i, name in enumerate(errors)}, None)
    sensors = {"before": (KIND, SENSOR), "fitted": (KIND, replace(SENSOR, sigma_hit=0.1))}
    choice = choose_by_replay(nav2_filter(), sensors, noises, 0.0, [None] * 2, office, FEW)
    assert choice.is_better
    assert choice.chosen.key[:2] == ("fitted", "before")
    assert set(choice.parts) == {"sensor"}


def test_without_a_sensor_that_is_not_confirmed_other_motion_noise_is_chosen(office, monkeypatch):
    # Each room chooses the fitted sensor with noise that errs in the other; the user's sensor does better with "same".
    errors = {("fitted", "of room"): (0.03, 0.12), ("fitted", "of hall"): (0.12, 0.03),
              ("fitted", "of both"): (0.045,) * 2, ("before", "of room"): (0.09,) * 2,
              ("before", "of hall"): (0.09,) * 2, ("before", "of both"): (0.09,) * 2,
              ("before", "same"): (0.06,) * 2}  # fmt: skip

    give_runs(monkeypatch, lambda key: sure_runs(*errors.get((key.sensor, key.motion), (0.3, 0.3))))
    names = ("before", "of room", "of hall", "of both", "same")
    noises = MotionCandidates({name: {"alpha1": 0.01 * i} for i, name in enumerate(names)}, None)
    sensors = {"before": (KIND, SENSOR), "fitted": (KIND, replace(SENSOR, sigma_hit=0.1))}
    choice = choose_by_replay(nav2_filter(), sensors, noises, 0.0, [None] * 2, office, FEW)
    assert choice.is_better
    assert choice.chosen.key[:2] == ("before", "same")


def test_the_table_says_how_often_the_truth_is_inside_without_each_part(repaired):
    rivals = {"motion": 0.5, "origin": 0.25}
    trials = {
        name: [replace(one, errors=tuple(replace(run, inside_noisy=inside) for run in one.errors))
               for one in repaired.trials_finalist]
        for name, inside in rivals.items()
    }  # fmt: skip
    choice = replace(repaired, trials_without=trials, parts=dict.fromkeys(rivals, repaired.error))
    rows = {line.partition("  ")[0]: line for line in replay_tables(choice).splitlines()}
    assert rows["noise as before"].endswith(" 50%")
    assert rows["origin as before"].endswith(" 25%")
    # What does not lower the error is told to pay by that; what does needs no other reason.
    unsure = replace(repaired.error, before=0.1, after=0.12, low=-0.01, high=0.05)
    worse = replace(choice, parts={"motion": unsure})
    assert despite_error(worse, "motion").endswith("% of the updates, not in 50%")
    as_often = replace(worse, trials_without={"motion": repaired.trials_finalist})
    assert despite_error(as_often, "motion") == ", which may be chance"
    assert despite_error(choice, "motion") == despite_error(worse, "origin") == ""


@pytest.mark.parametrize(("inside_after", "is_better"), [(0.8, False), (0.95, True)])
def test_a_little_less_where_errors_are_small_is_no_gain_unless_particles_hold_the_truth(
    office, monkeypatch, inside_after, is_better
):
    def runs(key: Key, stretch: str) -> ReplayTrials:
        new = key.motion == "alpha 0.02"
        # Surely 4 cm less in two rooms; in the hall anything from 30 cm less to 36 cm more.
        errors = [0.06 if new else 0.1] * 12 if stretch != "hall" else [0.5 + (0.06 * i - 0.3) * new for i in range(12)]
        inside = inside_after if new else 0.8
        errors_of_runs = [replace(RUN, mean=error, inside_noisy=inside) for error in errors]
        return ReplayTrials(stretch, tuple(range(12)), tuple(errors_of_runs))

    give_runs(monkeypatch, lambda key: [runs(key, stretch) for stretch in ("room", "other room", "hall")])
    noises = MotionCandidates({"before": {}, "alpha 0.02": GOOD}, None)
    choice = choose_by_replay(nav2_filter(), {"before": (KIND, SENSOR)}, noises, 0.0, [None] * 3, office, FEW)
    assert choice.finalist.key.motion == "alpha 0.02"
    assert choice.cost.is_lower
    assert not choice.error.is_sure
    assert choice.is_better is is_better


def test_lost_runs_and_missing_coverage_cost_without_drowning_the_rest():
    trials = ReplayTrials("hall", (0, 1, 2), (RUN, replace(RUN, inside_noisy=0.7), replace(RUN, mean=40.0)))
    np.testing.assert_allclose(clipped(trials).column("mean"), [0.1, 0.1, 1.0])
    np.testing.assert_allclose(np.exp(costs(trials).column("mean")), [0.1, 0.14, 1.0])


def test_a_small_z_hit_is_explained_where_the_weight_is_a_product():
    small = replace(SENSOR, z_hit=0.006, z_rand=0.994)
    (finding,) = small_z_hit("nav2", KIND, small)
    assert finding.text.startswith("z_hit = 0.006 is intended")
    assert "z_hit range_max / z_rand" in finding.why
    assert not [*small_z_hit("nav2", KIND, SENSOR)]
    assert not [*small_z_hit("nav2", "likelihood_field", replace(small, laser_model_type="likelihood_field"))]


def test_a_motion_model_that_the_user_did_not_have_is_explained(repaired):
    def found(choice: ReplayChoice) -> list[Finding]:
        return list(other_motion(StackResult((), SimpleNamespace(model=SimpleNamespace(stack="nav2")), choice)))

    assert found(repaired) == []
    its = repaired.finalist.filter
    omni = replace(repaired.finalist, filter=replace(its, motion=replace(its.motion, robot_model_type=NAV2_OMNI)))
    (finding,) = found(replace(repaired, finalist=omni))
    assert finding.name == "stack-other-motion"
    assert f"robot_model_type = {NAV2_OMNI} than with {NAV2_DIFFERENTIAL}" in finding.text
    part = repaired.parts["motion"]
    assert f"{part.after:.3f} m, with the motion noise as before {part.before:.3f} m" in finding.text


def test_rays_are_replayed_less_and_filters_that_take_every_scan(drive):
    field = nav2_filter()
    assert replay_options(field, drive, 3) == ReplayOptions(seed=3)
    assert replay_options(replace(field, model="beam"), drive, 3).runs < ReplayOptions().runs
    every = FilterSettings("mrpt", "LF_Thrun", None, MrptMotion(), MrptFilterParameters())
    slow = replace(drive, odometry=0.2 * drive.odometry)
    assert replay_options(field, slow, 3) == ReplayOptions(seed=3)
    usual, less = replay_options(every, drive, 0), replay_options(every, slow, 0)
    scans_per_update = len(slow) / len(update_scans(slow.odometry, 0.25, 0.2))
    assert less.runs < usual.runs
    assert scans_per_update * less.runs * less.longest == pytest.approx(2.0 * 60 * 40, rel=0.1)
    still = replace(drive, odometry=np.zeros_like(drive.odometry))
    assert replay_options(every, still, 0).longest >= 1


def test_without_odometry_or_an_emulated_filter_nothing_is_replayed(drive, office, monkeypatch):
    job = SimpleNamespace(patched=None)
    blind = replace(drive, odometry=np.full_like(drive.poses, np.nan))
    fit = SimpleNamespace(model=SimpleNamespace(stack="mrpt"))
    assert replay_fit(job, blind, office, fit, [], {}) == (None, "the log has no odometry")
    monkeypatch.setitem(STACKS, "mrpt", replace(STACKS["mrpt"], filter=None))
    assert replay_fit(job, drive, office, fit, [], {}) == (None, "the particle filter of mrpt is not emulated")


@pytest.mark.parametrize(
    ("keep_map", "record", "asked"),
    [(False, True, (True, True)), (False, False, (True, False)), (True, True, (False, False))],
)
def test_a_file_whose_values_were_chosen_for_the_moved_map_is_replayed_with_it(
    drive, office, tmp_path, monkeypatch, keep_map, record, asked
):
    mine = tmp_path / "mine.yaml"
    mine.write_text("amcl:\n  ros__parameters:\n    z_hit: 0.5\n" + "# chosen for the map amcl_map.yaml\n" * record)
    model, values = SimpleNamespace(stack="nav2", model=KIND), SimpleNamespace(parameters=SENSOR)
    fit = SimpleNamespace(model=model, before=values, chosen=values, parameters=SENSOR)
    given = SimpleNamespace(keep_map=keep_map, map=Path("map.yaml"), reference_error=0.01, seed=0)
    job = SimpleNamespace(patched=read_stack_file(mine, stack="nav2"), arguments=given, progress=lambda *_: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(
        "beamfield.stacks.fit.replay_choice.choose_by_replay",
        lambda *inputs, hollow, is_moved: (inputs[3] == 0.5 * office.resolution, is_moved, hollow),
    )
    assert replay_fit(job, drive, office, fit, [], {}) == ((*asked, False), "")


def test_safe_noise_is_twice_what_the_log_shows_but_not_twice_the_floor(drive):
    rng, poses = np.random.default_rng(2), [drive.poses[:1]]
    for step in range(1, len(drive)):
        poses.append(DifferentialMotion(0.5, 0.5, 0.0, 0.0).sample(poses[-1], drive.odometry[step - 1 : step + 1], rng))
    turning = replace(drive, poses=np.concatenate(poses))
    options = OdometryOptions(reference_error=0.01)
    for log in (drive, turning):
        shown = calibrate_odometry(log, options).chosen.model
        by_name, safe = motion_candidates(nav2_filter(), log, 0.01)
        learned, twice = ({name: max(0.02, n * getattr(shown, name)) for name in GOOD} for n in (1.0, 2.0))
        assert by_name["learned"] == pytest.approx(learned, rel=0.02)  # written with three digits
        assert safe == pytest.approx(twice, rel=0.02)
        assert max(safe.values()) > 0.1 if log is turning else set(safe.values()) == {0.02}


def test_of_settings_as_good_the_one_nearest_to_safe_noise_is_taken():
    settings = [
        ReplaySetting(OWN._replace(motion=name), nav2_filter(**{f"alpha{i}": value for i in range(1, 5)}))
        for name, value in (("a", 0.02), ("b", 0.05), ("c", 0.1))
    ]

    def chosen(*costs: float, alpha: float | None = 0.04) -> str:
        safe = None if alpha is None else Nav2Motion(**{f"alpha{i}": alpha for i in range(1, 5)})
        return _of_equals(settings, np.array(costs), safe).key.motion

    assert chosen(-2.0, -1.95, -1.99) == "b"
    assert chosen(-1.95, -1.95, -2.0) == "b"
    assert chosen(-1.95, -1.95, -2.0, alpha=0.12) == "c"
    assert chosen(-1.95, -1.95, -2.0, alpha=0.02) == "a"
    assert chosen(-2.0, -1.8, -1.8) == "a"
    assert chosen(-1.8, -1.8, -2.0) == "c"
    assert chosen(-1.95, -1.95, -2.0, alpha=None) == "c"  # the log does not show it


def test_of_settings_as_good_one_with_the_users_motion_model_is_taken():
    safe = Nav2Motion(**GOOD)
    settings = [
        ReplaySetting(OWN._replace(motion=name), FilterSettings("nav2", KIND, SENSOR, motion, AmclFilterParameters()))
        for name, motion in (("own", Nav2Motion(**ABSURD)), ("omni", replace(safe, robot_model_type=NAV2_OMNI)))
    ]
    assert _of_equals(settings, np.array([-1.95, -2.0]), safe).key.motion == "own"
    assert _of_equals(settings, np.array([-1.85, -2.0]), safe).key.motion == "omni"
