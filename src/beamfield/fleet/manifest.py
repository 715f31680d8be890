"""Which logs a fleet has: a manifest in YAML or CSV, or a folder of logs."""

from __future__ import annotations

import csv
import difflib
import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args
from urllib.parse import quote

from beamfield.errors import FormatError
from beamfield.fleet.folder import Folder, is_address, without_secrets
from beamfield.io.files.text_lines import read_lines
from beamfield.io.files.yaml_file import read_yaml, shorten
from beamfield.io.logs.text_scans import LonePoses

REQUIRED = ("log", "map", "robot", "site")
OPTIONAL = ("poses", "start", "sensor", "mount", "lone-poses")
X_Y_DEGREES = ("start", "mount")
NAMES = ("manifest.yaml", "manifest.yml", "manifest.csv")
MAX_YAML_BYTES = 10_000_000
LONGEST_NAME = 100
# Percent-encoded, a name is part of a file's: of 255 bytes, which what stands beside it shares.
LONGEST_ENCODED = 230
_LOGS = (".log", ".log.gz", ".carmen", ".carmen.gz", ".clf", ".clf.gz", ".gfs", ".gfs.gz", ".g2o", ".g2o.gz", ".bag",
         ".mcap", ".db3")  # fmt: skip
_POSES = (".tum", ".csv", ".tum.gz", ".csv.gz")


@dataclass(frozen=True)
class ManifestRow:
    """One log of a manifest.

    Parameters
    ----------
    log, map, poses
        Addresses as they are given; poses "" if there are none.
    robot, site
        Names.
    start
        Where the log begins in the map, for poses that are to be fitted: metres, metres, degrees; None: searched.
    sensor
        The log's sensor; "" for the only one.
    mount
        The sensor's pose on the robot, for a bag that does not say: metres, metres, degrees; None: as the log says.
    lone_poses
        What the poses are in a text log that has one per scan, see `read_log`.
    manifest, line
        Where it stands, without secrets; line 0: in a folder of logs.
    folder
        Where relative addresses begin: a whole path or an fsspec address, which may hold secrets.
    """

    log: str
    map: str
    robot: str
    site: str
    poses: str = ""
    start: tuple[float, float, float] | None = None
    sensor: str = ""
    mount: tuple[float, float, float] | None = None
    lone_poses: LonePoses = "reference"
    manifest: str = ""
    line: int = 0
    folder: str = field(default="", repr=False)

    @property
    def place(self) -> str:
        """The file and row, for messages."""
        return f"{self.manifest}:{self.line}" if self.line else f"{self.manifest}: {without_secrets(self.log)}"

    def resolve(self, given: str) -> str:
        """Return the whole address of a file that the row gives, which may be relative to its manifest."""
        if is_address(given) or os.path.isabs(given):  # noqa: PTH117  # an address of any system
            return given
        if is_address(self.folder):
            return f"{self.folder}/{given}"
        return os.path.abspath(Path(self.folder) / given)  # noqa: PTH100  # as links have it: their targets have other neighbours


def read_manifest(path: str | os.PathLike[str], options: Mapping[str, Any] | None = None) -> tuple[ManifestRow, ...]:
    """Read which logs a fleet has; rows are in their order, of a folder by name.

    - A ``.yaml`` file whose key ``runs`` holds a list, or a ``.csv`` file with a header, here or at an fsspec address.
      A row has a log, its map, the names of robot and site and, if need be, poses (a file for ``--poses``), start and
      mount (x, y and degrees), sensor and lone-poses. Addresses are relative to the manifest, or
      whole fsspec addresses.
    - A folder with a ``manifest.yaml`` or ``manifest.csv``.
    - A folder of logs, ``SITE/ROBOT/LOG``, with one map per site, ``SITE/map.yaml``, and poses, where there are any,
      beside their log under its name as ``.tum`` or ``.csv``.

    FormatError names file and line if a column or key is unknown (with the one that was probably meant), a value is
    missing or is no text, a start or mount is not three numbers, a log is there twice, or there is no row.
    """
    if is_address(str(path)):
        return _rows_at(str(path), options or {})
    source = Path(path)
    if source.is_dir():
        named = next((source / name for name in NAMES if (source / name).is_file()), None)
        if named is None:
            return _rows_of_folder(source)
        source = named
    if source.suffix.lower() == ".csv":
        rows = _rows_of_csv(source)
    elif source.suffix.lower() in (".yaml", ".yml"):
        rows = _rows_of_yaml(source)
    else:
        source.stat()  # a name that does not exist is the first thing to say
        raise FormatError(source, "expected a manifest ending in .yaml or .csv, or a folder of logs")
    if not rows:
        raise FormatError(source, "no logs: the manifest has no rows")
    seen: dict[tuple[str, str], int] = {}
    for row in rows:
        before = seen.setdefault((row.resolve(row.log), row.sensor), row.line)
        if before != row.line:
            raise FormatError(
                source, f"{without_secrets(row.log)!r} is in line {before}, too", line=row.line, field="log"
            )
    return tuple(rows)


