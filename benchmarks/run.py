"""Run every benchmark, each in a process of its own, and print its table: ``python benchmarks/run.py [NAME ...]``."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import numba
import numpy

BENCHMARKS = (
    "start",
    "raycast",
    "range_table",
    "beam_model",
    "distance",
    "likelihood_field",
    "learning",
    "map_matching",
    "alignment",
    "likelihood_map",
    "particle_filter",
    "landmark",
    "line",
    "features",
    "feature_information",
    "stacks",
    "scan_fit",
    "sonar",
    "threads",
)


def main(names: list[str]) -> None:
    """Run the named benchmarks, or all."""
    print(
        f"Python {platform.python_version()}, numpy {numpy.__version__}, numba {numba.__version__}, "
        f"{platform.machine()}, {numba.config.NUMBA_NUM_THREADS} processors\n"
    )
    for name in names or BENCHMARKS:
        print(f"## {name}\n", flush=True)
        # A process of its own: peak memory is that of the benchmark, not of those before it.
        subprocess.run([sys.executable, Path(__file__).with_name(f"{name}.py")], check=True)
        print(flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
