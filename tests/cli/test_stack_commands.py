"""``beamfield doctor`` and ``beamfield translate`` as a user runs them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from beamfield.cli.main import main
from beamfield.io.ros_map import save_map
from beamfield.maps.occupancy import OccupancyGrid

GOOD = """\
amcl:
  ros__parameters:
    laser_model_type: likelihood_field_prob
    model_unknown_space: false
    z_hit: 0.9  # of a hit
    z_rand: 0.1
    sigma_hit: 0.2
    max_beams: 20
    laser_max_range: 10.0
"""


@pytest.fixture
def good(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text(GOOD)
    return path


def test_the_doctor_is_content_with_a_good_file(good, capsys):
    assert main(["doctor", str(good)]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0].endswith("params.yaml: beluga, likelihood_field_prob, section amcl.ros__parameters")
    assert out.splitlines()[-1] == "nothing found"


def test_the_doctor_names_what_is_wrong(good, capsys):
    good.write_text(GOOD.replace("z_rand: 0.1", "z_rand: .nan"))
    assert main(["doctor", str(good)]) == 1
    out = capsys.readouterr().out
    assert "error: not-finite (line 6)\n  seen: z_rand is nan\n" in out
    assert out.splitlines()[-1] == "1 error"


def test_the_doctor_speaks_json(good, capsys):
    good.write_text(GOOD.replace("z_rand: 0.1", "z_rand: 1"))
    assert main(["doctor", str(good), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["stack"] == "beluga"
    assert document["stack_is_certain"] is True
    first = document["findings"][0]
    assert (first["name"], first["severity"], first["parameter"], first["line"]) == ("wrong-type", "error", "z_rand", 6)


def test_the_doctor_looks_at_the_map(good, tmp_path, capsys):
    grid = OccupancyGrid.from_ros([[100, 0, 0], [0, 0, 0]], resolution=0.5, origin=(0.0, 0.0, 0.2))
    save_map(grid, tmp_path / "map.yaml")
    assert main(["doctor", str(good), "--stack", "nav2", "--map", str(tmp_path / "map.yaml"), "--json"]) == 1
    found = {item["name"]: item for item in json.loads(capsys.readouterr().out)["findings"]}
    assert found["map-yaw-ignored"]["values"]["yaw"] == pytest.approx(0.2)
    assert found["half-cell-shift"]["severity"] == "warning"
    assert found["foreign-name"]["parameter"] == "model_unknown_space"


def test_a_file_without_parameters_is_an_error_on_one_line(tmp_path, capsys):
    path = tmp_path / "other.yaml"
    path.write_text("a: 1\n")
    assert main(["doctor", str(path)]) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"beamfield: error: {path}: no parameters of a measurement model")
    assert err.count("\n") == 1


def test_translation_is_printed_as_the_other_stacks_file(good, capsys):
    assert main(["translate", str(good), "--to", "nav2"]) == 0
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert lines[0].startswith("# nav2 likelihood_field_prob, from beluga likelihood_field_prob by beamfield")
    body = dict(line.strip().split(": ") for line in lines if ": " in line and line.startswith("    "))
    # 0.9 / (0.2 sqrt(2 pi)) against 0.1
    assert float(body["z_hit"]) / float(body["z_rand"]) == pytest.approx(9.0 / 0.501326, rel=1e-4)
    assert body["max_beams"] == "20"
    assert "note: the same relative weights\n" in captured.err


def test_notes_that_the_printed_file_holds_are_not_said_twice_on_a_screen(good, capsys, monkeypatch):
    words = ["translate", str(good), "--to", "mrpt", "--max-range", "12"]
    assert main(words) == 0
    piped = capsys.readouterr()
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert main(words) == 0
    shown = capsys.readouterr()
    assert shown.out == piped.out
    assert "note: the same relative weights" in piped.err or "note: not exactly" in piped.err
    notes = [line.removeprefix("note: ") for line in shown.err.splitlines()]
    assert len(notes) < len(piped.err.splitlines())
    assert not any(note in shown.out for note in notes)


def test_translation_patches_the_users_file(good, tmp_path, capsys):
    target = tmp_path / "nav2.yaml"
    target.write_text("amcl:\n  ros__parameters:\n    z_hit: 0.5  # mine\n    alpha1: 0.2\n")
    assert main(["translate", str(good), "--to", "nav2", "--patch", str(target)]) == 0
    text = target.read_text()
    assert "    z_hit: 0.947236  # mine\n    alpha1: 0.2\n" in text
    assert "    sigma_hit: 0.2\n" in text
    assert (tmp_path / "nav2.yaml.bak").read_text().startswith("amcl:")
    assert "the old file is nav2.yaml.bak" in capsys.readouterr().out


def test_translation_writes_launch_lines(good, tmp_path):
    out = tmp_path / "amcl.launch"
    assert main(["translate", str(good), "--to", "ros1", "--out", str(out)]) == 0
    assert '<param name="laser_z_hit" value="0.947236"/>' in out.read_text()


def test_what_cannot_be_translated_is_one_line(good, tmp_path, capsys):
    out = tmp_path / "new.yaml"
    assert main(["translate", str(good), "--to", "f1tenth", "--out", str(out)]) == 1
    err = capsys.readouterr().err
    assert "f1tenth has no model that can weigh as beluga's likelihood_field_prob does" in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_the_doctor_takes_reference_poses_from_a_file(good, tmp_path, capsys):
    grid = OccupancyGrid.from_ros(np.pad(np.zeros((60, 80)), 1, constant_values=100), resolution=0.1)
    save_map(grid, tmp_path / "map.yaml")
    lines = [f"FLASER 90 {' '.join(['2.0'] * 90)} 0 0 0 0 0 0 {t} host {t}" for t in range(30)]
    (tmp_path / "run.log").write_text("\n".join(lines) + "\n")
    (tmp_path / "poses.tum").write_text("".join(f"{t} 4 3 0 0 0 0 1\n" for t in range(30)))
    words = [
        "doctor",
        str(good),
        "--model",
        "likelihood_field",
        "--json",
        "--map",
        str(tmp_path / "map.yaml"),
        "--log",
        str(tmp_path / "run.log"),
    ]
    assert main([*words, "--poses", str(tmp_path / "poses.tum"), "--max-range", "10"]) == 1
    found = {item["name"]: item for item in json.loads(capsys.readouterr().out)["findings"]}
    assert "in the log" in found["nearly-flat"]["seen"]
    assert main(["doctor", str(good), "--poses", str(tmp_path / "poses.tum")]) == 1
    assert "--poses: are poses of a log's scans, but there is no --log" in capsys.readouterr().err


def test_the_doctor_sees_thresholds_that_lose_cells(good, tmp_path, capsys):
    Image.fromarray(np.full((20, 20), 120, np.uint8)).save(tmp_path / "map.png")
    (tmp_path / "map.yaml").write_text(
        "image: map.png\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    assert main(["doctor", str(good), "--map", str(tmp_path / "map.yaml"), "--json"]) == 1
    found = {item["name"]: item for item in json.loads(capsys.readouterr().out)["findings"]}
    assert found["thresholds-lose-cells"]["values"]["share"] == 1.0


TWO = """\
/r1/amcl:
  ros__parameters:
    z_hit: 0.5
