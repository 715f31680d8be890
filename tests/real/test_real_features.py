"""Features of real logs are found again in the next scan, and their covariances are as honest as documented."""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmarks.features_real import load, run

from beamfield.features.lines import find_lines
from beamfield.features.sweep import RangeNoise

pytestmark = pytest.mark.real


# The levels are those of docs/evidence/features.md less three standard errors of a hundred pairs, or sixty.
@pytest.mark.parametrize(
    ("name", "n_pairs", "lines", "long_lines", "corners", "minima", "too_small"),
    [
        ("Intel", 30, 0.85, 0.92, 0.50, 0.70, 2.0),
        ("TurtleBot 4, straight on", 20, 0.64, 0.88, 0.54, 0.60, 2.2),
    ],
    ids=["Intel", "TurtleBot 4"],
)
def test_features_are_found_again_in_the_next_scan(
    data: Path,
    name: str,
    n_pairs: int,
    lines: float,
    long_lines: float,
    corners: float,
    minima: float,
    too_small: float,
) -> None:
    rows, honest = run(name, data, n_pairs)
    by_kind = {row["feature"]: row for row in rows}
    assert by_kind["line"]["looked at again"] > 3.5 * n_pairs
    for kind, least in (
        ("line", lines),
        ("line of 1 m or more", long_lines),
        ("corner", corners),
        ("local minimum", minima),
    ):
        assert float(by_kind[kind]["found again"]) > least, kind
        # Below the gates: what is found again is the same thing, not just anything near by.
        assert float(by_kind[kind]["difference (mm)"]) < 35.0, kind
    # Honest but for what is no noise of single readings; neither far too small nor blown up until everything fits.
    assert 0.7 < float(honest["deviations are too small by"]) < too_small
    # The walls' own covariances are too small, so that they hold less than 95% of other walls. The alignment's holds
    # more than they do: what is missing is not its share.
    assert float(honest["in 95%, by align"]) > max(float(honest["in 95%, by the other walls"]), 0.7)


def test_noise_that_grows_with_the_range_finds_more_of_a_triangulating_scanners_walls(data: Path) -> None:
    """With one deviation for all ranges, far walls fall to pieces or fail the test of their residuals."""
    log = load("TurtleBot 4", data)
    growing, constant = 0.0, 0.0
    for index in range(0, len(log), 20):
        scan = log.scan(index)
        growing += sum(line.length for line in find_lines(scan, RangeNoise(0.01, sigma_slope=0.004)))
        constant += sum(line.length for line in find_lines(scan, RangeNoise(0.01)))
    assert growing > 1.2 * constant
