"""Commands run as a user runs them, in this process; what they do to a user's file."""

from __future__ import annotations

import contextlib
import io
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

from beamfield.cli.calibrate_sensor import CalibrationJob, SensorResult
from beamfield.cli.main import main
from beamfield.cli.report_part import StackPart
from beamfield.errors import BeamfieldError
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.page_section import PageSection
from beamfield.sensors import SensorLog
from beamfield.stacks.files.calibration_record import record_text
from beamfield.stacks.files.parameter_file import StackFile, read_stack_file
from beamfield.stacks.files.typed_values import checked_values

LOG = "\n".join(f"FLASER 4 1.5 2 1 1 {i} 0.5 0 {i} 0.4 0 {i} host {i}" for i in range(4)) + "\n"
MAP = "robot_specifications->resolution 10\nglobal_map[0]: 2 2\n1 0\n0 1\n"


@dataclass(frozen=True)
class Patch:
    """What a command that changes a user's file has done.

    Parameters
    ----------
    name
        Of the user's file.
    before, after
        Contents of all files by name.
    code, err
        What the command returned and said.
    values
        What should stand in the file afterwards; None if that is not known.
    """

    name: str
    before: dict[str, bytes]
    after: dict[str, bytes]
    code: int
    err: str
    values: dict[str, Any] | None
    stack: str


PARAMETERS = BeamParameters(0.7, 0.1, 0.1, 0.1, 0.1, 0.5)


def run_command(*words: str) -> tuple[int, str, str]:
    """Run a command and return its exit code and what it printed."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except SystemExit as stop:
            code = int(stop.code or 0)
    return code, out.getvalue(), err.getvalue()


def translate_and_patch(folder: Path) -> Patch:
    """Translate the source into the user's file; to the stack that the file seems to be of."""
    mine = _users_file(folder)
    stack = _stack_of(mine)
    before = _contents(folder)
    words = ["translate", str(folder / "source.yaml"), "--to", stack, "--max-range", "12", "--beams", "180"]
    code, _, err = run_command(*words, "--patch", str(mine))
    return Patch(mine.name, before, _contents(folder), code, err, None, stack)


def calibrate_and_patch(folder: Path) -> Patch:
    """Calibrate a log for the stack of the user's file, with values that are given instead of learned."""
    mine = _users_file(folder)
    stack = _stack_of(mine)
    (folder / "run.log").write_text(LOG)
    (folder / "map.dat").write_text(MAP)
    before = _contents(folder)
    values: dict[str, Any] = {}

    def learned(job: CalibrationJob, sensor: SensorLog) -> SensorResult:
        file = job.patched
        assert file is not None
        changed, parameters = _learned(file)
        values.update(file.by_names_in_file(changed))
        record = record_text(file.stack, file.model, parameters, None, "0.0", "all of 3 windows covered")
        part = StackPart("stack", "", {"verdict": ""}, PageSection("stack", "", ""), {}, values=changed, record=record)
        return SensorResult({"beam_model.yaml": "a: 1\n"}, "", {}, part, (), (PARAMETERS, sensor))

    log, grid, out = (str(folder / name) for name in ("run.log", "map.dat", "out"))
    words = ["calibrate", log, "--map", grid, "--out", out, "--quiet"]
    with mock.patch.object(CalibrationJob, "learn", learned):
        code, _, err = run_command(*words, "--stack", stack, "--patch", str(mine))
    after = {name: content for name, content in _contents(folder).items() if name != "out/beam_model.yaml"}
    return Patch(mine.name, before, after, code, err, values, stack)


def check_patch(result: Any) -> None:
    """Assert that a user's file is as it was, or has all new values, all else in place, and a backup beside it."""
    assert isinstance(result, Patch)
    assert result.code in (0, 1, 2), result.code
    name, backup = result.name, f"{result.name}.bak"
    old, new = result.before[name], result.after[name]
    if result.code != 0:
        assert result.after == result.before
        assert result.err.startswith("beamfield: error: ")
        assert result.err.count("\n") == 1, result.err
        return
    assert result.after == {**result.before, name: new, backup: old}
    if result.values is not None:
        _check_values(result, new)
        assert b"calibrated by beamfield 0.0" in new
    assert not _lost(old, new, len(result.values) if result.values is not None else 12)


def _check_values(result: Patch, new: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / result.name
        path.write_bytes(new)
        entries = read_stack_file(path, stack=result.stack).section.entries
    for name, value in (result.values or {}).items():
        found = entries[name].value
        same = abs(found - value) <= 1e-5 * abs(value) if isinstance(value, float) else found == value
        assert same, (name, found, value)


def _lost(old: bytes, new: bytes, n_changes: int) -> list[bytes]:
    """Return the lines of the old text that the new one lacks, if they are more than the changes can be."""
    lines = set(new.replace(b"\r", b"\n").split(b"\n"))
    gone = [line for line in old.replace(b"\r", b"\n").split(b"\n") if line not in lines]
    return gone if len(gone) > n_changes else []


def _learned(file: StackFile) -> tuple[dict[str, Any], Any]:
    """Return valid parameters that differ from the file's, as a fit's would, and by name those that do."""
    start = checked_values(file)
    prefix = "laser_" if file.stack == "ros1" else "LF_" if file.stack == "mrpt" else ""
    wanted: dict[str, Any] = {"z_hit": 0.613, "z_rand": 0.387, "sigma_hit": 0.0712, "max_beams": 47, "stdHit": 0.0712}
    before = asdict(start)
    with contextlib.suppress(BeamfieldError):
        start = replace(start, **{prefix + n: value for n, value in wanted.items() if prefix + n in before})
    return {name: value for name, value in asdict(start).items() if value != before[name]}, start


def _users_file(folder: Path) -> Path:
    return next(path for path in sorted(folder.iterdir()) if path.name.startswith("mine"))


def _stack_of(mine: Path) -> str:
    try:
        return read_stack_file(mine).stack
    except (BeamfieldError, OSError):
        return {".ini": "mrpt", ".launch": "ros1"}.get(mine.suffix, "nav2")


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
