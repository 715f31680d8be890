"""How honest the covariances of `align` are: in worlds with exact truth, between halves of real scans, by relations.

Run: python benchmarks/alignment_covariance.py [FOLDER WITH DATA]

NEES is the mean of e^T P^-1 e over the alignments without a problem, for the errors e of x, y and theta and their
covariances P: 3 if P is right, its median 2.37, and 95% lie below 7.81. Flagged alignments count in "sure and wrong"
only: more than 0.1 m off, and more than three of their own worst deviations.

- **Exact truth**: rooms, corridors and offices of `alignment_worlds` and of `alignment`, and rooms under one condition
  after the other. Corridors 401 to 414 were not looked at while anything was chosen.
- **Halves**: each scan of a log is cut into the even and the odd ones of its sectors of 30 degrees. The two halves are
  aligned one by one. They see other surfaces with other beams, so that their errors are independent, but for what
  bends or shifts a whole scan; their difference e has the sum of their covariances P, and needs no truth. Differences
  of more than 0.1 m or 0.1 rad are wrong optima and are counted apart.
- **Relations**: people's relative poses err more than alignments do. Their own variance, from the comparison of three
  sources in `alignment`, is added to P. A few relations are wrong, so that medians are shown for them.
- **Stage**: a log of the simulator, with exact poses and readings without noise, but whose rays start in the middle of
  a cell of 5 cm: every scan is shifted as a whole, which no scan can tell. The variance of that is added to P.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from alignment import (
    CHI_SQUARE,
    DATA,
    Pairs,
    align_all,
    fr079_pairs,
    intel_pairs,
    killian_pairs,
    office_pairs,
    own_variances,
    pairs_of_worlds,
    sure_and_wrong,
)
from alignment_worlds import Conditions, corridor_pairs, room_pairs
from beamfield.geometry import between, wrap_angle
from beamfield.io.read_log import read_log
from beamfield.localization.alignment import AlignmentResult, align
from beamfield.sensors import RangeFinder, Scan
from tables import print_table

SECTOR = np.radians(30.0)
# Halves further apart than this, metres and radians, found different optima.
WRONG = (0.1, 0.1)
# Scans so many apart; and the cells of the simulator's rays (`resolution` in its world file), metres.
STAGE_STEP, STAGE_CELL = 5, 0.05


def main() -> None:
    """Print the three tables."""
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else DATA
    rows = [exact_row(name, pairs) for name, pairs in exact_pairs().items()]
    # Both scans are shifted by something uniform over a cell.
    shift = np.diag([STAGE_CELL**2 / 6.0, STAGE_CELL**2 / 6.0, 0.0])
    print_table([*rows, exact_row("Stage", stage_pairs(data), shift)])
    print()
    logs = {"Intel": intel_pairs(data), "FR079": fr079_pairs(data), "Killian": killian_pairs(data)}
    print_table([halves_row(name, pairs) for name, pairs in ({"office, simulated": office_pairs()} | logs).items()])
    print()
    print_table([relations_row(name, pairs) for name, pairs in logs.items()])


def exact_pairs() -> dict[str, Pairs]:
    """Return pairs with exact truth."""
    pairs = {
        "rooms": worlds(room_pairs, range(301, 305)),
        "corridors": worlds(corridor_pairs, range(301, 308)),
        "corridors, other seeds": worlds(corridor_pairs, range(401, 415)),
        "office": office_pairs(),
    }
    full, half = _finder(-180.0, 180.0, 1.0), _finder(-90.0, 90.5, 1.0)
    dense, sparse = _finder(-180.0, 180.0, 0.25), _finder(-180.0, 180.0, 2.0)
    conditions = {
        f"rooms, noise of {1e3 * sigma:g} mm": Conditions(onto=full, scan=full, sigma=sigma)
        for sigma in (0.005, 0.01, 0.02, 0.03, 0.05)
    } | {
        "rooms, no outliers, 20 mm": Conditions(onto=full, scan=full, sigma=0.02, outliers=0.0, people=0.0),
        "rooms, twice the outliers, 3 people": Conditions(onto=full, scan=full, outliers=2.0, people=3.0),
        "rooms, half circle": Conditions(onto=half, scan=half),
        "rooms, 2 onto 0.25 degrees": Conditions(onto=dense, scan=sparse),
        "rooms, 0.25 onto 2 degrees": Conditions(onto=sparse, scan=dense),
        "rooms, 0.25 degrees": Conditions(onto=dense, scan=dense),
        "rooms, half circle turned by 34 degrees": Conditions(onto=half, scan=half, turn=0.6),
    }
    pairs |= {name: worlds(room_pairs, range(501, 503), given) for name, given in conditions.items()}
    name = "rooms, half circle turned by 34 degrees"
    return pairs | {f"{name}, other seeds": worlds(room_pairs, range(511, 521), conditions[name])}


def worlds(make: Any, seeds: Sequence[int], conditions: Conditions | None = None) -> Pairs:
    """Return a hundred pairs for each seed."""
    return pairs_of_worlds([pair for seed in seeds for pair in make(100, seed, conditions or Conditions())])


def stage_pairs(data: Path) -> Pairs:
    """Return scans of the simulator's log half a second apart."""
    log = read_log(data / "uob_stage_sim" / "simpath2.bag").only_sensor()
    first = np.arange(0, len(log) - STAGE_STEP, STAGE_STEP)
    truth = between(log.poses[first], log.poses[first + STAGE_STEP])
    noise = np.random.default_rng(1).normal(size=truth.shape) * (0.1, 0.1, np.radians(4.0))
    return Pairs(
        [log.scan(i) for i in first], [log.scan(i + STAGE_STEP) for i in first], truth, truth + noise
    )  # fmt: skip


