"""Which cells rays cross, against the overlap of each ray with each cell; passes with the JIT off as well."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.kernels.crossings import count_crossings


def overlap(ray: np.ndarray, length: float, col: int, row: int) -> float:
    """Return the length of a ray inside a cell, by the slab method; negative if it misses the cell."""
    low, high = 0.0, length
    for start, step, edge in ((ray[0], np.cos(ray[2]), col), (ray[1], np.sin(ray[2]), row)):
        if abs(step) < 1e-15:
            if not edge <= start < edge + 1:
                return -1.0
            continue
        a, b = sorted(((edge - start) / step, (edge + 1 - start) / step))
        low, high = max(low, a), min(high, b)
    return high - low


def counted(rays, lengths, labels) -> np.ndarray:
    counts = np.zeros(int(labels.max()) + 1, np.int64)
    count_crossings(np.asarray(rays, float), np.asarray(lengths, float), labels.astype(np.int32), counts)
    return counts


def test_each_cell_that_a_ray_overlaps_is_counted_once(rng):
    rows, cols = 7, 9
    labels = np.arange(rows * cols).reshape(rows, cols)
    for _ in range(60):
        ray, length = np.array([*rng.uniform(-3.0, 11.0, 2), rng.uniform(-np.pi, np.pi)]), rng.uniform(0.1, 15.0)
        inside = np.array([overlap(ray, length, col, row) for row in range(rows) for col in range(cols)])
        found = counted([ray], [length], labels)
        assert set(found) <= {0, 1}
        assert (found[inside > 1e-9] == 1).all()
        assert (found[inside < -1e-9] == 0).all()


@pytest.mark.parametrize(
    ("ray", "length", "wanted"),
    [
        ((0.5, 0.5, 0.0), 2.2, [1, 1, 1]),
        ((0.5, 0.5, 0.0), 0.4, [1, 0, 0]),
        ((2.5, 0.5, np.pi), 5.0, [1, 1, 1]),
        ((-4.0, 0.5, 0.0), 5.5, [1, 1, 0]),
        ((0.5, 0.5, np.pi / 2), 9.0, [1, 0, 0]),
        ((0.5, 0.5, 0.0), 0.0, [0, 0, 0]),
        ((0.5, 0.5, 0.0), np.nan, [0, 0, 0]),
    ],
    ids=["three", "short", "back", "from-outside", "across", "no-length", "nan"],
)
def test_rays_along_a_row(ray, length, wanted):
    assert counted([ray], [length], np.array([[0, 1, 2]])).tolist() == wanted


def test_a_ray_counts_once_for_a_place_that_it_crosses_twice():
    labels = np.array([[0, 1, 0, -1, 1]])
    assert counted([(0.5, 0.5, 0.0)] * 3, [5.0, 5.0, 0.1], labels).tolist() == [3, 2]
