"""docs/book_map.md is what its script writes, and names something that exists for every item of the chapter."""

from __future__ import annotations

import importlib.util
import pkgutil
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROWS = [
    [cell.strip() for cell in line.strip("|").split(" | ")]
    for line in (ROOT / "docs" / "book_map.md").read_text().splitlines()
    if line.startswith("| ") and not line.startswith("| |")
]


def test_the_page_is_what_its_script_writes(monkeypatch):
    spec = importlib.util.spec_from_file_location("make_book_map", ROOT / "docs" / "make_book_map.py")
    script = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, script)
    spec.loader.exec_module(script)
    assert script.PAGE.read_text() == script.page(), "run: python docs/make_book_map.py"


def test_every_item_is_there():
    labels = {row[0] for row in ROWS}
    assert {f"(6.{n})" for n in range(1, 43)} <= labels
    assert {f"Table 6.{n}" for n in range(1, 6)} | {f"Figure 6.{n}" for n in range(1, 14)} <= labels


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_an_item_is_computed_and_tested(row):
    _, subject, names, tests = row
    if subject.startswith("(discussion)"):
        return
    for name in re.findall(r"`([a-z]\w+\.[\w.]+)`", names):
        assert pkgutil.resolve_name(f"beamfield.{name}")
    assert names
    assert tests
    for path in re.findall(r"`(tests/[^`]+)`", tests):
        assert (ROOT / path).is_file(), path
