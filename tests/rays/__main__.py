"""Cast many adversarial rays and report: `make rays` or `python -m tests.rays --rays 1e8 --seed 7`."""

from __future__ import annotations

import argparse
import secrets
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed

from tests.rays.compare import PER_TASK, Tally, run


def main() -> int:
    """Return 1 if any ray is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rays", type=float, default=1e8, help="how many (default: 1e8)")
    parser.add_argument("--seed", type=int, default=None, help="default: a new one, printed")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    seed = secrets.randbits(32) if options.seed is None else options.seed
    n_tasks = max(1, round(options.rays / PER_TASK))
    print(f"seed {seed}, {n_tasks} parts of {PER_TASK:,} rays", flush=True)
    began, whole = time.perf_counter(), Tally()
    with ProcessPoolExecutor(options.processes) as pool:
        parts = [pool.submit(run, seed, part) for part in range(n_tasks)]
        for done, future in enumerate(as_completed(parts), 1):
            add(whole, future.result())
            if done % max(1, n_tasks // 20) == 0:
                print(
                    f"{whole.rays:,} rays, {len(whole.faults)} faults, {time.perf_counter() - began:.0f} s", flush=True
                )
    for fault in whole.faults[:20]:
        print("FAULT", fault)
    print(
        f"{whole.rays:,} rays in {whole.grids:,} maps, {whole.cells:,} cells compared; "
        f"{whole.by_rounding:,} decided by rounding; "
        f"largest error {whole.worst:.2f} of its bound, {whole.worst_cells:.1e} cells; "
        f"{len(whole.faults)} faults; {time.perf_counter() - began:.0f} s"
    )
    return 1 if whole.faults else 0


def add(whole: Tally, part: Tally) -> None:
    """Add a part to the whole."""
    whole.rays += part.rays
    whole.grids += part.grids
    whole.by_rounding += part.by_rounding
    whole.cells += part.cells
    whole.worst = max(whole.worst, part.worst)
    whole.worst_cells = max(whole.worst_cells, part.worst_cells)
    whole.faults += part.faults


if __name__ == "__main__":
    sys.exit(main())
