"""Robots in maps painted black where nothing is known: ``python benchmarks/black_maps.py [FOLDER [SEED ...]]``.

FOLDER holds the maps (default: ../shared/data beside the checkout). They are other people's data and not part of this
repository. As in ``other_robots.py``, each robot is calibrated from a drive of two minutes without poses, from its
program's defaults; then its filter, emulated, runs on a second drive with the values and the map before and after, with
10 seeds.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from beamfield.io.read_map import read_map
from other_robots import LASERS, PRODUCT, File, outcome, ros1
from tables import print_table

MAPS = ("berlin", "levine_lobby")
LASERS_USED = ("360 deg, 3.5 m", "270 deg, 30 m")
FILES = {
    "nav2, likelihood_field": File(),
    "nav2, likelihood_field_prob": File(text=PRODUCT),
    "ROS 1 amcl, likelihood_field": ros1("likelihood_field"),
    "Beluga, likelihood_field": File("beluga"),
    "MRPT, LF_Thrun": File("mrpt", "[MetricMap_occupancyGrid_00_likelihoodOpts]\nlikelihoodMethod = 4\n"),
}


def main(folder: Path, seeds: Sequence[int]) -> None:
    """Calibrate and run every robot, and print the table."""
    rows = []
    for name in MAPS:
        plan = read_map(next((folder / "ros_maps" / name).glob("*.yaml")))
        for laser in LASERS_USED:
            for program, file in FILES.items():
                for seed in seeds:
                    with tempfile.TemporaryDirectory() as scratch:
                        found = outcome(LASERS[laser], None, seed, Path(scratch), file=file, plan=plan)
                    rows.append({"map": name, "laser": laser, "program": program, "seed": seed} | found)
                    print(rows[-1], file=sys.stderr, flush=True)
    print_table(rows)


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    main(
        Path(sys.argv[1]) if len(sys.argv) > 1 else here.parent / "shared" / "data",
        [int(word) for word in sys.argv[2:]] or [12],
    )
