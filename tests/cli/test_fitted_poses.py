"""Commands on a log that has no reference poses: they are fitted to the map first."""

from __future__ import annotations

import argparse
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.calibration import reference_checks
from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.cli.fitted_poses import IN_DOUBT, REFUTED, fit_in_map, instead_of_own, posed_log, with_map_judged
from beamfield.cli.main import main
from beamfield.cli.progress import StageProgress
from beamfield.errors import BeamfieldError, FormatError, TrajectoryNotFoundError
from beamfield.finding import Finding
from beamfield.geometry import between, chained
from beamfield.io.logs.carmen_writer import write_carmen
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.localization import fitted_poses
from beamfield.localization.trajectory import TrajectoryFit, fit_trajectory
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report import html
from beamfield.sensors import RangeFinder, ScanLog, SensorLog
from beamfield.stacks.doctor import map_checks
from tests.cli.simulated import on_map, simulated

LONE = ("--lone-poses", "odometry")
LASER = RangeFinder.from_bearings(np.linspace(-1.5, 1.5, 8), max_range=8.0)
RING = replace(LASER, opening_angle=0.3)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated log with its map; lone.carmen is the same log with odometry only."""
    options = "--duration 40 --scan-rate 4 --beams 61 --width 26 --height 20 --mount 0 0 0"
    folder = simulated(tmp_path_factory.mktemp("world"), options)
    (folder / "lone.carmen").write_text(without_poses((folder / "log.carmen").read_text()))
    return folder


def without_poses(carmen: str) -> str:
    """Return a log with each reference pose replaced by the odometry."""
    kept = []
    for line in carmen.splitlines():
        words = line.split()
        if words and words[0] == "FLASER":
            k = 2 + int(words[1])
            words[k : k + 3] = words[k + 3 : k + 6]
        kept.append(" ".join(words))
    return "\n".join(kept) + "\n"


@pytest.fixture(scope="module")
def fitted(world: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What calibrate makes of the log without poses; of the report, only the sections."""
    out = tmp_path_factory.mktemp("fitted") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(html, "render_report", lambda *_, sections, **__: "".join(part.markup for part in sections))
        assert on_map("calibrate", world, "lone.carmen", out, *LONE, "--no-refine", "--quiet") == 0
    return out


@pytest.fixture
def fitted_once(world: Path, monkeypatch) -> None:
    """Let commands share one fit of all beams."""
    monkeypatch.setattr(fitted_poses, "fit_trajectory", lambda *_, **__: fit_of(world))


@cache
def fit_of(world: Path) -> TrajectoryFit:
    return fit_trajectory(
        read_log(world / "lone.carmen", lone_poses="odometry").only_sensor(), read_map(world / "map.yaml")
    )


def document_of(folder: Path) -> dict:
    return json.loads((folder / "calibration.json").read_text())


def test_calibrate_without_poses_learns_what_it_learns_with_them(world: Path, fitted: Path):
    log, grid = read_log(world / "log.carmen").only_sensor(), read_map(world / "map.yaml")
    expected = calibrate(log, grid, CalibrationOptions(refine=False)).parameters
    document = document_of(fitted)
    for name in ("z_hit", "z_short", "z_max", "z_rand"):
        # From half of the beams: the standard error of a weight is about 0.006.
        assert document["parameters"][name]["value"] == pytest.approx(getattr(expected, name), abs=0.02), name
    assert document["parameters"]["sigma_hit"]["value"] == pytest.approx(expected.sigma_hit, abs=0.006)


def test_the_outputs_say_where_the_poses_come_from_and_what_that_hides(fitted: Path):
    document = document_of(fitted)
    part = document["fitted_poses"]
    assert part["n_scans"] == 160
    assert part["n_trusted"] > 145
    assert set(part["halves"]) == {"used", "swapped", "same"}
    (finding,) = [one for one in document["findings"] if one["name"] == "poses-fitted"]
    assert finding["severity"] == "info"
    assert f"{part['n_trusted']} of 160 scans are trusted" in finding["text"]
    assert "do not show" in finding["why"]
    assert finding["do"]
    assert "count as 0.025 m wrong (--reference-error)" in finding["text"]
    page = (fitted / "report.html").read_text()
    assert "odd beams" in page
    assert "so much would be hidden" in page
    assert "do not show" in page
    assert "The poses were fitted to this map" in document["verdict"]


