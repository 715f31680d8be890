"""A catalogue that is damaged, foreign or of another version is refused, and the file named."""

from __future__ import annotations

import json
import pickle
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.fleet.beam_schema import beam_schema
from beamfield.fleet.catalogue import create_catalogue, open_catalogue
from beamfield.fleet.run_findings import leftover_finding, run_findings
from beamfield.fleet.run_record import MapInfo, RunRecord
from beamfield.fleet.shard_passes import SensorLimits, sensor_limits
from beamfield.maps.occupancy import OccupancyGrid
from tests.fleet.small_fleet import NOON


@pytest.fixture
def place(world: Path, tmp_path: Path) -> Path:
    shutil.copytree(world / "catalogue", tmp_path / "catalogue")
    return tmp_path / "catalogue"


def shard_file(place: Path) -> Path:
    return place / open_catalogue(str(place)).shards()[0].path


def rewritten(change: Callable[[Any], Any]) -> Callable[[Path], None]:
    def rewrite(file: Path) -> None:
        pq.write_table(change(pq.read_table(file)), file)

    return rewrite


def with_version(table: Any) -> Any:
    return table.replace_schema_metadata({b"beamfield.schema": b"3"})


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda file: file.write_bytes(b"PAR1 and nothing more"), "damaged, or no Parquet"),
        (lambda file: file.write_bytes(b""), "damaged, or no Parquet"),
        (lambda file: file.write_bytes(file.read_bytes()[:-100]), "damaged, or no Parquet"),
        (lambda file: file.unlink(), "the run's record names this file, but it is not there"),
        (rewritten(with_version), "expected beams of schema 2, got schema 3"),
        (rewritten(lambda table: table.replace_schema_metadata({})), "expected beams of schema 2, got schema none"),
        (rewritten(lambda table: table.drop(["incidence"])), "the column 'incidence' is missing"),
        (rewritten(lambda table: table.slice(1)), "rows, as the run's record says, got"),
        (
            rewritten(lambda table: table.set_column(5, "range", table["x"])),
            "expected float in the column 'range', got",
        ),
    ],
)
def test_a_damaged_or_foreign_file_of_beams_is_named(place: Path, damage: Callable[[Path], None], message: str):
    file = shard_file(place)
    damage(file)
    (shard, *_) = open_catalogue(str(place)).shards()
    with pytest.raises(FormatError) as error:
        shard.read(["range"])
    assert str(error.value).startswith(f"{file}: ")
    assert message in str(error.value)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7])
def test_a_single_bit_that_is_wrong_is_found(place: Path, share: float):
    file = shard_file(place)
    content = bytearray(file.read_bytes())
    footer = int.from_bytes(content[-8:-4], "little")
    content[int(share * (len(content) - footer))] ^= 1
    file.write_bytes(content)
    (shard, *_) = open_catalogue(str(place)).shards()
    with pytest.raises(FormatError, match="damaged, or no Parquet"):
        shard.read([field.name for field in beam_schema()])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'{"schema": 1}', r"catalogue\.json: the catalogue has schema 1, this version of beamfield reads 2"),
        (b"[]", r"catalogue\.json: expected the version"),
        (b"\x00\xff", r"catalogue\.json: expected the version"),
    ],
)
def test_another_version_is_refused(place: Path, content: bytes, message: str):
    (place / "catalogue.json").write_bytes(content)
    with pytest.raises(FormatError, match=message):
        open_catalogue(str(place))


def test_a_folder_of_other_things_is_left_alone(tmp_path: Path):
    with pytest.raises(FormatError, match="no catalogue of a fleet"):
        open_catalogue(str(tmp_path / "none"))
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(FormatError, match=r"expected a catalogue or an empty folder, got 'thesis\.tex'"):
        create_catalogue(str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def change_record(place: Path, **values: Any) -> Path:
    file = sorted((place / "runs").iterdir())[0]
    file.write_text(json.dumps({**json.loads(file.read_text()), **values}))
    return file


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"run": "another"}, "the record of another run, 'another'"),
        ({"colour": "red"}, "expected the record of a run"),
        ({"files": [{"path": "../../etc/passwd", "day": "2026-11-02", "rows": 1, "size": 1}]}, "expected a file in"),
        ({"files": [{"path": "beams/../../x", "day": "2026-11-02", "rows": 1, "size": 1}]}, "expected a file in"),
        ({"files": [{"path": "beams/x", "day": "yesterday", "rows": 1, "size": 1}]}, "expected the record of a run"),
        ({"findings": [{"name": "robot-lost"}]}, "expected the record of a run"),
        ({"findings": [{"name": "robot-lost", "severity": "warning", "text": 3}]}, "text: expected a text, got 3"),
        (
            {"findings": [{"name": "a", "severity": "warning", "text": "b", "values": {"largest_m": "far"}}]},
            "findings: expected finite numbers as values",
        ),
        ({"map_info": 3}, "expected the record of a run"),
        ({"selection": {"used": float("nan")}}, "selection: expected counts"),
        (
            {"map_info": {"resolution": 0.1, "origin": [0, 0, 0], "shape": [2, 2], "content": "../x"}},
            "expected the record",
        ),
        ({"status": "lost"}, "expected the record of a run"),
        ({"rows": "many"}, "expected the record of a run"),
    ],
)
def test_a_record_that_is_none_is_named(place: Path, values: dict[str, Any], message: str):
    file = change_record(place, **values)
    with pytest.raises(FormatError) as error:
        _ = open_catalogue(str(place)).runs
    assert str(error.value).startswith(f"{file}: ")
    assert message in str(error.value)


