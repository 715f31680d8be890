"""The fuzzer finds faults that were planted, keeps their inputs, and reads them again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.fuzz import outcome, planted
from tests.fuzz.__main__ import main
from tests.fuzz.campaign import Limits, run
from tests.fuzz.case import Case, one_file
from tests.fuzz.memory import PeakMemory
from tests.fuzz.outcome import observe
from tests.fuzz.worker import Stream, Task, read_inputs

HARMLESS = one_file("a.txt", "1 2 3\n")
HARMFUL = one_file("a.txt", "4\n")


@pytest.mark.parametrize("kind", ["exception", "warning", "message", "leftover", "result", "too much"])
def test_a_planted_fault_is_named(kind: str, tmp_path: Path) -> None:
    target = planted.BY_NAME[kind]
    assert observe(target, HARMLESS, tmp_path / "case").kind == "ok"
    assert observe(target, HARMFUL, tmp_path / "case").kind == {"too much": "memory"}.get(kind, kind)


def test_what_takes_longer_or_more_than_it_may_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outcome, "MAX_SECONDS", -1.0)
    assert observe(planted.BY_NAME["good"], HARMLESS, tmp_path / "case").kind == "slow"
    monkeypatch.setattr(outcome, "MAX_SECONDS", 1e9)
    monkeypatch.setattr(outcome, "MAX_BYTES", 32 * 2**20)
    memory = PeakMemory()
    if memory.peak() == 0:
        pytest.skip("this system does not say how much memory a process has used")
    found = observe(planted.BY_NAME["memory"], HARMFUL, tmp_path / "case", memory)
    assert found.kind == "memory"
    assert 63 * 2**20 <= found.n_bytes < 80 * 2**20


def test_faulty_inputs_are_kept_with_what_went_wrong(tmp_path: Path) -> None:
    stream = Stream(planted.BY_NAME["exception"], "7")
    batch = read_inputs(stream, stream.inputs(), tmp_path / "case", None, tmp_path / "faults", n=20)
    assert batch.counts["exception"] == len(batch.faults) > 5
    assert batch.counts["ok"] >= 1
    kept = sorted((tmp_path / "faults").iterdir())
    assert len(kept) == 3
    document = json.loads((kept[0] / "fault.json").read_text())
    assert document["kind"] == "exception"
    assert "KeyError: 'planted'" in document["text"]
    again = Case.read(kept[0] / "case", document["entry"])
    assert observe(planted.BY_NAME[document["target"]], again, tmp_path / "again").kind == "exception"


def test_replaying_a_folder_that_is_missing_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["tests.fuzz", "--replay", str(tmp_path / "none")])
    with pytest.raises(SystemExit, match="2"):
        main()
    assert capsys.readouterr().err.endswith(f"--replay: no kept input in {tmp_path / 'none'}: it has no fault.json\n")


def test_a_stream_is_the_same_again_for_the_same_seed(tmp_path: Path) -> None:
    def some(seed: str) -> list[bytes]:
        stream = Stream(planted.BY_NAME["good"], seed)
        inputs = stream.inputs()
        found = []
        for _ in range(50):
            case = next(inputs)
            stream.learn(case, observe(stream.target, case, tmp_path / "case"))
            found.append(case.files["a.txt"])
        return found

    assert some("1") == some("1")
    assert some("1") != some("2")


def test_workers_that_hang_or_die_are_replaced_and_their_input_is_kept(tmp_path: Path) -> None:
    wanted = {"hang: hang", "crash: crash"}
    task = Task(("hang", "crash"), "3", tmp_path / "faults", catalogue="tests.fuzz.planted")
    report = run(task, minutes=3.0, processes=2, limits=Limits(cpu=0.3), look=lambda found: wanted <= set(found.faults))
    assert set(report.faults) == wanted
    for place in wanted:
        text, kept, _ = report.faults[place]
        assert text in ("the process ended with code -6", "more than 0.3 s of CPU time")
        assert (Path(kept) / "case" / "a.txt").read_bytes() != b"1 2 3\n"
        assert text in report.text()
