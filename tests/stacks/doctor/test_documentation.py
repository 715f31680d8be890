"""Each finding of the doctor has its row in docs/doctor.md, and each row its finding."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

import beamfield.stacks

STACKS = Path(beamfield.stacks.__file__).parent
PAGE = Path(__file__).parents[3] / "docs" / "doctor.md"
pytestmark = pytest.mark.skipif(not PAGE.is_file(), reason="the documentation is not here")


@cache
def findings() -> dict[str, set[str]]:
    """Return the severities that each finding can have, by name, as the source has them."""
    found: dict[str, set[str]] = {}
    for path in sorted(STACKS.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "finding":
                name, severity = node.args[:2]
                assert isinstance(name, ast.Constant), f"{path.name}:{node.lineno}: the name is no constant"
                words = [part.value for part in ast.walk(severity) if isinstance(part, ast.Constant)]
                found.setdefault(name.value, set()).update(words)
    return found


def rows() -> list[list[str]]:
    """Return finding, levels, cause and advice of each row about a finding."""
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def test_there_are_findings():
    assert len(findings()) > 30


def test_every_finding_has_one_row_with_its_levels_and_what_to_do():
    said = {name.strip("`"): set(levels.split(", ")) for name, levels, cause, advice in rows() if cause and advice}
    levels = {"error", "warning", "info"}
    assert said == {name: words & levels for name, words in findings().items()}
    assert len(rows()) == len(said)