def test_maps_come_back_and_a_damaged_one_is_named(place: Path, office: OccupancyGrid):
    catalogue = open_catalogue(str(place))
    grid = catalogue.grid(catalogue.used[0])
    np.testing.assert_array_equal(grid.occupied, office.occupied)
    (file,) = (place / "maps").iterdir()
    content = file.read_bytes()
    for damaged in (b"", content[:-9], content[:200] + bytes(50) + content[250:]):
        file.write_bytes(damaged)
        with pytest.raises(FormatError, match=file.name):
            catalogue.grid(catalogue.used[0])
    file.write_bytes(zlib.compress(bytes(10_000_000)))
    with pytest.raises(FormatError, match="bytes or more, not to"):
        catalogue.grid(catalogue.used[0])
    file.unlink()
    with pytest.raises(FormatError, match="is not there"):
        catalogue.grid(catalogue.used[0])


def test_only_what_records_name_is_read(place: Path):
    catalogue = open_catalogue(str(place))
    total = catalogue.dataset().count_rows()
    file = shard_file(place)
    shutil.copy(file, file.with_name("left by a killed scan.parquet"))
    (place / "runs" / f"{catalogue.shards()[0].run}.json").unlink()
    assert open_catalogue(str(place)).dataset().count_rows() == total - catalogue.shards()[0].rows
    for record in (place / "runs").iterdir():
        record.unlink()
    empty = open_catalogue(str(place))
    assert (empty.runs, empty.shards(), empty.dataset().count_rows()) == ((), (), 0)


def test_what_is_asked_for_must_be_there(place: Path):
    (shard, *_) = open_catalogue(str(place)).shards()
    with pytest.raises(InvalidInputError, match=r"columns: expected names among run, stamp, .* got 'ranges'"):
        shard.read(["ranges"])
    with pytest.raises(InvalidInputError, match="thin: expected at least 1"):
        shard.read(["range"], thin=0)


def record(robot: str, first: float, last: float, sensor: str = "") -> RunRecord:
    return RunRecord(
        run=f"{robot}{first}{sensor}", robot=robot, site="hall", key="k", log=f"{robot}{first}.log", map="m", poses="",
        log_sensor=sensor, log_hash="h", status="used", first_stamp=first, last_stamp=last,
        sensor={"mounts": [[0.0, 0.0, 0.0]], "max_range": 8.0},
        map_info=MapInfo(0.1, (0.0, 0.0, 0.0), (9, 9), "a" * 64),
    )  # fmt: skip


def test_clocks_that_jump_and_runs_at_the_same_time_are_found():
    good = [record("ann", NOON, NOON + 60.0), record("ann", NOON + 60.0, NOON + 90.0), record("bob", NOON, NOON + 60.0)]
    assert not [*run_findings(good)]
    # Of a sensor's numbers a record need not name all.
    assert sensor_limits(good[0]) == SensorLimits(8.0, 0.0)
    jumped = record("bob", NOON + 800.0 * 86_400.0, NOON + 800.0 * 86_400.0 + 60.0)
    unset = record("cid", 3.0, 63.0)
    inside = record("ann", NOON + 10.0, NOON + 20.0)
    findings = [*run_findings([*good, jumped, unset, inside])]
    assert [finding.name for finding in findings] == ["no-date", "clock-differs", "runs-overlap"]
    assert "cid (hall)" in findings[0].text
    assert "bob (hall)" in findings[1].text
    assert findings[2].values == {"runs": 1.0}
    assert f"{inside.log} and {good[0].log} of ann" in findings[2].text
    front, rear, next_topic = (
        record("dan", NOON, NOON + 60.0, "/front"), record("dan", NOON, NOON + 60.0, "/rear"),
        record("dan", NOON + 60.0, NOON + 90.0, "/scan"),
    )  # fmt: skip
    assert not [*run_findings([*good, front, next_topic])]
    (several,) = run_findings([*good, front, rear, next_topic])
    assert several.name == "several-sensors"
    assert "dan (hall), as '/front' and '/rear' of dan" in several.text
    assert not [*leftover_finding(())]
    (left,) = leftover_finding(("beams/a.parquet", "beams/b.parquet"))
    assert left.text == "2 files of beams belong to no run, as beams/a.parquet."


def test_shards_are_sent_to_workers(place: Path):
    (shard, *_) = open_catalogue(str(place)).shards()
    again = pickle.loads(pickle.dumps(shard))
    assert again == shard
    assert len(again.read(["range"])["range"]) == shard.rows
