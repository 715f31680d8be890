"""The exact traversal itself, that the comparison sees faults, and a small share of `make rays`."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from beamfield.maps.raycast import RayCaster
from tests.rays import compare as compare_module
from tests.rays.compare import Tally, compare
from tests.reference import exact_rays


def series(angle: Fraction) -> tuple[Fraction, Fraction]:
    """Cosine and sine by their series in rational numbers, to some 40 digits."""
    cosine = sum((-1) ** n * angle ** (2 * n) / math.factorial(2 * n) for n in range(40))
    sine = sum((-1) ** n * angle ** (2 * n + 1) / math.factorial(2 * n + 1) for n in range(40))
    return cosine, sine


@pytest.mark.parametrize("angle", [0.0, 1e-12, 0.3, -1.1, math.pi / 4, math.pi / 2, -math.pi, 3.9, 6.283185307179586])
def test_cosine_and_sine_have_thirty_digits(angle):
    for found, wanted in zip(
        exact_rays.cos_sin((angle, 1e-18)), series(Fraction(angle) + Fraction(1e-18)), strict=True
    ):
        assert abs(Fraction(found[0]) + Fraction(found[1]) - wanted) < Fraction(1, 10**30)


def test_many_turns_change_nothing():
    # 355 / 113 is pi to seven digits: 710 rad is 113 turns and 6e-5 rad.
    turns = 113 * 2 * exact_rays._HALF_PI * 2
    rest = Fraction(710) - turns
    cosine, sine = exact_rays.cos_sin((710.0, 0.0))
    for found, wanted in zip((cosine, sine), series(rest), strict=True):
        assert abs(Fraction(found[0]) + Fraction(found[1]) - wanted) < Fraction(1, 10**28)


@pytest.mark.parametrize("operation", ["add", "times", "over"])
def test_arithmetic_has_thirty_digits(rng, operation):
    exact = {"add": Fraction.__add__, "times": Fraction.__mul__, "over": Fraction.__truediv__}[operation]
    for a, b in rng.normal(size=(200, 2)):
        low_a, low_b = a * 1e-17, b * 1e-17
        found = getattr(exact_rays, operation)((a, low_a), (b, low_b))
        wanted = exact(Fraction(a) + Fraction(low_a), Fraction(b) + Fraction(low_b))
        assert abs(Fraction(found[0]) + Fraction(found[1]) - wanted) <= Fraction(1, 10**29) * max(1, abs(wanted))


def test_rays_agree_with_the_exact_traversal(rng):
    tally = Tally()
    for _ in range(60):
        compare(rng, 4_000, tally)
    assert not tally.faults
    assert tally.cells > 100_000


def test_an_error_of_a_billionth_of_a_cell_is_seen(rng, monkeypatch):
    cast = RayCaster.cast
    monkeypatch.setattr(RayCaster, "cast", lambda self, *a: cast(self, *a) * (1 + 1e-9))
    monkeypatch.setattr(compare_module, "TRIES", (200, 2_000))
    tally = Tally()
    while tally.grids < 3:
        compare(rng, 100, tally)
    assert tally.faults


def test_a_wrong_cell_is_seen(rng, monkeypatch):
    hits = RayCaster.cast_hits
    monkeypatch.setattr(RayCaster, "cast_hits", lambda self, *a: np.maximum(hits(self, *a) - 1, -1))
    monkeypatch.setattr(compare_module, "TRIES", (200, 2_000))
    tally = Tally()
    while tally.grids < 3:
        compare(rng, 50, tally)
    assert tally.faults
