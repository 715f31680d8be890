"""Write docs/benchmarks.md and its figure, and add the ratios to history.json: ``python benchmarks/run.py``.

What is written by hand stays: the page's text around the markers. Everything is measured on one thread by its own
processor time, our call and what it is held against in turn, so that ratios hold on a busy machine too. ``--no-start``
leaves out the start of the commands, which takes most of the time, and keeps what the page says of it.
"""

from __future__ import annotations

import argparse
import datetime
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import scipy

from beamfield.kernels.threads import set_threads
from growth import NAMES, Row, draw_growth, measure_growth
from history import add_entry, fallen_ratios, read_history, write_history
from measure import ROUNDS, Case, take_turns
from speed import cases

HERE = Path(__file__).resolve().parent
PAGE, FIGURE = HERE.parent / "docs/benchmarks.md", HERE.parent / "docs/images/benchmarks_growth.svg"


def main(with_start: bool) -> int:
    """Measure and write; return 1 where a ratio has fallen."""
    with set_threads(1):
        table, ratios = measure_cases()
        growth = measure_growth()
    draw_growth(growth).savefig(FIGURE, metadata={"Date": None})
    write_part("speed", [about(), "## Speed\n", *table, "\n## Growth\n", *growth_table(growth)])
    entry = {"commit": commit(), "date": f"{datetime.date.today()}", "machine": machine(), "ratios": ratios}
    entries = add_entry(read_history(), entry)
    write_history(entries)
    fallen = fallen_ratios(entries)
    print("\n".join(fallen) or "no ratio has fallen", flush=True)
    if with_start:
        write_part("start", [f"Commit {commit()}. {start_table()}"])
    return 1 if fallen else 0


def measure_cases() -> tuple[list[str], dict[str, float]]:
    """Return the lines of the table, and the ratios by name."""
    lines = [
        "| what | unit | median | least - most | against | times as fast | time / limit's | accuracy |",
        "|---|---|---|---|---|---|---|---|",
    ]
    ratios: dict[str, float] = {}
    for case in cases():
        print(case.name, flush=True)
        seconds = take_turns(calls_of(case))
        ours = seconds["ours"] * 1e9 / case.n
        faster = float(np.median(seconds["baseline"] / seconds["ours"]))
        ratios[case.name] = round(faster, 3)
        of_limit = ""
        if "limit" in seconds:
            share = float(np.median(seconds["limit"] / seconds["ours"]))
            ratios[f"{case.name}, limit / ours"] = round(share, 3)
            of_limit = f"{1.0 / share:.2f}"
        lines.append(
            f"| {case.name} | {case.unit} | {number(np.median(ours))} | {number(ours.min())} - {number(ours.max())} "
            f"| {case.against} | {faster:.1f} | {of_limit} | {case.accuracy} |"
        )
    return lines, ratios


def calls_of(case: Case) -> dict[str, Any]:
    calls = {"ours": case.ours, "baseline": case.baseline}
    return calls if case.limit is None else calls | {"limit": case.limit}


def number(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def growth_table(rows: list[Row]) -> list[str]:
    """Return the lines of the table of growth."""
    return [
        "Median ns per pose and beam, or per pose and feature.\n",
        f"| what grows | {' | '.join(NAMES)} |",
        "|---|" + "---|" * len(NAMES),
        *(
            f"| {what}: {size:,.0f} | " + " | ".join(number(ns[n]) if n in ns else "" for n in NAMES) + " |"
            for what, size, ns in rows
        ),
        "\n![Time per pose and beam over poses, beams, cells and range](images/benchmarks_growth.svg)",
    ]


def start_table() -> str:
    """Return the table of start.py, which runs the commands in processes of their own."""
    done = subprocess.run([sys.executable, HERE / "start.py", "1"], check=True, capture_output=True, text=True)
    return done.stdout


def about() -> str:
    """Return where and how all this was measured."""
    versions = {"Python": platform.python_version(), "numpy": np.__version__, "scipy": scipy.__version__}
    named = ", ".join(f"{name} {version}" for name, version in {**versions, "numba": numba.__version__}.items())
    return (
        f"Commit {commit()}, {datetime.date.today()}. {machine()}; {named}.\n"
        f"One thread, its processor time: the median of {ROUNDS} rounds, in which our call, what it is held against\n"
        "and the limit take turns, after one that compiles. Ratios are medians of the rounds' ratios.\n"
    )


def machine() -> str:
    """Return processor, number of cores and instruction set: what history compares only with itself."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    facts = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    flags = facts.get("flags", "").split()
    vectors = next((name for flag, name in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if flag in flags), "neither")
    name = facts.get("model name", platform.processor() or platform.machine())
    family = f"family {facts['cpu family']}, " if "cpu family" in facts else ""
    return f"{name}, {family}{numba.config.NUMBA_NUM_THREADS} cores, {vectors}"


def commit() -> str:
    """Return the commit, with + where files differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=HERE, check=True, capture_output=True, text=True).stdout.strip()

    changed = git("status", "--porcelain", "--", "../src", "*.py")
    return git("rev-parse", "--short=10", "HEAD") + ("+" if changed else "")


def write_part(name: str, lines: list[str]) -> None:
    """Replace what is between the markers of a part."""
    begin, end = (f"<!-- make bench: {name}{words} -->" for words in (" from here", " to here"))
    before, rest = PAGE.read_text().split(begin)
    after = rest.split(end)[1]
    PAGE.write_text(before + begin + "\n\n" + "\n".join(lines).rstrip() + "\n\n" + end + after)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-start", action="store_true")
    sys.exit(main(not parser.parse_args().no_start))
