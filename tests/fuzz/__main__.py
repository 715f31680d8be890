"""``python -m tests.fuzz``: see the package's docstring."""

from __future__ import annotations

import argparse
import json
import secrets
import sys
import tempfile
import time
from pathlib import Path

from tests.fuzz.campaign import Report, run
from tests.fuzz.case import Case
from tests.fuzz.memory import PeakMemory
from tests.fuzz.outcome import observe
from tests.fuzz.targets import BY_NAME, TARGETS
from tests.fuzz.worker import Task


def main() -> int:
    """Fuzz, or read a kept input again; return 1 if there is a fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description="Fuzz beamfield's readers.")
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", help="default: a fresh one, which is printed")
    parser.add_argument("--only", metavar="NAME,...", help=", ".join(BY_NAME))
    parser.add_argument(
        "--faults", type=Path, default=Path("fuzz_faults"), metavar="FOLDER", help="where faulty inputs are kept"
    )
    parser.add_argument("--replay", type=Path, metavar="FOLDER", help="read a kept input once more")
    arguments = parser.parse_args()
    if arguments.replay is not None:
        if not (arguments.replay / "fault.json").is_file():
            parser.error(f"--replay: no kept input in {arguments.replay}: it has no fault.json")
        return replay(arguments.replay)
    names = arguments.only.split(",") if arguments.only else [target.name for target in TARGETS]
    unknown = [name for name in names if name not in BY_NAME]
    if unknown:
        parser.error(f"no target {', '.join(unknown)}; there are {', '.join(BY_NAME)}")
    seed = arguments.seed or secrets.token_hex(4)
    print(f"seed {seed}", flush=True)
    task = Task(tuple(names), seed, arguments.faults.resolve())
    report = run(task, minutes=arguments.minutes, processes=arguments.processes, look=_Teller())
    print(report.text())
    return 1 if report.faults else 0


def replay(folder: Path) -> int:
    """Read a kept input once more and print what comes of it."""
    document = json.loads((folder / "fault.json").read_text())
    case = Case.read(folder / "case", document["entry"])
    with tempfile.TemporaryDirectory() as place:
        outcome = observe(BY_NAME[document["target"]], case, Path(place) / "case", PeakMemory())
    print(f"{outcome.kind} after {outcome.seconds:.3f} s of CPU time, {outcome.n_bytes / 2**20:.1f} MB\n{outcome.text}")
    return 1 if outcome.is_fault else 0


class _Teller:
    """Says every half minute how far it is."""

    def __init__(self) -> None:
        self._next = time.monotonic() + 30.0

    def __call__(self, report: Report) -> bool:
        if time.monotonic() > self._next:
            self._next = time.monotonic() + 30.0
            rows = report.rows.values()
            inputs, faults = sum(row.inputs for row in rows), sum(row.faults for row in rows)
            print(f"{inputs:,} inputs, {faults:,} faults", file=sys.stderr, flush=True)
        return False


if __name__ == "__main__":
    sys.exit(main())
