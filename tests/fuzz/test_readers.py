"""A few hundred hostile inputs for every reader, always the same; `python -m tests.fuzz` reads more, and others."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.outcome import observe
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS
from tests.fuzz.worker import Stream, read_inputs

SEED = "1"
# By how long one takes: bags and commands need ten to thirty times as long as a page of text.
FEW, SOME, MANY = 5, 25, 80
SLOW = ("bag1", "db3", "mcap", "ros2_folder", "translate_patch", "calibrate_patch", "inspect_", "doctor")
MEDIUM = ("map_yaml", "pgm", "png", "bmp", "beam_model", "field_model", "landmark_model", "stack_yaml")


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_every_example_is_read(target: Target, tmp_path: Path) -> None:
    for case in target.seeds():
        found = observe(target, case, tmp_path / "case")
        # Some are read with an option that does not fit them.
        misfit = found.kind == "refused" and ("no topic '/" in found.text or "no sensor '" in found.text)
        assert found.kind == "ok" or misfit, found.text


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_hostile_files_end_in_a_result_or_a_documented_error(target: Target, tmp_path: Path) -> None:
    n = FEW if target.name.startswith(SLOW) else SOME if target.name in MEDIUM else MANY
    stream = Stream(target, SEED)
    batch = read_inputs(
        stream, stream.inputs(), tmp_path / "case", None, tmp_path / "faults", n=len(stream.examples) + n
    )
    assert not batch.faults, "\n".join(f"{place}: {text} ({kept})" for place, text, kept in batch.faults)