def test_the_error_of_the_poses_is_what_the_fit_says(fitted: Path):
    document = document_of(fitted)
    error = document["fitted_poses"]["reference_error_m"]
    # Half a cell of the map: the fit alone says less.
    assert error == 0.025
    assert document["provenance"]["options"]["reference_error"] == error
    assert 0.001 < document["fitted_poses"]["deviation_m"] < error


@pytest.fixture(scope="module")
def lost(world: Path) -> str:
    """The log with poses that leave the right ones half-way, as a filter's that gets lost do."""
    lines, n_scans = [], 0
    for line in (world / "log.carmen").read_text().splitlines():
        words = line.split()
        if words and words[0] == "FLASER":
            k, n_scans = 2 + int(words[1]), n_scans + 1
            words[k] = str(float(words[k]) + 0.05 * max(n_scans - 80, 0))
        lines.append(" ".join(words))
    (world / "lost.carmen").write_text("\n".join(lines) + "\n")
    return "lost.carmen"


@pytest.mark.usefixtures("fitted_once")
def test_check_of_a_log_whose_robot_was_lost_says_where_and_judges_its_own_poses(
    world: Path, lost: str, fitted: Path, tmp_path: Path, capsys
):
    words = ("--params", str(fitted / "beam_model.yaml"), "--worst", "0")
    assert on_map("check", world, lost, tmp_path / "out", *words) == 3
    said = capsys.readouterr()
    assert "warning: The log's own poses leave the fitted ones" in said.err
    page = (tmp_path / "out" / "scan_fit.html").read_text()
    assert "parameters on this log: beamfield doctor, then beamfield calibrate --stack</p>" in page
    document = json.loads((tmp_path / "out" / "scan_fit.json").read_text())
    (finding,) = [one for one in document["fitted_poses"]["findings"] if one["name"] == "own-poses-lost"]
    assert finding["values"]["first_s"] == pytest.approx(20.0 + 0.25 * 10, abs=1.5)
    assert document["share_that_fits"] < 0.8
    assert "lost probability above 0.5" in said.out


@pytest.mark.usefixtures("fitted_once")
def test_localize_is_not_judged_by_poses_that_are_lost(world: Path, lost: str, tmp_path: Path, capsys):
    assert on_map("localize", world, lost, tmp_path / "out") == 0
    assert "The log's own poses leave the fitted ones" in capsys.readouterr().err
    document = json.loads((tmp_path / "out" / "localization.json").read_text())
    assert document["errors"]["mean"] < 0.2
    assert "own-poses-lost" in [one["name"] for one in document["findings"]]


@pytest.mark.usefixtures("fitted_once")
def test_doctor_counts_what_is_wrong_with_the_poses(world: Path, lost: str, tmp_path: Path, capsys):
    doctor(world, tmp_path, lost)
    said = capsys.readouterr()
    assert "warning: own-poses-lost" in said.out
    assert "map-disagrees" not in said.out
    # What some builds of nav2 do to a robot that is lost.
    assert "info: distance-queue-uninitialised" in said.out


def test_poses_of_a_file_that_the_user_names_are_taken_as_they_are(world: Path, lost: str):
    log, grid = read_log(world / lost).only_sensor(), read_map(world / "map.yaml")
    with StageProgress(quiet=True) as progress:
        path, poses = world / lost, world / "named.tum"
        posed, fitted, found = posed_log(log, grid, argparse.Namespace(), progress, path, poses, None)
    assert fitted is None
    assert posed is log
    assert {"map-disagrees", "reference-slides"} & {one.name for one in found}


