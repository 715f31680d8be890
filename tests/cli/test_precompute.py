"""``beamfield precompute``, and the commands that use its table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.io.logs.carmen import write_carmen
from beamfield.io.maps.range_table_file import read_range_table
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import write_tum
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import ScanLog, Track


@pytest.fixture(scope="module")
def folder(tmp_path_factory, office, drive) -> Path:
    place = tmp_path_factory.mktemp("precompute")
    write_map(office, place / "map.yaml")
    write_map(OccupancyGrid(1.0 - np.eye(300), 0.1), place / "other.yaml")
    log = drive[:60]
    write_carmen(place / "drive.log", ScanLog({"FLASER": log}, Track(log.stamps, log.odometry)))
    write_tum(place / "truth.tum", Track(log.stamps, log.poses))
    assert (
        main(["precompute", str(place / "map.yaml"), "-o", str(place / "map.ranges"), "--headings", "120", "-q"]) == 0
    )
    return place


def last_line(capsys) -> str:
    return capsys.readouterr().err.splitlines()[-1]


def test_size_time_and_error_are_said_and_a_table_that_is_there_is_kept(folder, tmp_path, capsys):
    out = tmp_path / "made" / "a.ranges"
    words = ["precompute", str(folder / "map.yaml"), "--out", str(out), "--max-range", "12", "--headings", "90"]
    assert main(words) == 0
    said = capsys.readouterr()
    table = read_range_table(out, read_map(folder / "map.yaml"))
    megabytes = (out.stat().st_size - 4096) / 1e6
    assert f"casting rays for a table of {megabytes:.1f} MB" in said.err
    assert (
        f"table: {len(table.codes):,} places x 90 headings, {megabytes:.1f} MB\nranges: up to 12 m\ntime: " in said.out
    )
    assert f"95%     {table.error.percentile_95:.3f} m" in said.out
    assert f"more than a cell of the map: {table.error.share_off_by_a_cell:.1%} of the rays" in said.out
    assert f"wrote {out}" in said.out
    assert table.plan.max_range == 12.0
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["seconds"] is None
    assert found["wrote"] == []
    assert found["bytes"] == out.stat().st_size - 4096
    assert found["error"]["median"] == table.error.median
    assert main([*words[:-1], "80"]) == 0
    assert f"wrote {out}" in capsys.readouterr().out
    assert main([*words, "--max-size", "1e-6"]) == 2
    assert "beamfield: error: --max-size: the table takes" in last_line(capsys)
    assert read_range_table(out, table.grid).plan.headings == 80


def test_a_map_in_which_nothing_is_free_or_occupied_is_named(tmp_path, capsys):
    for value, what in ((0.0, "no occupied cell"), (1.0, "no free cell")):
        path = tmp_path / "map.yaml"
        write_map(OccupancyGrid(np.full((30, 30), value), 0.1), path)
        assert main(["precompute", str(path), "--out", str(tmp_path / "a.ranges")]) == 1
        assert f"{path}: the map has {what}" in last_line(capsys)
    write_map(OccupancyGrid(np.zeros((30, 30)), 0.1), path)
    assert main(["simulate", "--map", str(path), "--out", str(tmp_path / "out")]) == 1
    assert f"{path}: the map has no occupied cell" in last_line(capsys)


def test_a_robot_is_localized_with_a_table_and_refused_with_one_that_does_not_fit(folder, tmp_path, capsys):
    localize = ["localize", str(folder / "drive.log"), "--poses", str(folder / "truth.tum"), "--particles", "300"]
    localize += ["--out", str(tmp_path / "out"), "--map", str(folder / "map.yaml"), "--json"]
    table = ["--range-table", str(folder / "map.ranges")]
    assert main([*localize, "--model", "beam", *table]) == 0
    assert json.loads(capsys.readouterr().out)["errors"]["mean"] < 0.1
    assert main([*localize, *table]) == 2
    assert "--range-table: only rays are looked up in it, with --model beam" in last_line(capsys)
    other = [*localize[:-3], "--map", str(folder / "other.yaml"), "--model", "beam", "--start", "0.05", "0.05", "0"]
    assert main([*other, *table]) == 1
    assert "map.ranges: the table is of another map, or the map has changed since" in last_line(capsys)
