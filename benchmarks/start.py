"""What a person waits for: CPU seconds of whole commands, with nothing compiled yet (cold) and with all of it (warm).

Run ``python benchmarks/start.py [RUNS]``. The first process of a command finds an empty NUMBA_CACHE_DIR, the next RUNS
(3) what it left there; the least of those counts. CPU time, user and system, of all threads and processes; and the time
that the first run takes by the clock, as it compiles in two processes. beamfield's byte code is in place for both, as
pip leaves it.
"""

from __future__ import annotations

import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DATA = Path(os.environ.get("BEAMFIELD_SHARED", Path(__file__).resolve().parents[2] / "shared")) / "data/wean_hall"
WEAN = (
    *("calibrate", DATA / "robotdata1.log.gz", "--map", DATA / "derived_wean.yaml"),
    *("--poses", DATA / "reference_robotdata1.csv.gz", "--out", "calibration", "--quiet"),
)
# Name, words of the command line, most seconds by the clock cold, and of CPU warm, that are meant to be reached.
COMMANDS = (
    ("--help", ("--help",), None, None),
    ("figures --list", ("figures", "--list"), None, 0.5),
    ("figures", ("figures", "--quiet"), None, 30.0),
    ("calibrate, Wean Hall log 1", WEAN, 20.0, 5.0),
    ("demo", ("demo", "--quiet"), 60.0, None),
)


def main(runs: int) -> None:
    """Time every command and print a table."""
    print(f"Python {platform.python_version()}, {platform.machine()}; seconds, warm: least of {runs}\n")
    print("| command | cold, by the clock | cold, CPU | warm, CPU | aim, cold / warm |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        package = Path(__file__).resolve().parents[1] / "src/beamfield"
        subprocess.run([sys.executable, "-m", "compileall", "-q", package], check=True)
        for name, words, cold_aim, warm_aim in COMMANDS:
            if words is WEAN and not DATA.is_dir():
                print(f"| {name} | not measured: no data | | | |")
                continue
            cache = Path(tempfile.mkdtemp(dir=folder))
            began = time.perf_counter()
            cold = cpu_seconds(words, folder, cache)
            waited = time.perf_counter() - began
            warm = min(cpu_seconds(words, folder, cache) for _ in range(runs))
            aims = " / ".join("-" if aim is None else f"{aim:g}" for aim in (cold_aim, warm_aim))
            print(f"| {name} | {waited:.2f} | {cold:.2f} | {warm:.2f} | {aims} |", flush=True)


def cpu_seconds(words: tuple[str | Path, ...], folder: str, cache: Path) -> float:
    """Run a command in a process of its own and return its CPU time."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "beamfield", *map(str, words)],
        cwd=folder,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        stdout=subprocess.DEVNULL,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