@pytest.mark.usefixtures("without_figures")
def test_no_values_are_chosen_for_a_filter_whose_odometry_has_the_wrong_sign(world: Path, tmp_path: Path, capsys):
    log = read_log(world / "lone.carmen", lone_poses="odometry")
    sensor = log.only_sensor()
    turned = chained(sensor.odometry[0], between(sensor.odometry[:-1], sensor.odometry[1:]) * [1.0, -1.0, -1.0])
    # The text format has one pose where there are no others.
    write_carmen(world / "turned.carmen", ScanLog({"laser": replace(sensor, poses=turned, odometry=turned)}))
    file = nav2_file(tmp_path)
    before = file.read_text()
    words = (*LONE, "--stack", "nav2", "--patch", str(file), "--no-refine", "--quiet")
    assert on_map("calibrate", world, "turned.carmen", tmp_path / "out", *words) == 3
    said, why = capsys.readouterr(), "no values for nav2: the odometry fits only with its turns reversed; the robot's"
    assert f"beamfield: warning: {why}" in said.err
    assert said.out.startswith(why)
    assert said.out.endswith(f"; left {file} as it was\n")
    assert file.read_text() == before


@pytest.mark.usefixtures("without_figures")
def test_calibrate_learns_at_fitted_poses_where_those_of_the_log_are_lost(world: Path, lost: str, tmp_path: Path):
    assert on_map("calibrate", world, lost, tmp_path / "out", "--no-refine", "--quiet") == 0
    document = document_of(tmp_path / "out")
    assert "own-poses-lost" in [one["name"] for one in document["findings"]]
    assert document["parameters"]["sigma_hit"]["value"] < 0.1


@pytest.mark.usefixtures("fitted_once")
def test_check_fits_the_poses_first_and_says_so(world: Path, fitted: Path, tmp_path: Path, capsys):
    words = (*LONE, "--params", str(fitted / "beam_model.yaml"), "--worst", "0")
    assert on_map("check", world, "lone.carmen", tmp_path / "out", *words) == 0
    said = capsys.readouterr()
    assert "they were fitted to this map" in said.err
    document = json.loads((tmp_path / "out" / "scan_fit.json").read_text())
    assert document["fitted_poses"]["n_trusted"] > 145
    assert document["share_that_fits"] > 0.85


def test_a_log_with_poses_is_not_touched(world: Path, tmp_path: Path, monkeypatch, capsys):
    def never(*_arguments, **_options):
        raise AssertionError("fitted")

    monkeypatch.setattr(fitted_poses, "fit_trajectory", never)
    words = ("--start", "1", "1", "0")
    assert on_map("calibrate", world, "log.carmen", tmp_path / "out", *words) == 2
    assert "--start: is for a log without reference poses, and this one has them" in capsys.readouterr().err
    capsys.readouterr()
    assert doctor(world, tmp_path, "log.carmen") == 0
    assert "distance-queue-uninitialised" not in capsys.readouterr().out


def doctor(world: Path, tmp_path: Path, log: str, *more: str) -> int:
    file = nav2_file(tmp_path)
    return main(["doctor", str(file), "--map", str(world / "map.yaml"), "--log", str(world / log), *more])


def nav2_file(folder: Path) -> Path:
    file = folder / "nav2.yaml"
    file.write_text("amcl:\n  ros__parameters:\n    laser_model_type: likelihood_field_prob\n    max_beams: 30\n"
                    "    z_hit: 0.95\n    z_rand: 0.05\n    sigma_hit: 0.1\n    laser_likelihood_max_dist: 2.0\n"
                    "    robot_model_type: nav2_amcl::DifferentialMotionModel\n")  # fmt: skip
    return file


@pytest.mark.usefixtures("fitted_once")
def test_doctor_fits_the_poses_first_and_says_so(world: Path, tmp_path: Path, capsys):
    doctor(world, tmp_path, "lone.carmen", *LONE)
    said = capsys.readouterr()
    assert "they were fitted to this map" in said.err


@pytest.mark.usefixtures("fitted_once")
def test_evaluate_compares_with_fitted_poses_and_says_so(world: Path, tmp_path: Path):
    file = nav2_file(tmp_path)
    words = (*LONE, "--params", str(file), "--seeds", "1", "--quiet")
    assert on_map("evaluate", world, "lone.carmen", tmp_path / "out", *words) == 0
    document = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert any("they were fitted to this map" in note for note in document["notes"])


