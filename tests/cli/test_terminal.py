r"""Names in files are only names: none moves the cursor, hides text or begins a line of its own."""

from __future__ import annotations

import json
from pathlib import Path
from unittest import mock

import pytest

from beamfield.cli.main import main
from beamfield.cli.terminal import complain, say, say_json
from beamfield.io.bags import writer
from beamfield.io.read_log import read_log
from beamfield.printable import printable
from tests.cli.simulated import simulated

# Clears the screen and sets its title; forges a line; C1, a mark that turns text around, DEL; a formula and a tag.
EVIL = "/s\x1b[2J\x1b]0;t\x07\nFORGED\x85\u2028\x9b31m\u202eback\x7f$\\frac$<b>\r&"


def test_what_does_not_print_becomes_an_escape():
    assert printable("plain ± é 中 text") == "plain ± é 中 text"
    assert printable(EVIL) == (r"/s\x1b[2J\x1b]0;t\x07\nFORGED\x85\u2028\x9b31m\u202eback\x7f$\frac$<b>\r&")
    assert printable("a\nb\tc", keep="\n") == "a\nb\\tc"
    assert printable("\udce4.log") == r"\udce4.log"
    for code in [*range(0x20), *range(0x7F, 0xA0), *range(0x202A, 0x202F), *range(0x2066, 0x206A), 0x200E, 0x200F]:
        assert printable(chr(code)).isascii()
        assert printable(chr(code)).isprintable()


def test_all_that_is_printed_prints(capsys):
    say(EVIL + "\nsecond line")
    complain(f"warning: {EVIL}")
    captured = capsys.readouterr()
    assert captured.out.replace("\n", "").isprintable()
    assert len(captured.out.splitlines()) == 3
    assert captured.err.count("\n") == 1
    assert captured.err[:-1].isprintable()
    say_json({"name": EVIL})
    printed = capsys.readouterr().out
    assert printed.replace("\n", "").isprintable()
    assert json.loads(printed) == {"name": EVIL}


def test_wrong_usage_is_quoted_so_that_it_prints(capsys):
    assert main(["inspect", "a.log", EVIL]) == 2
    assert capsys.readouterr().err.replace("\n", "").isprintable()


@pytest.fixture(scope="module")
def evil(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a map and a bag whose topics, frames and file name are hostile."""
    folder = tmp_path_factory.mktemp("evil")
    world = simulated(folder / "world", "--duration 40 --scan-rate 4 --beams 13")
    log = read_log(world / "log.carmen")
    name = EVIL.replace("/", "")
    with mock.patch.multiple(writer, TOPIC=EVIL, ODOMETRY_TOPIC=f"{EVIL}/odom", ODOM_FRAME=f"{EVIL}/odom"):
        writer.write_bag(folder / name, log)
    for file in ("map.yaml", "map.pgm"):
        (world / file).rename(folder / file)
    return folder


def check(capsys: pytest.CaptureFixture[str], folder: Path) -> str:
    """Check what was printed and every text that was written; return what was printed on stdout."""
    captured = capsys.readouterr()
    texts = {"stdout": captured.out, "stderr": captured.err}
    for file in folder.rglob("*"):
        if file.suffix in (".html", ".json", ".yaml", ".md"):
            texts[file.name] = file.read_text(encoding="utf-8")
    for where, text in texts.items():
        bad = [c for c in text.replace("\n", "") if not c.isprintable()]
        assert not bad, (where, bad)
        assert where.endswith(".html") or not any(line.startswith("FORGED") for line in text.splitlines()), where
        assert not (where.endswith(".html") and "$<b>" in text), where
    return captured.out


COMMANDS = {
    "inspect": "inspect {bag} --out {out}/a.png",
    "inspect --json": "inspect {bag} --json",
    "inspect --sensor": "inspect {bag} --sensor /none",
    "check": "check {bag} --map {map} --out {out}/f",
    "map": "map {bag} --out {out}/m.yaml --resolution 0.2",
    "likelihood": "likelihood {bag} --map {map} --scan 3 --out {out}/l.png --resolution 1 --headings 8",
    "figures": "figures {bag} --map {map} --out {out}/g --only 6.10",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_hostile_names_are_only_names(evil, tmp_path, capsys, command):
    bag = evil / EVIL.replace("/", "")
    code = main([w.format(bag=bag, map=evil / "map.yaml", out=tmp_path) for w in COMMANDS[command].split()])
    printed = check(capsys, tmp_path)
    assert code == (2 if command == "inspect --sensor" else 0)
    assert printed or code == 2