def log_stem(name: str) -> str:
    """Return the name of a log's file without its ending, which may have a point in it."""
    end = next((end for end in sorted(_LOGS, key=len, reverse=True) if name.lower().endswith(end)), "")
    return name[: len(name) - len(end)]


def _rows_at(address: str, options: Mapping[str, Any]) -> tuple[ManifestRow, ...]:
    """Return the rows of a manifest at an fsspec address."""
    place, slash, query = address.partition("?")
    folder, _, name = place.rpartition("/")
    shown = without_secrets(address)
    with tempfile.TemporaryDirectory(prefix="beamfield-") as scratch:
        copy = Path(scratch) / (name or "manifest")
        copy.write_bytes(Folder(folder, options).read(name + slash + query))
        try:
            rows = read_manifest(copy)
        except FormatError as error:
            where, _, what = str(error).partition(": ")
            raise FormatError(where.replace(str(copy), shown), what) from None
    return tuple(replace(row, manifest=shown, folder=folder) for row in rows)


def _rows_of_csv(path: Path) -> list[ManifestRow]:
    names: list[str] = []
    rows = []
    for line, text in read_lines(path):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        try:
            # Lines are read as Latin-1, to be shown whatever they hold.
            decoded = text.encode("latin-1").decode("utf-8-sig")
            words = [word.strip() for word in next(csv.reader([decoded], strict=True))]
        except (UnicodeDecodeError, csv.Error) as error:
            raise FormatError(path, f"not a line of CSV in UTF-8: {error}", line=line) from None
        if not names:
            names = [word.lower() for word in words]
            _check_names(path, names, line, "column")
            continue
        if len(words) != len(names):
            raise FormatError(path, f"expected {len(names)} fields, as in the header, got {len(words)}", line=line)
        values: dict[str, Any] = {name: word for name, word in zip(names, words, strict=True) if word}
        values |= {name: values[name].split() for name in X_Y_DEGREES if name in values}
        rows.append(_row(path, line, values))
    return rows


def _rows_of_yaml(path: Path) -> list[ManifestRow]:
    file = read_yaml(path, max_bytes=MAX_YAML_BYTES)
    for key in file.values:
        if key != "runs":
            raise FormatError(path, f"expected the key 'runs' alone, got {shorten(key)}", line=file.lines.get((key,)))
    runs = file.value("runs")
    if not isinstance(runs, list):
        raise file.error(f"expected a list, got {shorten(runs)}", "runs")
    rows = []
    for i, values in enumerate(runs):
        line = file.lines["runs", i]
        if not isinstance(values, dict):
            raise FormatError(path, f"expected log, map, robot and site, got {shorten(values)}", line=line)
        _check_names(path, list(values), line, "key")
        rows.append(_row(path, line, {name: value for name, value in values.items() if value is not None}))
    return rows