@pytest.mark.usefixtures("fitted_once")
def test_a_map_is_built_at_poses_fitted_to_another(world: Path, tmp_path: Path, capsys):
    out = tmp_path / "new.yaml"
    assert on_map("map", world, "lone.carmen", out, *LONE, "--resolution", "0.1", "--json", "--quiet") == 0
    document = json.loads(capsys.readouterr().out)
    assert "were fitted to this map" in document["fitted_poses"]["findings"][0]["text"]
    assert document["fitted_poses"]["n_trusted"] > 100
    assert document["share_of_hits_in_obstacles"] > 0.7
    # The new map lies in the frame of the old one: its walls are the old ones.
    old, new = read_map(world / "map.yaml"), read_map(out)
    rows, cols = np.nonzero(new.occupied)
    near = distance_to_obstacles(old)
    col, row = np.floor(old.to_cells(new.to_map(np.column_stack([cols, rows]) + 0.5))).astype(int).T
    on_map_too = (row >= 0) & (row < old.shape[0]) & (col >= 0) & (col < old.shape[1])
    assert np.mean(near[row[on_map_too], col[on_map_too]] < 0.15) > 0.85


def refuses(*_, **__):
    raise TrajectoryNotFoundError("no trajectory through this map fits the log")


def test_doctor_goes_on_without_poses_where_none_can_be_fitted(world: Path, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setattr(fitted_poses, "fit_trajectory", refuses)
    doctor(world, tmp_path, "lone.carmen", *LONE)
    said = capsys.readouterr()
    assert "--poses FILE; tests at the scans' poses are left out" in said.err
    assert "likelihood_field_prob" in said.out


@pytest.mark.parametrize(("start", "helps"), [(None, "helps: --start X"), ((1.0, 2.0, 0.0), "helps: another --start")])
def test_who_gave_a_start_is_not_told_to_give_one(start, helps):
    sensor = SimpleNamespace(has_odometry=True, finder=SimpleNamespace(opening_angle=0.0))
    with pytest.raises(FormatError, match=helps):
        fit_in_map(refuses, sensor, None, None, None, path=Path("log.carmen"), start=start)


def write_another_building(path: Path) -> None:
    rng = np.random.default_rng(4)
    cells = np.zeros((90, 90))
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    for x, y in rng.integers(0, 85, (14, 2)):
        cells[y : y + 4, x : x + 4] = 100
    write_map(OccupancyGrid.from_ros(cells, resolution=0.1), path)


def one_line(capsys, code: int, expected: int = 1) -> str:
    assert code == expected
    error = capsys.readouterr().err
    assert error.count("\n") == 1, error
    assert error.startswith("beamfield: error: ")
    return error


def test_a_log_of_another_building_is_refused_with_the_best_starts(world: Path, tmp_path: Path, capsys):
    write_another_building(tmp_path / "map.yaml")
    lines = (world / "lone.carmen").read_text().splitlines()
    (tmp_path / "short.carmen").write_text("\n".join(lines[: len(lines) // 4]) + "\n")
    code = main(["calibrate", str(tmp_path / "short.carmen"), "--map", str(tmp_path / "map.yaml"), *LONE, "--quiet",
                 "--out", str(tmp_path / "out")])  # fmt: skip
    error = one_line(capsys, code)
    assert "no scan has a reference pose, and none can be fitted: no trajectory through this map fits" in error
    assert "people all around, a drive beyond it, or wrong odometry?); best starts: (" in error
    assert error.count("of the beams agree") == 2
    assert "--start X Y DEG, or --poses FILE" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"odometry": np.full((3, 3), np.nan)}, "run.bag: no scan has a reference pose, and without odometry at"),
        ({"finder": RING}, "run.bag: no scan has a reference pose, and none is fitted to the cones of a sonar"),
        ({"stamps": [0.0, 2.0, 1.0]}, "run.bag: the stamps run backwards at scan 2"),
        ({"ranges": np.full((3, 8), np.nan)}, "run.bag: no scan has a reference pose, and none can be fitted: the"),
    ],
)  # fmt: skip
def test_what_cannot_be_fitted_is_refused_with_what_helps(change: dict, message: str):
    cells = np.zeros((40, 40))
    cells[[0, -1]] = 100
    log = SensorLog(LASER, [0.0, 1.0, 2.0], np.full((3, 8), 2.0), np.full((3, 3), np.nan), np.zeros((3, 3)))
    arguments = argparse.Namespace(map=Path("map.yaml"))
    with pytest.raises(BeamfieldError) as refused:
        posed_log(
            replace(log, **change), OccupancyGrid.from_ros(cells, resolution=0.1), arguments,
            StageProgress(quiet=True), Path("run.bag"), None, None,
        )  # fmt: skip
    assert str(refused.value).startswith(message)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--start", "500", "0", "0"), r"--start: \(500 m, 0 m\) lies off the map"),
        (("--start", "nan", "0", "0"), "--start: expected a finite number, got 'nan'"),
        (("--start", "1", "1", "0", "--poses", "x.tum"), "--start: is for poses that are fitted to a map"),
    ],
)
def test_a_bad_start_is_wrong_usage(world: Path, tmp_path: Path, capsys, more, message):
    code = on_map("calibrate", world, "lone.carmen", tmp_path / "out", *LONE, "--quiet", *more)
    assert re.search(message, one_line(capsys, code, 2))


