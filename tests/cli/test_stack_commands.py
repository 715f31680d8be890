"""``beamfield doctor`` and ``beamfield translate`` as a user runs them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from beamfield.cli.main import main
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.maps.occupancy import OccupancyGrid
from tests.io.mini_bag import MiniBag

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


def test_the_doctor_says_whose_file_it_takes_it_for_where_that_is_not_sure(good, capsys):
    main(["doctor", str(good)])
    assert "read as" not in capsys.readouterr().err
    good.write_text(GOOD.replace("    model_unknown_space: false\n", ""))
    main(["doctor", str(good)])
    assert "note: read as nav2's; pass --stack beluga if that is what the robot runs" in capsys.readouterr().err


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
    write_map(grid, tmp_path / "map.yaml")
    assert main(["doctor", str(good), "--stack", "nav2", "--map", str(tmp_path / "map.yaml"), "--json"]) == 1
    found = {item["name"]: item for item in json.loads(capsys.readouterr().out)["findings"]}
    assert found["map-yaw-ignored"]["values"]["yaw"] == pytest.approx(0.2)
    assert found["half-cell-shift"]["values"] == {"shift": 0.25, "sigma": 0.2}
    assert found["foreign-name"]["parameter"] == "model_unknown_space"


def test_the_doctor_looks_for_the_frames_of_a_bag(good, tmp_path, capsys):
    good.write_text(GOOD + "    base_frame_id: base_footprint\n    odom_frame_id: odom\n")
    bag = MiniBag().tf("base_link", "laser", 0.0, static=True)
    for t in (1.0, 2.0):
        bag.tf("odom", "base_link", t).scan(t)
    assert main(["doctor", str(good), "--log", str(bag.write(tmp_path)), "--json"]) == 1
    found = {item["name"]: item for item in json.loads(capsys.readouterr().out)["findings"]}
    assert found["frame-not-in-log"]["parameter"] == "base_frame_id"
    assert found["frame-not-in-log"]["seen"].endswith("do not have, but base_link")


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
    assert "# not the same weights" not in captured.out
    assert "the same relative weights at equal distances, if what is assumed below is true: computed for" in lines[1]
    assert lines[2].startswith("# assumed that the sensor's longest range is 10 m or more")
    assert captured.err == ""


def test_notes_are_said_once_wherever_the_streams_go(good, capsys, monkeypatch):
    """The printed file has them in its head; a screen that does not show it gets them from the other stream."""
    words = ["translate", str(good), "--to", "mrpt", "--max-range", "12"]
    for out_is_screen, err_is_screen, said in ((True, True, False), (False, False, False), (False, True, True)):
        monkeypatch.setattr("sys.stdout.isatty", lambda shown=out_is_screen: shown)
        monkeypatch.setattr("sys.stderr.isatty", lambda shown=err_is_screen: shown)
        assert main(words) == 0
        shown = capsys.readouterr()
        assert "// the same relative weights at equal distances: computed for" in shown.out
        assert ("note: the same relative weights at equal distances" in shown.err) is said


def test_translation_patches_the_users_file(good, tmp_path, capsys):
    target = tmp_path / "nav2.yaml"
    target.write_text("amcl:\n  ros__parameters:\n    z_hit: 0.5  # mine\n    alpha1: 0.2\n")
    assert main(["translate", str(good), "--to", "nav2", "--patch", str(target)]) == 0
    text = target.read_text()
    assert "    z_hit: 0.947236  # mine\n    alpha1: 0.2\n" in text
    assert "    sigma_hit: 0.2\n" in text
    assert (tmp_path / "nav2.yaml.bak").read_text().startswith("amcl:")
    assert "the old file is nav2.yaml.bak" in capsys.readouterr().out


def test_a_patch_says_which_launch_arguments_it_replaced(good, tmp_path, capsys):
    target = tmp_path / "amcl.launch"
    tags = "".join(f'<param name="laser_{name}" value="$(arg {name})"/>' for name in ("z_hit", "z_rand"))
    target.write_text(
        f'<launch><arg name="z_hit" default="0.5"/><node pkg="amcl" type="amcl" name="amcl">{tags}</node></launch>'
    )
    assert main(["translate", str(good), "--to", "ros1", "--patch", str(target)]) == 0
    assert '<param name="laser_z_hit" value="0.947236"/>' in target.read_text()
    assert "note: replaced $(arg z_hit), $(arg z_rand) by values, which arguments at launch" in capsys.readouterr().err


def test_translation_writes_a_launch_file_that_can_be_read(good, tmp_path, capsys):
    out = tmp_path / "amcl.launch"
    assert main(["translate", str(good), "--to", "ros1", "--out", str(out)]) == 0
    assert '<param name="laser_z_hit" value="0.947236"/>' in out.read_text()
    # The product says what ROS 1's default spoils, and nothing else is wrong.
    assert "set recovery_alpha_slow and recovery_alpha_fast to 0" in out.read_text()
    capsys.readouterr()
    assert main(["doctor", str(out), "--json"]) == 1
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert [one["name"] for one in findings if one["severity"] != "info"] == ["recovery-in-product"]


def test_what_cannot_be_translated_is_one_line(good, tmp_path, capsys):
    out = tmp_path / "new.yaml"
    assert main(["translate", str(good), "--to", "f1tenth", "--out", str(out)]) == 2
    err = capsys.readouterr().err
    assert "f1tenth has no model that weighs as beluga's likelihood_field_prob does" in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_the_doctor_takes_reference_poses_from_a_file(good, tmp_path, capsys):
    grid = OccupancyGrid.from_ros(np.pad(np.zeros((60, 80)), 1, constant_values=100), resolution=0.1)
    write_map(grid, tmp_path / "map.yaml")
    lines = [f"FLASER 90 {' '.join(['2.0'] * 90)} 0 0 0 0 0 0 {t} host {t}" for t in range(30)]
    (tmp_path / "run.log").write_text("\n".join(lines) + "\n")
    (tmp_path / "poses.tum").write_text("".join(f"{t} 4 3 0 0 0 0 1\n" for t in range(30)))
    inputs = ["--map", str(tmp_path / "map.yaml"), "--log", str(tmp_path / "run.log")]
    words = ["doctor", str(good), "--model", "likelihood_field", "--json", *inputs]
    assert main([*words, "--poses", str(tmp_path / "poses.tum"), "--max-range", "10"]) == 1
    found = {item["name"]: item for item in json.loads(capsys.readouterr().out)["findings"]}
    assert "in the log" in found["nearly-flat"]["seen"]
    assert main(["doctor", str(good), "--poses", str(tmp_path / "poses.tum")]) == 2
    assert "--poses: are poses of a log's scans, but there is no --log" in capsys.readouterr().err
    assert main(["doctor", str(good), "--sensor", "/scan"]) == 2
    assert "--sensor: says how a log is read, but there is no --log" in capsys.readouterr().err


def test_the_doctor_sees_thresholds_that_lose_cells(good, tmp_path, capsys):
    Image.fromarray(np.repeat([[120, 130]], 20, axis=0).astype(np.uint8)).save(tmp_path / "map.png")
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
    assert "give --section by label or line" in capsys.readouterr().err
    assert main([*words, "--patch-section", "/r2/amcl.ros__parameters"]) == 0
    assert target.read_text().startswith(TWO.replace("0.6", "0.947236"))
    assert main(["translate", str(good), "--to", "nav2", "--patch-section", "x"]) == 2


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
    assert main(["translate", str(good), "--to", to, "--out", str(tmp_path / name)]) == 2
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
    words = ["doctor", str(good), "--stack", "nav2", "--json"]
    words += ["--map", str(folder / "map" / "mac_1st_floor_final.yaml")]
    words += ["--log", str(folder / "macfirst_floor_take_2"), "--poses", str(folder / "derived_ref_take_2.csv.gz")]
    assert main(words) == 1
    found = {item["name"]: item for item in json.loads(capsys.readouterr().out)["findings"]}
    assert "in the log (median of up to 9 scans)" in found["nearly-flat"]["seen"]
    assert found["range-limit-hides-readings"]["values"]["hidden_share"] > 0.05


BEAM_MODEL = """\
beam_model:
  z_hit: 0.6
  z_short: 0.1
  z_max: 0.1
  z_rand: 0.2
  sigma_hit: 0.014
  lambda_short: 0.3
  range_offset: 0.01
  sigma_slope: 0.015
