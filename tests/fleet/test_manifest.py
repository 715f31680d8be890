"""What a manifest lists, and what is said of one with a mistake in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from beamfield.errors import FormatError
from beamfield.fleet.folder import Folder
from beamfield.fleet.manifest import read_manifest

CSV = """\
log,map,robot,site,poses,start,sensor,mount,lone-poses
a.bag,m.yaml,ann,hall,,1 2 90,/scan,0.2 0 180,odometry
/b.bag,s3://k:s@bucket/m.yaml,bob,hall,b.tum,,,,
"""
YAML = """\
runs:
  - {log: a.bag, map: m.yaml, robot: ann, site: hall, start: [1, 2, 90], sensor: /scan, mount: [0.2, 0, 180],
     lone-poses: odometry}
  - log: /b.bag
    map: s3://k:s@bucket/m.yaml
    robot: bob
    site: hall
    poses: b.tum
"""


def written(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_csv_and_yaml_say_the_same(tmp_path: Path):
    rows = [read_manifest(written(tmp_path, *one)) for one in (("f.csv", CSV), ("f.yaml", YAML))]
    for ann, bob in rows:
        assert (ann.log, ann.robot, ann.start, ann.sensor, ann.poses) == ("a.bag", "ann", (1.0, 2.0, 90.0), "/scan", "")
        assert (bob.log, bob.poses, bob.start, bob.sensor) == ("/b.bag", "b.tum", None, "")
        assert (ann.mount, bob.mount) == ((0.2, 0.0, 180.0), None)
        assert (ann.lone_poses, bob.lone_poses) == ("odometry", "reference")
        assert ann.resolve(ann.log) == str(tmp_path / "a.bag")
        assert (bob.resolve(bob.log), bob.resolve(bob.map)) == ("/b.bag", "s3://k:s@bucket/m.yaml")
    assert [row.line for both in rows for row in both] == [2, 3, 2, 4]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("log,map,robt,site\n", ":1: no column is named 'robt'; did you mean 'robot'?"),
        ("log,map,robot,site,colour\n", ":1: no column is named 'colour'; expected some of log, map, robot, site"),
        ("log,map,robot\n", ":1: the column 'site' is missing"),
        ("log;map;robot;site\n", ":1: no column is named 'log;map;robot;site'; columns are separated by commas"),
        ("log,log,map,robot,site\n", ":1: the column 'log' is there twice"),
        ("log,map,robot,site\n\na,m,r\n", ":3: expected 4 fields, as in the header, got 3"),
        ("log,map,robot,site\na,m,,s\n", ":2: robot: expected a value, got none"),
        ("log,map,robot,site\na,m,r,s\n# b\na,m,q,s\n", ":4: log: 'a' is in line 2, too"),
        ("log,map,robot,site,start\na,m,r,s,1 2\n", ":2: start: expected three numbers, x y degrees, got ['1', '2']"),
        ("log,map,robot,site,start\na,m,r,s,1 2 nan\n", ":2: start: expected three numbers"),
        ("log,map,robot,site,mount\na,m,r,s,1 2\n", ":2: mount: expected three numbers, x y degrees, got ['1', '2']"),
        ("log,map,robot,site,start,poses\na,m,r,s,1 2 3,p\n", ":2: start: is for a log without poses"),
        (f"log,map,robot,site\na,m,{'r' * 101},s\n", ":2: robot: expected at most 100 characters that print"),
        (f"log,map,robot,site\na,m,r,{'я' * 39}\n", f":2: site: '{'я' * 39}' is too long for file names: 234 char"),
        ("log\tmap\trobot\tsite\n", r":1: no column is named 'log\tmap\trobot\tsite'; columns are separated by commas"),
        ("log,map,robot,site,lone-poses\na,m,r,s,odom\n", ":2: lone-poses: expected reference or odometry, got 'odom'"),
        ("log,map,robot,site\n", ": no logs: the manifest has no rows"),
        ('log,map,robot,site\n"a,m,r,s\n', ":2: not a line of CSV in UTF-8"),
    ],
)
def test_a_mistake_in_csv_is_named_with_its_row(tmp_path: Path, text: str, message: str):
    with pytest.raises(FormatError) as error:
        read_manifest(written(tmp_path, "f.csv", text))
    assert f"f.csv{message}" in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("run: []\n", ":1: expected the key 'runs' alone, got 'run'"),
        ("runs: 3\n", ":1: runs: expected a list, got 3"),
        ("runs:\n  - a\n", ":2: expected log, map, robot and site, got 'a'"),
        ("runs:\n  - {log: a, map: m, robot: r, site: 3}\n", ":2: site: expected text, got 3: put it in quotes"),
        ("runs:\n  - {log: a, map: m, robot: r, sight: s}\n", ":2: no key is named 'sight'; did you mean 'site'?"),
        ("runs:\n  - {log: a, map: m, robot: r, site: s, start: 4}\n", ":2: start: expected three numbers"),
        (f"runs:\n  - {{log: a, map: m, robot: r, site: s, start: [1, 2, {9**400}]}}\n", ":2: start: expected three"),
        ("runs: []\n", ": no logs: the manifest has no rows"),
    ],
)
def test_a_mistake_in_yaml_is_named_with_its_line(tmp_path: Path, text: str, message: str):
    with pytest.raises(FormatError) as error:
        read_manifest(written(tmp_path, "f.yaml", text))
    assert f"f.yaml{message}" in str(error.value)


def test_a_manifest_at_an_address_lists_what_is_beside_it_and_shows_no_secret():
    place = "memory://k:s3cret@fleet/logs"
    Folder(place).write("f.csv", CSV.encode())
    ann, bob = read_manifest(f"{place}/f.csv")
    assert [ann.resolve(one) for one in (ann.log, bob.log)] == [f"{place}/a.bag", "/b.bag"]
    assert (ann.place, repr(ann).count("s3cret")) == ("memory://fleet/logs/f.csv:2", 0)
    Folder(place).write("g.csv", b"log,map,robt,site\n")
    with pytest.raises(FormatError, match=r"^memory://fleet/logs/g\.csv:1: no column is named 'robt'"):
        read_manifest(f"{place}/g.csv")
    with pytest.raises(FileNotFoundError, match=r"memory://fleet/logs/none\.csv"):
        read_manifest(f"{place}/none.csv")


def test_a_folder_is_sites_of_robots_with_a_map_each(tmp_path: Path):
    for name in ("hall/ann/run1.log.gz", "hall/ann/run1.tum", "hall/bob/day.2.bag", "hall/bob/notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    (tmp_path / "hall/bob/bag2").mkdir()
    (tmp_path / "hall/bob/bag2/metadata.yaml").write_text("x")
    with pytest.raises(FormatError, match=r"hall: a folder of logs.* there is no map\.yaml"):
        read_manifest(tmp_path)
    (tmp_path / "hall/map.yaml").write_text("x")
    rows = read_manifest(tmp_path)
    assert [(row.robot, row.log, row.poses) for row in rows] == [
        ("ann", "hall/ann/run1.log.gz", "hall/ann/run1.tum"),
        ("bob", "hall/bob/bag2", ""),
        ("bob", "hall/bob/day.2.bag", ""),
    ]
    assert {(row.site, row.map, row.resolve(row.map)) for row in rows} == {
        ("hall", "hall/map.yaml", str(tmp_path / "hall/map.yaml"))
    }
    # A manifest in the folder says more.
    written(tmp_path, "manifest.csv", CSV)
    assert [row.log for row in read_manifest(tmp_path)] == ["a.bag", "/b.bag"]


def test_a_folder_whose_name_is_no_robots_is_said(tmp_path: Path):
    robot = tmp_path / "hall" / ("я" * 39)
    robot.mkdir(parents=True)
    for file in (tmp_path / "hall/map.yaml", robot / "a.log"):
        file.write_text("x")
    with pytest.raises(FormatError, match=f"'{'я' * 39}' is too long for file names"):
        read_manifest(tmp_path)


def test_what_is_no_manifest_is_said(tmp_path: Path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(FormatError, match="no logs: expected SITE/ROBOT/LOG"):
        read_manifest(tmp_path / "empty")
    with pytest.raises(FormatError, match="expected a manifest ending in"):
        read_manifest(written(tmp_path, "f.txt", CSV))
    with pytest.raises(FileNotFoundError):
        read_manifest(tmp_path / "none.csv")
