"""Classes along axes beside NumPy's look-up of all midpoints; passes with the JIT off as well."""

from __future__ import annotations

import numpy as np

from beamfield.kernels.axis import count_along_axes


def test_counts_are_those_of_all_midpoints(rng):
    classes = rng.integers(0, 5, (7, 11)).astype(np.uint8)
    angles = rng.uniform(-np.pi, np.pi, 20)
    starts = np.column_stack([rng.uniform(-3.0, 12.0, (20, 2)), np.cos(angles), np.sin(angles)])
    first, spacing, n = 0.4, 0.25, 60
    counts = np.full((20, 6), np.nan)
    count_along_axes(starts, classes, 5, first, spacing, n, counts)
    along = first + (np.arange(n) + 0.5) * spacing
    col = np.floor(starts[:, 0, None] + starts[:, 2, None] * along).astype(int)
    row = np.floor(starts[:, 1, None] + starts[:, 3, None] * along).astype(int)
    inside = (row >= 0) & (row < 7) & (col >= 0) & (col < 11)
    found = np.where(inside, classes[np.clip(row, 0, 6), np.clip(col, 0, 10)], 5)
    expected = np.array([np.bincount(line, minlength=6) for line in found])
    assert 0 < expected[:, 5].sum() < 20 * n
    assert counts.tolist() == expected.tolist()