sensor:
  name: scan
  min_range: 0.15
  max_range: 12.0
"""
LOSSES = ("range_offset 0.01 m is lost", "sigma_slope 0.015 is lost", "min_range 0.15 m is lost")


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "beam_model.yaml"
    path.write_text(BEAM_MODEL)
    return path


def test_beamfields_own_model_is_translated_with_its_losses(own, capsys):
    assert main(["translate", str(own), "--to", "nav2"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("# nav2 beam, from beamfield's beam model by beamfield")
    assert "# not the same weights" in out
    assert all(loss in out for loss in LOSSES)
    assert 'laser_model_type: "beam"' in out


def test_a_users_file_gets_beamfields_own_model_with_the_same_notes(own, tmp_path, capsys):
    """In the model that the file chooses; once the numbers of densities went into nav2's field as they were."""
    target = tmp_path / "nav2.yaml"
    target.write_text(
        "amcl:\n  ros__parameters:\n    laser_model_type: likelihood_field_prob\n    z_hit: 0.5  # mine\n"
    )
    words = ["translate", str(own), "--to", "nav2", "--patch", str(target)]
    assert main(words) == 0
    err = capsys.readouterr().err
    assert "note: not the same weights" in err
    assert all(f"note: {loss}" in err for loss in LOSSES)
    assert f"note: likelihood_field_prob was chosen, because {target} chooses it" in err
    text = target.read_text()
    assert "laser_model_type: likelihood_field_prob" in text
    sigma = np.sqrt(0.014**2 + 0.01**2 + (0.015 * 4.0) ** 2)
    peak = 0.6 / (np.sqrt(2 * np.pi) * sigma)
    assert f"z_hit: {peak / (peak + 0.2):.6g}  # mine" in text
    assert main([*words, "--to-model", "beam"]) == 0
    assert "note: the file chose likelihood_field_prob before, now beam" in capsys.readouterr().err
    assert main([*words, "--to-model", "foo"]) == 2
    assert "--to-model: nav2 has likelihood_field, likelihood_field_prob, beam, got 'foo'" in capsys.readouterr().err