/r2/amcl:
  ros__parameters:
    z_hit: 0.6
"""


def test_one_section_of_several_is_patched(good, tmp_path, capsys):
    target = tmp_path / "robots.yaml"
    target.write_text(TWO)
    words = ["translate", str(good), "--to", "nav2", "--patch", str(target)]
    assert main(words) == 1
    assert target.read_text() == TWO
    assert "choose by label or line" in capsys.readouterr().err
    assert main([*words, "--patch-section", "/r2/amcl.ros__parameters"]) == 0
    assert target.read_text().startswith(TWO.replace("0.6", "0.947236"))
    assert main(["translate", str(good), "--to", "nav2", "--patch-section", "x"]) == 1


@pytest.mark.parametrize(("name", "text"), [("ros1.yaml", "laser_z_hit: 0.5\n"), ("p.ini", "[a]\nLF_stdHit = 1\n")])
def test_another_stacks_file_is_not_patched(good, tmp_path, capsys, name, text):
    target = tmp_path / name
    target.write_text(text)
    assert main(["translate", str(good), "--to", "nav2", "--patch", str(target)]) == 1
    err = capsys.readouterr().err
    assert "expected a file of nav2, this is one of" in err
    assert err.count("\n") == 1
    assert target.read_text() == text


@pytest.mark.parametrize(
    ("to", "name", "expected"), [("nav2", "a.ini", ".yaml"), ("nav2", "a.launch", ".yaml"), ("mrpt", "a.yaml", ".ini")]
)
def test_new_files_get_names_by_which_they_are_read_again(good, tmp_path, capsys, to, name, expected):
    assert main(["translate", str(good), "--to", to, "--out", str(tmp_path / name)]) == 1
    assert f"files of {to} end in {expected}, got '{name}'" in capsys.readouterr().err
    assert not (tmp_path / name).exists()


REAL_MAPS = {
    "ros_maps/nav2_depot/depot.yaml": {"unknown-read-as-free"},
    "ros_maps/willow_garage_010/willow-2010-02-18-0.10.yaml": {"thresholds-lose-cells", "unknown-is-free"},
    "ros_maps/aws_small_house/map.yaml": set(),
    "wean_hall/derived_wean.yaml": {"thresholds-lose-cells", "unknown-is-free"},
}
MAP_FINDINGS = {"unknown-read-as-free", "thresholds-lose-cells", "unknown-is-free", "map-mode-loses-cells",
                "map-yaw-ignored", "no-obstacles"}  # fmt: skip


@pytest.mark.real
@pytest.mark.parametrize("name", REAL_MAPS)
def test_the_doctor_judges_real_maps(data, good, capsys, name):
    main(["doctor", str(good), "--stack", "nav2", "--map", str(data / name), "--json"])
    found = {item["name"] for item in json.loads(capsys.readouterr().out)["findings"]}
    assert found & MAP_FINDINGS == REAL_MAPS[name]


@pytest.mark.real
def test_the_doctor_tries_the_model_on_a_real_log(data, good, capsys):
    """nav2's default field hardly looks at the scans of a TurtleBot 4; a longest range of 5 m hides many of them."""
    folder = data / "olin_mac_tb4"
    good.write_text(GOOD.replace("10.0", "5.0").replace("likelihood_field_prob", "likelihood_field"))
    words = [
        "doctor",
        str(good),
        "--stack",
        "nav2",
        "--map",
        str(folder / "map" / "mac_1st_floor_final.yaml"),
        "--json",
    ]
    words += ["--log", str(folder / "macfirst_floor_take_2"), "--poses", str(folder / "derived_ref_take_2.csv.gz")]
    assert main(words) == 1
    found = {item["name"]: item for item in json.loads(capsys.readouterr().out)["findings"]}
    assert "in the log (median of up to 9 scans)" in found["nearly-flat"]["seen"]
    assert found["range-limit-hides-readings"]["values"]["hidden_share"] > 0.05
