"""The table of claims in docs/reliability.md: every sentence is still printed, every test is still there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def rows() -> list[tuple[str, str, str]]:
    text = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8").split("## Claims")[1]
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")
    ]
    return [(sentence, where.strip("`"), how) for sentence, where, how in cells[2:]]


def spoken(source: str) -> str:
    """Return source code with the texts that stand beside each other joined, f-strings' fields left as they are."""
    return re.sub(r"\s+", " ", re.sub(r"[\"']\s*\n\s*f?[\"']", "", source))


@pytest.mark.parametrize(("sentence", "where", "how"), rows(), ids=lambda cell: cell[:40])
def test_every_claim_is_printed_and_held(sentence, where, how):
    source = (ROOT / "src" / "beamfield" / where).read_text(encoding="utf-8")
    assert sentence in spoken(source)
    named = re.findall(r"`(tests/\S+?)::(\w+)`", how)
    assert named or how.startswith("computed")
    for path, test in named:
        assert f"def {test}(" in (ROOT / path).read_text(encoding="utf-8")


def test_the_table_is_read():
    assert len(rows()) >= 12