def test_beamfields_own_model_is_named_in_one_line_by_the_others(own, tmp_path, capsys):
    target = tmp_path / "other.yaml"
    target.write_text(BEAM_MODEL)
    (tmp_path / "p.yaml").write_text(GOOD)
    for words in (
        ["doctor", str(own)],
        ["translate", str(tmp_path / "p.yaml"), "--to", "nav2", "--patch", str(target)],
        ["calibrate", "run.log", "--map", "map.yaml", "--stack", "nav2", "--patch", str(target)],
    ):
        assert main(words) == 1
        captured = capsys.readouterr()
        assert "this is beamfield's own beam model" in captured.err
        assert "`beamfield calibrate LOG --map MAP --stack nav2`" in captured.err
        assert captured.err.count("\n") == 1
        assert captured.out == ""
    assert target.read_text() == BEAM_MODEL


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "f1tenth"], "--resolution: F1TENTH measures sigma_hit in cells of the map"),
        (["--to", "nav2", "--stack", "nav2"], "--stack: is for files of a stack"),
        (["--to", "nav2", "--max-range", "9"], "--max-range: is for files of a stack"),
        (["--to", "chapter", "--out", "x.yaml"], "--out: is for files of a stack, chapter has none"),
    ],
)
def test_options_that_do_not_fit_beamfields_own_model_are_refused(own, capsys, words, message):
    assert main(["translate", str(own), *words]) == 2
    assert message in capsys.readouterr().err


def test_belugas_file_for_ros_1_is_patched_under_its_names(tmp_path):
    target = tmp_path / "default.ros.yaml"
    target.write_text("laser_z_hit: 0.5  # mine\nexecution_policy: seq\n")
    nav2 = tmp_path / "nav2.yaml"
    nav2.write_text("amcl:\n  ros__parameters:\n    z_hit: 0.7\n    z_rand: 0.3\n    laser_max_range: 10.0\n")
    words = ["translate", str(nav2), "--stack", "nav2", "--to", "beluga", "--max-range", "12", "--patch", str(target)]
    assert main(words) == 0
    text = target.read_text()
    assert f"laser_z_hit: {0.7 * np.sqrt(2 * np.pi) * 0.2:.6g}  # mine\n" in text
    assert "\nz_hit" not in text
    assert "laser_sigma_hit: 0.2" in text