def exact_row(name: str, pairs: Pairs, shift: np.ndarray | float = 0.0) -> dict[str, Any]:
    """Return how well covariances tell errors that are known; `shift` is the covariance of what no scan can tell."""
    results = align_all(pairs)
    error = np.array([result.pose for result in results]) - pairs.truth
    covariance = np.array([result.covariance for result in results]) + shift
    fine = np.array([result.problem == "" for result in results])
    wrong = sure_and_wrong(pairs.truth, results)
    return {
        "world": name,
        "pairs": len(results),
        "median mm": f"{1e3 * np.median(np.hypot(error[fine, 0], error[fine, 1])):.1f}",
        **nees_columns(error[fine], covariance[fine]),
        **{
            p: sum(result.problem == p for result in results)
            for p in ("undetermined", "ambiguous", "outside the search")
        },
        "sure and wrong": int(wrong.sum()),
        "NEES of the others": nees_columns(error[fine & ~wrong], covariance[fine & ~wrong])["NEES"],
    }


def halves_row(name: str, pairs: Pairs) -> dict[str, Any]:
    """Return how well covariances tell the differences between the alignments of two halves."""
    found = [
        halves
        for onto, scan, start in zip(pairs.onto, pairs.scans, pairs.starts, strict=True)
        if (halves := align_halves(scan, onto, start)) is not None
    ]
    difference = np.array([even.pose - odd.pose for even, odd in found])
    covariance = np.array([even.covariance + odd.covariance for even, odd in found])
    near = are_near(difference)
    return {
        "log": name,
        "pairs": len(found),
        "further apart than 0.1 m or 0.1 rad": int((~near).sum()),
        **nees_columns(difference[near], covariance[near]),
    }


def align_halves(scan: Scan, onto: Scan, start: np.ndarray) -> tuple[AlignmentResult, AlignmentResult] | None:
    """Return the alignments of the even and of the odd sectors; None if the whole or a half has a problem."""
    whole = align(scan, onto, start)
    if whole.problem:
        return None
    even, odd = (align(_sectors(scan, half, whole.pose[2]), _sectors(onto, half, 0.0), whole.pose) for half in (0, 1))
    return None if even.problem or odd.problem else (even, odd)


def are_near(difference: np.ndarray) -> np.ndarray:
    """Return which differences (n, 3) are not those of wrong optima."""
    distance, turn = np.hypot(difference[:, 0], difference[:, 1]), np.abs(wrap_angle(difference[:, 2]))
    return (distance <= WRONG[0]) & (turn <= WRONG[1])


def _sectors(scan: Scan, half: int, turn: float) -> Scan:
    """Return the scan with every other sector only, by bearings that are turned."""
    kept = np.floor((scan.finder.bearings + turn) / SECTOR) % 2 == half
    return Scan(np.where(kept, scan.ranges, np.nan), scan.finder)


def relations_row(name: str, pairs: Pairs) -> dict[str, Any]:
    """Return how well covariances and the relations' own variance tell their differences, where relations agree."""
    results = align_all(pairs)
    poses = np.array([result.pose for result in results])
    own = own_variances(pairs, poses)["relations"]
    fine = pairs.agreeing() & np.array([result.problem == "" for result in results])
    covariance = np.array([result.covariance for result in results])[fine]
    row = {
        "log": name,
        "agreeing pairs": int(fine.sum()),
        "sure and wrong": int(sure_and_wrong(pairs.truth, results).sum()),
    }
    row |= {"relations mm": f"{1e3 * np.sqrt(own[0]):.0f}", "relations deg": f"{np.degrees(np.sqrt(own[2])):.2f}"}
    deviations = np.sqrt(np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
    row |= {"align mm": f"{1e3 * deviations[:2].mean():.1f}", "align deg": f"{np.degrees(deviations[2]):.2f}"}
    row["sure and wrong"] = int(sure_and_wrong(pairs.truth, results).sum())
    columns = nees_columns((poses - pairs.truth)[fine], covariance + np.diag(own))
    return row | {name: columns[name] for name in ("median NEES", "in 95%")}


def nees_columns(error: np.ndarray, covariance: np.ndarray) -> dict[str, str]:
    """Return mean and median of the errors (n, 3) in units of their covariances, and the share within 95%."""
    error = np.column_stack([error[:, :2], wrap_angle(error[:, 2])])
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    return {
        "NEES": f"{nees.mean():.2f}",
        "median NEES": f"{np.median(nees):.2f}",
        "in 95%": f"{np.mean(nees < CHI_SQUARE[95]):.3f}",
    }


def _finder(first: float, end: float, step: float) -> RangeFinder:
    return RangeFinder.from_bearings(np.radians(np.arange(first, end, step)), 30.0)


if __name__ == "__main__":
    main()