def named(name: str) -> Finding:
    return Finding(name, "warning", f"{name}.", do="Mend it.")


@pytest.mark.parametrize(
    "doubted_by",
    ["reference-slides", "map-disagrees-in-part", "map-out-of-date", "map-disagrees", "odometry-disagrees"],
)
@pytest.mark.parametrize("fault", ["laser-mount", "scan-parts-disagree"])
def test_own_poses_give_way_where_the_fitted_ones_show_what_is_wrong_with_robot_or_map(
    world: Path, monkeypatch, doubted_by: str, fault: str
):
    sensor, grid = read_log(world / "log.carmen").only_sensor(), read_map(world / "map.yaml")
    found = (named(doubted_by),)
    # The fitted poses are in doubt, too; but poses that fit the whole drive show that the map is what is wrong.
    monkeypatch.setattr(reference_checks, "pose_findings", lambda *_: found)
    unless = "own-poses-agree" if doubted_by == "map-disagrees" else None
    for faults, expected in (((), unless), ((named(fault),), "own-poses-agree")):
        fit = replace(fit_of(world), findings=faults)
        monkeypatch.setattr(fitted_poses, "fit_trajectory", lambda *_, fit=fit, **__: fit)
        better = instead_of_own(sensor, grid, found, StageProgress(quiet=True))
        assert (better and better.instead_of.name) == expected
    assert fault in [one.name for one in better.findings()]
    assert instead_of_own(sensor, grid, (named("pose-in-wall"),), StageProgress(quiet=True)) is None


@pytest.mark.usefixtures("fitted_once")
@pytest.mark.parametrize("turn_scale", [1.0, 2.0])
def test_a_right_map_is_not_blamed_for_own_poses_that_lie_a_little_off(world: Path, turn_scale: float):
    log, grid = read_log(world / "log.carmen").only_sensor(), read_map(world / "map.yaml")
    steps = between(log.odometry[:-1], log.odometry[1:]) * np.array([1.0, 1.0, turn_scale])
    off = replace(log, poses=log.poses + np.array([0.2, 0.2, np.radians(6.0)]), odometry=chained(np.zeros(3), steps))
    arguments = argparse.Namespace(map=world / "map.yaml")
    _, instead, found = posed_log(off, grid, arguments, StageProgress(quiet=True), world / "log.carmen", None, None)
    at_own, at_fitted = (
        {one.name for one in reference_checks.pose_findings(posed, grid)} & IN_DOUBT for posed in (off, instead.log)
    )
    assert at_own - {"odometry-disagrees"}
    assert at_fitted == ({"odometry-disagrees"} if turn_scale > 1.0 else set())
    assert instead.instead_of.name == "own-poses-agree"
    assert not any(one.name in REFUTED for one in found)


