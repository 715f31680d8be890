"""What a command reads is not replaced by what it writes."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from beamfield.cli.main import main

MAP = "image: hall.png\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a map whose picture has its name, texts that are nothing, and a link to the map."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hall.yaml").write_text(MAP)
    Image.fromarray(np.full((20, 30), 254, np.uint8)).save(tmp_path / "hall.png")
    (tmp_path / "link.yaml").symlink_to("hall.yaml")
    names = "drive.txt seen.csv tags.csv trajectory.tum map.yaml beam_model.yaml evaluation.csv"
    for name in names.split():
        (tmp_path / name).write_text("never read")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "kept"),
    [
        (["trajectory", "drive.txt", "--map", "hall.yaml", "--out", "hall.tum"], "hall.png"),
        (["trajectory", "drive.txt", "--map", "hall.yaml", "--out", "drive.txt"], "drive.txt"),
        (["likelihood", "drive.txt", "--map", "link.yaml", "--scan", "0", "--out", "hall.png"], "hall.png"),
        (["inspect", "hall.yaml", "--out", "./hall.png"], "hall.png"),
        (["map", "drive.txt", "--map", "hall.yaml", "--out", "link.yaml"], "link.yaml"),
        (["precompute", "hall.yaml", "--max-range", "5", "--out", "hall.png"], "hall.png"),
        (["localize", "drive.txt", "--map", "hall.yaml", "--poses", "trajectory.tum", "--out", "."], "trajectory.tum"),
        (["simulate", "--map", "map.yaml", "--out", "."], "map.yaml"),
        (["check", "drive.txt", "--map", "hall.yaml", "--params", "beam_model.yaml", "--out", "."], "beam_model.yaml"),
        (["calibrate", "drive.txt", "--map", "beam_model.yaml", "--out", "."], "beam_model.yaml"),
        (["evaluate", "drive.txt", "--map", "hall.yaml", "--params", "evaluation.csv", "-o", "."], "evaluation.csv"),
        (["calibrate-landmarks", "seen.csv", "--landmarks", "tags.csv", "--out", "tags.csv"], "tags.csv"),
    ],
)
def test_an_output_that_would_replace_an_input_is_refused_before_the_work(place, words, kept, capsys):
    before = {path: path.read_bytes() for path in place.iterdir()}
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.endswith(
        f"beamfield: error: {kept}: this is read as input and would be replaced; write under another name\n"
    )
    assert {path: path.read_bytes() for path in place.iterdir()} == before


def test_the_picture_of_a_new_map_is_none_of_an_old_one(place, capsys):
    shutil.move(place / "hall.png", place / "new.pgm")
    (place / "hall.yaml").write_text(MAP.replace("hall.png", "new.pgm"))
    assert main(["map", "drive.txt", "--map", "hall.yaml", "--out", "new.yaml"]) == 2
    assert "new.pgm: this is read as input" in capsys.readouterr().err


@pytest.mark.usefixtures("place")
def test_inspect_does_not_propose_the_name_of_a_picture_that_is_there(capsys):
    assert main(["inspect", "hall.yaml"]) == 0
    assert "to see it, add --out hall_drawn.png" in capsys.readouterr().out


def test_a_file_is_patched_with_what_was_read_from_it(place):
    path = place / "nav2_params.yaml"
    values = "laser_model_type: likelihood_field_prob, z_hit: 0.6, z_rand: 0.4, sigma_hit: 0.2, max_beams: 30"
    path.write_text(f"amcl:\n  ros__parameters: {{{values}, laser_likelihood_max_dist: 2.0}}\n")
    assert (
        main(["translate", path.name, "--stack", "nav2", "--to", "nav2", "--max-range", "12", "--patch", path.name])
        == 0
    )
    assert (place / "nav2_params.yaml.bak").exists()


@pytest.mark.parametrize("model", ["likelihood_field_prob", "beam"])
def test_a_file_to_patch_is_not_replaced_by_the_new_file_of_its_program(place, model, capsys):
    path = place / "nav2.yaml"
    values = f"laser_model_type: {model}, z_hit: 0.5, z_rand: 0.5, sigma_hit: 0.2"
    path.write_text(f"amcl:\n  ros__parameters: {{{values}}}\n")
    words = ["calibrate", "drive.txt", "--map", "hall.yaml", "--stack", "nav2", "--patch", "nav2.yaml", "--out", "."]
    assert main(words) == 2
    assert "nav2.yaml: this is read as input and would be replaced" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["precompute", "hall.yaml"], ["calibrate", "drive.txt"]])
def test_a_dash_is_no_name_of_an_output(place, words, capsys):
    assert main([*words, "--out", "-"]) == 2
    assert "expected a name, not stdout" in capsys.readouterr().err
    assert not (place / "-").exists()


@pytest.mark.parametrize(
    "words",
    [
        ["calibrate", "drive.txt", "--out=~/out"],
        ["precompute", "hall.yaml", "--out=~"],
        ["localize", "drive.txt", "--mcap=~/a.mcap"],
    ],
)
def test_the_home_folder_is_not_made_where_the_shell_left_its_short_name(place, words, capsys):
    assert main(words) == 2
    assert "only the shell knows ~, and not after =: write $HOME" in capsys.readouterr().err
    assert not (place / "~").exists()


@pytest.fixture
def bag(place: Path) -> Path:
    """A folder with two recordings that its metadata lists; none is ever read."""
    folder = place / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("relative_file_paths: [bag_0.mcap, bag_1.mcap]")
    for name in ("bag_0.mcap", "bag_1.mcap"):
        (folder / name).write_text("never read")
    return folder


@pytest.mark.parametrize("log", ["bag", "bag/bag_0.mcap"])
@pytest.mark.parametrize(
    ("command", "options"), [("localize", []), ("check", []), ("calibrate", []), ("evaluate", ["--params", "seen.csv"])]
)
def test_a_recording_replaces_no_file_of_the_bag_that_is_read(bag, command, options, log, capsys):
    assert main([command, log, "--map", "hall.yaml", *options, "--mcap", "bag/bag_1.mcap"]) == 2
    assert "bag_1.mcap: this is read as input and would be replaced" in capsys.readouterr().err
    assert (bag / "bag_1.mcap").read_text() == "never read"


@pytest.mark.parametrize("log", ["bag", "bag/bag_0.mcap"])
def test_a_recording_is_not_put_among_those_of_the_log(bag, log, capsys):
    assert main(["localize", log, "--map", "hall.yaml", "--mcap", "bag/new.mcap"]) == 2
    assert "bag/new.mcap would lie in the folder of the log, and be read as part of it" in capsys.readouterr().err
    assert not (bag / "new.mcap").exists()


def test_the_poses_of_a_folder_are_not_replaced(place, capsys):
    (place / "sonars").mkdir()
    for name in ("measurement.txt", "poses.txt"):
        (place / "sonars" / name).write_text("never read")
    assert main(["trajectory", "sonars", "--map", "hall.yaml", "--out", "sonars/poses.txt"]) == 2
    assert "poses.txt: this is read as input and would be replaced" in capsys.readouterr().err
