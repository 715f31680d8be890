"""``beamfield figures``: which files it writes, what it prints and refuses."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.figures.gallery import FIGURES
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.maps.occupancy import OccupancyGrid
from tests.cli.simulated import simulated


def test_the_list_names_every_figure(capsys):
    assert main(["figures", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(FIGURES)


def test_chosen_figures_and_their_page_are_written(tmp_path, capsys):
    out = tmp_path / "pictures"
    assert main(["figures", "--only", "6.9", "6.8", "--out", str(out)]) == 0
    assert sorted(file.name for file in out.iterdir()) == ["figure_6_8.svg", "figure_6_9.svg", "gallery.md"]
    text = capsys.readouterr().out
    for number in ("6.8", "6.9"):
        assert f"Figure {number}: {FIGURES[number].title}. {FIGURES[number].caption}" in text
        assert f"figure_{number.replace('.', '_')}.svg" in (out / "gallery.md").read_text()
    assert "drawn from: simulated office" in text


def test_a_log_of_ones_own_is_drawn(tmp_path, capsys):
    world, out = simulated(tmp_path / "world", "--duration 10 --beams 60 --seed 1"), tmp_path / "pictures"
    words = ["figures", str(world / "log.carmen"), "--map", str(world / "map.yaml"), "--scan", "50"]
    assert main([*words, "--only", "6.10", "6.11", "6.12", "--format", "png", "--out", str(out), "--quiet"]) == 0
    assert {file.name for file in out.glob("*.png")} == {f"figure_6_{i}.png" for i in (10, 11, 12)}
    assert "drawn from: log.carmen" in capsys.readouterr().out
    # An error leaves no folder behind.
    assert main([*words[:-1], "100", "--out", str(tmp_path / "none"), "--quiet"]) == 2
    assert "error: --scan: the log has scans 0 to 99, got 100" in capsys.readouterr().err
    # What is wrong with a file is not wrong usage, and the file is named.
    assert main([*words[:-2], "--mask=-180:180", "--out", str(tmp_path / "none"), "--quiet"]) == 1
    error = capsys.readouterr().err
    assert f"error: {world / 'log.carmen'}: no scan has both a reference pose and a measured range" in error
    write_map(OccupancyGrid(np.zeros((9, 9)), 0.1), tmp_path / "hall.yaml")
    words[3] = str(tmp_path / "hall.yaml")
    assert main([*words, "--out", str(tmp_path / "none"), "--quiet"]) == 1
    assert f"error: {words[3]}: the map has no occupied cell" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_log_without_poses_is_told_where_to_get_them(tmp_path, capsys):
    world, out = tmp_path / "world", tmp_path / "pictures"
    assert main(["simulate", "--out", str(world), "--duration", "1", "--odometry-only", "--quiet"]) == 0
    words = ["figures", str(world / "log.carmen"), "--map", str(world / "map.yaml"), "--lone-poses", "odometry"]
    assert main([*words, "--only", "6.10", "--out", str(out), "--quiet"]) == 1
    assert "give a TUM or CSV file with --poses, as beamfield trajectory writes one" in capsys.readouterr().err
    assert not out.exists()


def test_a_short_log_gives_what_it_can_and_says_what_not(tmp_path, capsys):
    options = "--duration 1 --scan-rate 5 --beams 60 --seed 1"
    world, out = simulated(tmp_path / "world", options), tmp_path / "pictures"
    words = ["figures", str(world / "log.carmen"), "--map", str(world / "map.yaml"), "--quiet", "--out", str(out)]
    assert main([*words, "--only", "6.3", "6.7", "6.10"]) == 3
    said = capsys.readouterr()
    assert "wrote 1 figure and" in said.out
    assert said.err.count("\n") == 1
    assert "not drawn: Figure 6.3, Figure 6.7: the log does not teach a beam model" in said.err
    assert sorted(file.name for file in out.iterdir()) == ["figure_6_10.svg", "gallery.md"]
    page = (out / "gallery.md").read_text()
    assert page.count("does not teach a beam model") == 2
    assert "- Figure 6.7, " in page
    # Nothing to draw is an error, with nothing written.
    assert main([*words[:-1], str(tmp_path / "none"), "--only", "6.7"]) == 3
    assert "error: Figure 6.7: the log does not teach" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--only", "9.1"], "--only: expected one of 6.1, 6.3"),
        (["--only", "6.2"], "got '6.2': it is part (c) of 6.1"),
        (["some.log"], "expected both, or neither"),
        (["--map", "some.yaml"], "expected both, or neither"),
        (["--scan", "3"], "go with a LOG"),
        (["--mask=3:4"], "--mask: says how a LOG of your own is read, and there is none"),
        (["--seed", "-1"], "--seed: expected a whole number >= 0, got '-1'"),
    ],
    ids=["number", "part", "no-map", "no-log", "scan", "mask", "seed"],
)
def test_bad_input_is_one_line(tmp_path, capsys, words, message):
    assert main(["figures", *words, "--out", str(tmp_path / "x"), "--quiet"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "x").exists()