def _check_names(path: Path, names: Sequence[str], line: int, what: str) -> None:
    known = (*REQUIRED, *OPTIONAL)
    for name in names:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            meant = f"; did you mean {close[0]!r}?" if close else f"; expected some of {', '.join(known)}"
            if ";" in name or "\t" in name:
                meant = "; columns are separated by commas"
            raise FormatError(path, f"no {what} is named {shorten(name)}{meant}", line=line)
        if names.count(name) > 1:
            raise FormatError(path, f"the {what} {name!r} is there twice", line=line)
    if missing := [name for name in REQUIRED if name not in names]:
        raise FormatError(path, f"the {what} {missing[0]!r} is missing", line=line)


def _row(path: Path, line: int, values: Mapping[str, Any]) -> ManifestRow:
    for name in REQUIRED:
        if name not in values:
            raise FormatError(path, "expected a value, got none", line=line, field=name)
    for name, value in values.items():
        if name not in X_Y_DEGREES and not (isinstance(value, str) and value):
            quoted = "" if isinstance(value, str | list | dict) else ": put it in quotes"
            raise FormatError(path, f"expected text, got {shorten(value)}{quoted}", line=line, field=name)
    rule = values.get("lone-poses", "reference")
    if rule not in get_args(LonePoses):
        raise FormatError(
            path, f"expected {' or '.join(get_args(LonePoses))}, got {rule!r}", line=line, field="lone-poses"
        )
    for name in ("robot", "site"):
        if wrong := _wrong_name(values[name]):
            raise FormatError(path, wrong, line=line, field=name)
    given = {name.replace("-", "_"): value for name, value in values.items()}
    given |= {name: _pose(path, line, name, given[name]) for name in X_Y_DEGREES if name in given}
    if "start" in given and "poses" in given:
        raise FormatError(path, "is for a log without poses, and poses are given", line=line, field="start")
    return ManifestRow(**given, manifest=str(path), line=line, folder=os.path.abspath(path.parent))  # noqa: PTH100


def _wrong_name(name: str) -> str:
    """Return what is wrong with the name of a robot or site; "" if nothing is."""
    if len(name) > LONGEST_NAME or not name.isprintable():
        return f"expected at most {LONGEST_NAME} characters that print, got {shorten(name)}"
    if (n := len(quote(name, safe=""))) > LONGEST_ENCODED:
        return f"{shorten(name)} is too long for file names: {n} characters percent-encoded, {LONGEST_ENCODED} at most"
    return ""


def _pose(path: Path, line: int, name: str, value: Any) -> tuple[float, float, float]:
    try:
        x, y, degrees = (float(number) for number in value if not isinstance(number, bool))
    except (TypeError, ValueError, OverflowError):
        x = y = degrees = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(degrees)):
        raise FormatError(path, f"expected three numbers, x y degrees, got {shorten(value)}", line=line, field=name)
    return x, y, degrees


def _rows_of_folder(folder: Path) -> tuple[ManifestRow, ...]:
    rows = []
    for site in filter(Path.is_dir, _visible(folder)):
        robots = filter(Path.is_dir, _visible(site))
        logs = [log for robot in robots for log in _visible(robot) if _is_log(log)]
        if logs and not (site / "map.yaml").is_file():
            raise FormatError(site, "a folder of logs, SITE/ROBOT/LOG, has a map per site: there is no map.yaml")
        for named in dict.fromkeys([site, *(log.parent for log in logs)] if logs else []):
            if wrong := _wrong_name(named.name):
                raise FormatError(folder, wrong)
        for log in logs:
            robot, stem = log.parent, log_stem(log.name)
            poses = next((robot / f"{stem}{end}" for end in _POSES if (robot / f"{stem}{end}").is_file()), None)
            names = (str(one.relative_to(folder)) if one else "" for one in (log, site / "map.yaml", poses))
            address, map_address, poses_address = names
            rows.append(
                ManifestRow(address, map_address, robot.name, site.name, poses_address, manifest=str(folder),
                            folder=os.path.abspath(folder))  # noqa: PTH100
            )  # fmt: skip
    if not rows:
        raise FormatError(folder, f"no logs: expected SITE/ROBOT/LOG, or one of {', '.join(NAMES)}")
    return tuple(rows)


def _visible(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))


def _is_log(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or (path / "measurement.txt").is_file()
    return path.name.lower().endswith(_LOGS)