def test_fitted_poses_that_slide_are_not_answered_with_the_advice_to_fit_some():
    slides = Finding("reference-slides", "warning", "", do="Take the poses that beamfield trajectory fits to a map.")
    (judged,) = with_map_judged((slides,), SimpleNamespace())
    assert "Map that place anew" in judged.do
    assert "Take the poses" not in judged.do


def test_a_map_that_disagrees_with_poses_that_fit_the_whole_drive_is_out_of_date(world: Path):
    disagrees = Finding("map-disagrees", "warning", "", {"median_agreement": 0.4})
    fitted = SimpleNamespace(fit=fit_of(world))
    in_wall, outdated = with_map_judged((named("pose-in-wall"), disagrees), fitted)
    assert (in_wall.name, outdated.name, outdated.values) == ("pose-in-wall", "map-out-of-date", disagrees.values)
    assert outdated.text.startswith("40% of a scan's readings agree")
    hardly = replace(disagrees, values={"median_agreement": 0.2})
    assert with_map_judged((hardly,), fitted) == (hardly,)
    fitted.fit = replace(fit_of(world), findings=(named("kidnapped"),))
    assert with_map_judged((disagrees,), fitted) == (disagrees,)
    fitted.fit = replace(fit_of(world), trusted=np.arange(160) < 143)
    assert with_map_judged((disagrees,), fitted) == (disagrees,)


def test_doctor_names_the_robots_fault_first_and_does_not_blame_the_motion_noise_for_it(
    world: Path, lost: str, tmp_path: Path, monkeypatch, capsys
):
    file = nav2_file(tmp_path)
    file.write_text(file.read_text().replace("max_beams: 30", "max_beams: 5"))
    for faults, is_judged in (((), True), ((named("odometry-sign"),), False)):
        fit = replace(fit_of(world), findings=faults)
        monkeypatch.setattr(fitted_poses, "fit_trajectory", lambda *_, fit=fit, **__: fit)
        main(["doctor", str(file), "--map", str(world / "map.yaml"), "--log", str(world / lost)])
        said = capsys.readouterr().out
        assert ("motion-noise-wide" in said) == is_judged
    assert said.index("warning: odometry-sign") < said.index("warning: few-usable-beams")


@pytest.mark.parametrize(("fault", "is_judged"), [("kidnapped", True), ("map-out-of-date", False)])
def test_doctor_does_not_call_a_map_another_that_is_known_to_be_out_of_date(
    world: Path, lost: str, tmp_path: Path, monkeypatch, capsys, fault: str, is_judged: bool
):
    fit = replace(fit_of(world), findings=(named(fault),))
    monkeypatch.setattr(fitted_poses, "fit_trajectory", lambda *_, **__: fit)
    monkeypatch.setattr(map_checks, "map_findings", lambda *_: [named("map-disagrees")])
    main(["doctor", str(nav2_file(tmp_path)), "--map", str(world / "map.yaml"), "--log", str(world / lost)])
    said = capsys.readouterr().out
    assert f"warning: {fault}" in said
    assert ("warning: map-disagrees" in said) == is_judged


def test_doctor_tests_nothing_at_poses_that_the_map_refutes(world: Path, tmp_path: Path, monkeypatch, capsys):
    def refuse(*_, **__):
        raise TrajectoryNotFoundError("two trajectories fit the log equally well")

    monkeypatch.setattr(fitted_poses, "fit_trajectory", refuse)
    write_another_building(tmp_path / "other.yaml")
    other, log = tmp_path / "other.yaml", world / "log.carmen"
    assert main(["doctor", str(nav2_file(tmp_path)), "--map", str(other), "--log", str(log)]) == 1
    said = capsys.readouterr()
    assert "warning: map-disagrees" in said.out
    assert "readings agree with the map" not in said.err
    assert "motion-noise" not in said.out
    assert "at the log's poses; tests at them are left out" in said.err
