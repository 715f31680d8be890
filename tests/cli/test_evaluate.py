"""``beamfield evaluate``: what it prints, writes and refuses."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from beamfield.cli.main import main
from beamfield.io.maps.ros_map_writer import moved_map_text
from tests.cli.simulated import on_map, simulated

SEEDS = 10
# Weights that say nothing, and odometry that is trusted too little: the particles drift apart.
FEW = "    min_particles: 100\n    max_particles: 300\n"
BLIND = f"amcl:\n  ros__parameters:\n    z_hit: 0.0\n    alpha2: 0.5\n    alpha3: 0.5\n    sigma_hit: 0.2\n{FEW}"
SIGHTED = (
    "amcl:\n  ros__parameters:\n    laser_model_type: likelihood_field_prob\n    max_beams: 20\n"
    f"    model_unknown_space: false\n{FEW}    alpha1: 0.05\n    alpha2: 0.05\n    alpha3: 0.05\n    alpha4: 0.05\n"
)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive through a building, and a parameter file of nav2 and one of Beluga."""
    folder = tmp_path_factory.mktemp("evaluate")
    simulated(folder / "drive", "--duration 30 --scan-rate 4 --beams 61")
    (folder / "blind.yaml").write_text(BLIND)
    (folder / "sighted.yaml").write_text(SIGHTED)
    return folder


def evaluate(world: Path, out: Path, *words: str, params: tuple[str, ...] = ("blind.yaml", "sighted.yaml")) -> int:
    return on_map(
        "evaluate", world / "drive", "log.carmen", out, "--params", *(str(world / name) for name in params), *words
    )


@pytest.fixture(scope="module")
def result(world: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("result") / "out"
    assert evaluate(world, out, "--seeds", str(SEEDS), "--kidnap", "--quiet") == 0
    return out


def test_it_writes_all_runs_and_a_figure(result):
    assert sorted(path.name for path in result.iterdir()) == ["evaluation.csv", "evaluation.json", "evaluation.svg"]
    with (result / "evaluation.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * SEEDS
    assert {row["filter"] for row in rows} == {"blind.yaml", "sighted.yaml"}
    document = json.loads((result / "evaluation.json").read_text())
    runs = document["filters"]["sighted.yaml"]["tracking"][0]["runs"]
    assert [f"{run['mean']:.6g}" for run in runs] == [row["mean"] for row in rows if row["filter"] == "sighted.yaml"]
    assert (result / "evaluation.svg").read_text().startswith("<?xml")


def test_it_says_which_program_runs_and_which_differences_are_real(result):
    document = json.loads((result / "evaluation.json").read_text())
    assert document["stacks"]["blind.yaml"] == {"stack": "nav2", "model": "likelihood_field"}
    assert document["stacks"]["sighted.yaml"] == {"stack": "beluga", "model": "likelihood_field_prob"}
    differences = {one["measure"]: one for one in document["differences"]["sighted.yaml"]}
    assert differences["mean"]["for_sure"] == "lower"
    assert differences["mean"]["high"] < 0.0
    assert document["verdicts"]["sighted.yaml"]["is_better"] is True
    assert document["provenance"]["inputs"].keys() >= {"logs 1", "map", "params 1", "params 2"}


def test_it_counts_the_runs_that_recover_from_a_kidnapping(result):
    document = json.loads((result / "evaluation.json").read_text())
    (found,) = document["filters"]["blind.yaml"]["finding"]
    assert found["task"] == "kidnapping"
    assert found["share"] == 0.0  # it cannot see
    assert len(found["seconds"]) == SEEDS


@pytest.mark.usefixtures("undrawn")
def test_it_prints_tables_the_result_and_the_files(world, tmp_path, capsys):
    recorded = tmp_path / "way.mcap"
    words = ("--seeds", "2", "--global", "--mcap", str(recorded))
    assert evaluate(world, tmp_path / "out", *words, params=("sighted.yaml",)) == 0
    assert b"/position_error_sighted_yaml_m" in recorded.read_bytes()
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert lines[0].split()[:3] == ["log", "filter", "position"]
    assert any(line.startswith("log.carmen  sighted.yaml") for line in lines)
    assert any("global start" in line and " of 2" in line for line in lines)
    assert lines[-3].startswith("mean position error sighted.yaml 0.")
    assert lines[-1].startswith("wrote evaluation.csv, evaluation.json, evaluation.svg into ")
    assert "sighted.yaml on log.carmen" in err  # progress


@pytest.mark.usefixtures("undrawn")
def test_a_file_of_several_programs_is_noted(world, tmp_path, capsys):
    assert evaluate(world, tmp_path / "out", "--seeds", "1", params=("blind.yaml",)) == 0
    assert "blind.yaml: read as nav2's; pass --stack beluga if that is what the robot runs" in capsys.readouterr().err
    assert evaluate(world, tmp_path / "out", "--seeds", "1", "--stack", "nav2", params=("blind.yaml",)) == 0
    assert "pass --stack" not in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_a_filter_may_read_a_map_of_its_own_and_files_of_one_name_are_told_apart(world, tmp_path, capsys):
    moved = world / "drive" / "moved.yaml"
    moved.write_text(moved_map_text(world / "drive" / "map.yaml", (0.4, 0.0), "map.pgm"))
    maps = ("--filter-maps", str(world / "drive" / "map.yaml"), str(moved))
    noted = "sighted.yaml: its values were chosen for the map amcl_map.yaml: give that with --filter-maps"
    (world / "again").mkdir()
    (world / "again" / "sighted.yaml").write_text(f"{SIGHTED}# chosen for the map amcl_map.yaml\n")
    params = ("sighted.yaml", "again/sighted.yaml")
    assert evaluate(world, tmp_path / "out", "--seeds", "2", *maps, params=params) == 0
    document = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert list(document["filters"]) == [f"{world.name}/sighted.yaml", "again/sighted.yaml"]
    right, wrong = (one["tracking"][0]["means"]["mean"] for one in document["filters"].values())
    # The whole map lies 0.4 m to one side, and so does the answer.
    assert abs(wrong - 0.4) < right + 0.05
    assert document["provenance"]["inputs"]["filter maps 2"]["name"] == "moved.yaml"
    assert noted not in capsys.readouterr().err
    assert evaluate(world, tmp_path / "out", "--seeds", "1", params=params[1:]) == 0
    assert noted in capsys.readouterr().err
    assert evaluate(world, tmp_path / "out", *maps[:2], params=params) == 2


@pytest.mark.usefixtures("undrawn")
def test_a_map_that_a_program_misreads_is_noted_with_the_file_whose_filter_reads_it(world, tmp_path, capsys):
    turned = world / "drive" / "turned.yaml"
    turned.write_text(re.sub(r"(origin: .*), 0.0\]", r"\1, 0.3]", (world / "drive" / "map.yaml").read_text()))
    maps = ("--filter-maps", str(world / "drive" / "map.yaml"), str(turned))
    params = ("sighted.yaml", "blind.yaml")
    assert evaluate(world, tmp_path / "out", "--seeds", "1", *maps, "--stack", "nav2", params=params) == 0
    said = capsys.readouterr().err
    assert "blind.yaml: the map's origin has a yaw of 17.2 degrees: nav2 takes only the origin's x and y" in said
    assert "sighted.yaml: the map's origin" not in said


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BLIND.replace("alpha2: 0.5", "alpha2: -0.5"), "alpha2: expected a number >= 0, got -0.5"),
        (BLIND.replace("300", "many"), "max_particles: expected a number, got 'many'"),
        (BLIND + "    robot_model_type: hovercraft\n", "robot_model_type: expected one of"),
        (
            "[KLD_options]\nKLD_delta = 2\n[MetricMap_occupancyGrid_00_likelihoodOpts]\nLF_stdHit = 0.1\n",
            "bad.ini:2: KLD_delta: expected a probability below 1, got 2.0",
        ),
    ],
)
def test_a_file_that_cannot_be_run_is_refused_on_one_line(world, tmp_path, capsys, text, message):
    name = "bad.ini" if text.startswith("[") else "bad.yaml"
    (world / name).write_text(text)
    assert evaluate(world, tmp_path / "out", params=(name,)) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("undrawn")
