"""Each finding of the doctor has its section in docs/doctor.md, and each section its finding."""

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


def sections() -> dict[str, str]:
    """Return the text of each section about a finding, by heading."""
    parts = PAGE.read_text().split("\n### ")[1:]
    return {part.split("\n", 1)[0]: part.split("\n", 1)[1] for part in parts}


def test_there_are_findings():
    assert len(findings()) > 30


def test_every_finding_has_a_section_and_every_section_a_finding():
    assert set(sections()) == set(findings())


@pytest.mark.parametrize("name", sorted(findings()))
def test_a_section_says_how_bad_it_is(name):
    expected = findings()[name] & {"error", "warning", "info"}
    text = sections()[name]
    assert {word for word in ("error", "warning", "info") if f"*{word}" in text} == expected


def test_headings_are_there_once():
    headings = [line for line in PAGE.read_text().splitlines() if line.startswith("### ")]
    assert len(headings) == len(set(headings))
