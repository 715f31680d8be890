"""`beamfield fleet scan` as a user types it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from beamfield.cli.main import main
from tests.cli.simulated import simulated

pytest.importorskip("pyarrow")
pytest.importorskip("fsspec")


@pytest.fixture(scope="module")
def manifest(tmp_path_factory) -> Path:
    folder = simulated(tmp_path_factory.mktemp("logs"), "--duration 20 --scan-rate 2 --beams 31 --seed 1")
    (folder / "fleet.yaml").write_text(
        "runs:\n"
        "  - {log: log.carmen, map: map.yaml, robot: ann, site: hall}\n"
        "  - {log: none.carmen, map: map.yaml, robot: bob, site: hall}\n"
    )
    return folder / "fleet.yaml"


def scan(manifest: Path, out: Path, *words: str) -> int:
    return main(["fleet", "scan", str(manifest), "--out", str(out), "--scheduler", "serial", *words])


def test_a_table_by_robot_and_what_was_left_out_with_its_row(manifest: Path, tmp_path: Path, capsys):
    assert scan(manifest, tmp_path / "catalogue") == 0
    told = capsys.readouterr()
    lines = told.out.splitlines()
    rows = [line.split() for line in lines[2:4]]
    assert [row[:5] for row in rows] == [["hall", "ann", "1", "0", "1"], ["hall", "bob", "0", "1", "0"]]
    assert [row[-1] for row in rows] == ["log", "-"]
    assert f"  {manifest}:3: {manifest.parent / 'none.carmen'}: No such file or directory" in lines
    assert lines[-1].startswith("1 of 2 logs used, 2 scanned now; the catalogue ")
    assert lines[-1].endswith(f" has {int(rows[0][6].replace(',', '')):,} beams of 1 run")
    # The simulation's stamps count from 0.
    assert "note: warning (no-date): 1 of 1 runs have stamps that count from 0" in told.err
    (killed := tmp_path / "catalogue/beams/site=hall/killed.parquet").write_bytes(b"")
    assert scan(manifest, tmp_path / "catalogue", "--json", "--quiet") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["findings"][0]["text"] == "1 files of beams belong to no run, as beams/site=hall/killed.parquet."
    assert killed.exists()
    assert document["findings"][1]["name"] == "no-date"
    assert document["command"] == "fleet scan"
    assert [run["status"] for run in document["runs"]] == ["used", "left out"]
    assert document["scanned"] == [document["runs"][1]["run"]], "what could not be read is tried again"
    assert {"catalogue", "replaced", "findings", "notes", "wrote"} <= set(document)


def test_no_log_that_can_be_used_is_too_little(tmp_path: Path, capsys):
    (tmp_path / "fleet.csv").write_text("log,map,robot,site\nnone.log,none.yaml,ann,hall\n")
    assert scan(tmp_path / "fleet.csv", tmp_path / "catalogue", "--quiet") == 3
    assert "no log could be used" in capsys.readouterr().err


def test_a_typo_in_the_manifest_writes_nothing(manifest: Path, tmp_path: Path, capsys):
    bad = tmp_path / "fleet.yaml"
    bad.write_text(manifest.read_text().replace("robot: bob", "robto: bob"))
    assert scan(bad, tmp_path / "catalogue") == 1
    assert capsys.readouterr().err == (f"beamfield: error: {bad}:3: no key is named 'robto'; did you mean 'robot'?\n")
    assert not (tmp_path / "catalogue").exists()


def test_without_the_extra_one_line_says_what_to_install(manifest: Path, tmp_path: Path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert scan(manifest, tmp_path / "catalogue") == 1
    assert "pip install pyarrow, which is in the extra beamfield[fleet]" in capsys.readouterr().err