def test_every_program_s_filter_runs(world, tmp_path):
    files = {
        "pf.ini": "[MetricMap_occupancyGrid_00_likelihoodOpts]\nlikelihoodMethod = 4\nLF_stdHit = 0.2\n",
        "f1tenth.yaml": "particle_filter:\n  ros__parameters:\n    squash_factor: 4.0\n    max_particles: 500\n"
        "    angle_step: 6\n    motion_dispersion_theta: 0.05\n",
        "beluga_1.yaml": "laser_z_hit: 0.9\nselective_resampling: true\nodom_alpha3: 0.05\nkld_err: 0.05\n",
    }
    for name, text in files.items():
        (world / name).write_text(text)
    assert evaluate(world, tmp_path / "out", "--seeds", "1", "--quiet", params=tuple(files)) == 0
    document = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert {one["stack"] for one in document["stacks"].values()} == {"mrpt", "f1tenth", "beluga"}
    for name in files:
        (tracking,) = document["filters"][name]["tracking"]
        assert tracking["runs"][0]["mean"] < 0.6


@pytest.mark.usefixtures("undrawn")
def test_it_says_why_a_filter_cannot_follow(world, tmp_path, capsys):
    lines = (world / "drive" / "log.carmen").read_text().splitlines()
    turned = []
    for line in lines:
        words = line.split()
        if words[0] == "FLASER":
            words[-4] = str(-float(words[-4]))  # the odometry's heading
        turned.append(" ".join(words))
    log = world / "drive" / "turned.carmen"
    log.write_text("\n".join(turned) + "\n")
    (world / "none.yaml").write_text(SIGHTED + "    z_hit: 0.0\n    z_rand: 0.0\n")
    given = ("--map", str(world / "drive" / "map.yaml"), "--params", str(world / "none.yaml"), "--seeds", "1")
    assert main(["evaluate", str(log), *given, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert "none.yaml: one scan gives all 2000 particles" in said
    assert "turned.carmen: The odometry is wrong in" in said


def test_only_one_sensor_can_be_replayed(world, tmp_path, capsys):
    assert evaluate(world, tmp_path / "out", "--sensor", "FLASER", "--sensor", "RLASER") == 2
    assert "--sensor: expected one, got FLASER, RLASER" in capsys.readouterr().err


def test_poses_must_go_with_the_logs(world, tmp_path, capsys):
    assert evaluate(world, tmp_path / "out", "--poses", "a.tum", "b.tum") == 2
    assert "--poses: expected one file for each LOG, got 2 for 1" in capsys.readouterr().err
