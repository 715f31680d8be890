"""`beamfield fleet simulate` and `beamfield fleet report`: from raw logs to a page, and again without new work."""

from __future__ import annotations

import json

import pytest

from beamfield.cli.main import main

SMALL = "--robots 2 --sites 1 --days 1 --duration 25 --scan-rate 3 --beams 45 --width 26 --height 20"


def test_a_fleet_is_reported_from_raw_logs_and_the_same_when_asked_again(tmp_path, capsys):
    fleet, report = tmp_path / "fleet", tmp_path / "report"
    assert main(["fleet", "simulate", *SMALL.split(), "--workers", "1", "--out", str(fleet), "--quiet"]) == 0
    truth = json.loads((fleet / "truth.json").read_text())
    words = ["fleet", "report", str(fleet / "manifest.yaml"), "--out", str(report), "--scheduler", "serial", "--json"]
    capsys.readouterr()
    assert main(words) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["command"] == "fleet report"
    assert [one["robot"] for one in said["robots"]] == [robot["robot"] for robot in truth["robots"]]
    assert all(run["status"] == "used" for run in said["runs"])
    assert said["days"] == [truth["size"]["first_day"]]
    # A single day tells of no change.
    assert {one["light"] for one in said["robots"]} == {"grey"}
    first = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in report.rglob("*") if path.is_file()}
    # Once more, elsewhere: nothing is scanned, and the same is said.
    other = ["--out", str(tmp_path / "other"), "--catalogue", str(report / "catalogue")]
    assert main([*words[:3], *other, *words[5:-1]]) == 0
    said = capsys.readouterr().out
    assert ": not tested, which takes 2 days of runs" in said
    assert "tests  change over the days: 0 of 2 robots tested; it takes 4 days of runs" in said
    for path, (content, written) in first.items():
        name = path.relative_to(report)
        if name.parts[0] == "catalogue":
            assert path.stat().st_mtime_ns == written, name
        else:
            assert (tmp_path / "other" / name).read_bytes() == content, name


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("{tmp}/none.yaml", 1, "No such file"),
        ("{tmp}", 1, "no logs"),
        ("{tmp}/known.yaml --catalogue other", 2, "--catalogue: is for a manifest"),
    ],
)
def test_what_is_no_fleet_is_named_and_nothing_is_written(words, code, said, tmp_path, capsys):
    (tmp_path / "known.yaml").mkdir()
    (tmp_path / "known.yaml/catalogue.json").write_text("{}")
    out = tmp_path / "out"
    typed = ["fleet", "report", *words.format(tmp=tmp_path).split(), "--out", str(out), "--scheduler", "serial"]
    assert main(typed) == code
    assert said in capsys.readouterr().err
    assert not out.exists()


def test_where_no_run_can_be_used_the_error_has_the_first_reason_and_where_to_find_the_others(tmp_path, capsys):
    (tmp_path / "fleet.csv").write_text("log,map,robot,site\n1.log,map.yaml,ann,hall\n2.log,map.yaml,bob,hall\n")
    out = ["--out", str(tmp_path / "out"), "--scheduler", "serial"]
    assert main(["fleet", "report", str(tmp_path / "fleet.csv"), *out]) == 3
    said = capsys.readouterr().err
    assert "no run of the catalogue is used: " in said
    assert "1.log: No such file or directory; beamfield fleet scan lists the reasons for all 2 runs" in said


def test_a_missing_manifest_is_refused_before_workers_start(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("beamfield.fleet.engine.Engine", None)
    assert main(["fleet", "report", str(tmp_path / "fleet.yaml"), "--out", str(tmp_path / "out")]) == 1
    assert "fleet.yaml: No such file" in capsys.readouterr().err
