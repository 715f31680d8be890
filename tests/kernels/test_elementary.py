"""Elementary functions by arithmetic against the C library's, and the stamp that keeps compiled kernels up to date."""

from __future__ import annotations

import importlib
import math
import sys

import numba
import numpy as np
import pytest

from beamfield.kernels import elementary, jit
from tests.kernels.entry import Entries, entry

functions = Entries(elementary)


def test_vectorised_exponential_is_exact_to_rounding():
    x = -np.concatenate([[0.0], np.geomspace(1e-10, 708.0, 3000)])
    np.testing.assert_allclose([functions.fast_exp(v) for v in x], np.exp(x), rtol=5e-16)
    assert functions.fast_exp(-1e9) == functions.fast_exp(-math.inf) == functions.fast_exp(-708.0)
    assert functions.fast_exp(math.nan) == functions.fast_exp(-708.0)
    assert functions.fast_exp(1e9) == pytest.approx(math.exp(709.0), rel=1e-13)


def test_exp_and_log_are_the_c_librarys():
    x = np.concatenate([np.linspace(-700.0, 700.0, 999), np.linspace(-1.0, 1.0, 999), [0.0]])
    np.testing.assert_allclose([functions.fast_exp(v) for v in x], np.exp(x), rtol=5e-16)
    y = np.exp(x[(x > -690.0) & (x < 690.0)])
    assert np.array([functions.fast_log(v) for v in y]) == pytest.approx(np.log(y), rel=2e-15, abs=2e-15)


def test_powers_of_two_hold_to_thirteen_digits(rng):
    for x in [0.0, -0.5, -1.0, -1019.5, -1020.0, *rng.uniform(-1020, 0, 300), *rng.uniform(-3, 0, 100)]:
        assert functions.exp_2(np.float64(x)) == pytest.approx(2.0**x, rel=2e-14)
    for x in (-1021.0, -1e300, -math.inf, math.nan):
        assert functions.exp_2(np.float64(x)) == 2.0**-1020


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 10.0, 1e3, 9.9e5])
def test_own_cosines_are_those_of_the_c_library(rng, scale):
    for angle in [*(rng.uniform(-1, 1, 200) * scale), 0.0, scale]:
        cosine, sine = functions.cos_sin(angle)
        assert abs(cosine - math.cos(angle)) <= 2.3e-16
        assert abs(sine - math.sin(angle)) <= 2.3e-16


@pytest.mark.parametrize("quarter", range(-8, 9))
def test_own_cosines_are_nearly_exact_at_multiples_of_a_right_angle(quarter):
    angle = quarter * math.pi / 2
    for own, theirs in zip(functions.cos_sin(angle), (math.cos(angle), math.sin(angle)), strict=True):
        assert own == pytest.approx(theirs, rel=1e-15, abs=1e-31)


def test_quick_sine_and_cosine_hold_to_twelve_digits(rng):
    exact = np.pi / 4 * np.arange(-16, 17)
    for angle in [*exact, *rng.uniform(-10, 10, 200), *rng.uniform(-1e5, 1e5, 200)]:
        sine, cosine = functions.quick_sin_cos(angle)
        assert sine == pytest.approx(math.sin(angle), abs=1e-12)
        assert cosine == pytest.approx(math.cos(angle), abs=1e-12)


def test_arc_tangent_is_exact_all_around(rng):
    for angle in [*rng.uniform(-np.pi, np.pi, 500), *(np.arange(-7, 9) * np.pi / 8)]:
        v, u = math.sin(angle), math.cos(angle)
        assert functions.arc_tangent_2(v, u) == pytest.approx(math.atan2(v, u), abs=5e-16)


@pytest.mark.parametrize(("x", "cell", "offset"), [(2.25, 2.0, 0.25), (-0.75, -1.0, 0.25), (3.0 - 1e-10, 3.0, 0.0)])
def test_coordinates_near_a_border_are_on_it(x, cell, offset):
    assert functions.split(x) == (cell, offset)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="kernels are interpreted")
def test_compiled_kernels_are_dropped_when_a_file_changes_whose_kernels_they_call(tmp_path, monkeypatch):
    """Of three files, the kernel of the last calls that of the first by way of the second."""
    text = "from beamfield.kernels.jit import kernel\n{}\n\n@kernel\ndef {}(x):\n    return {}\n"
    (tmp_path / "a_second.py").write_text(text.format("from a_first import once", "again", "once(x)"))
    (tmp_path / "a_third.py").write_text(text.format("from a_second import again", "last", "again(x)"))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))

    def hits(factor):
        """Import the files anew, as another process would; return how often the last kernel came from the disk."""
        for name in ("a_first", "a_second", "a_third"):
            sys.modules.pop(name, None)
        jit.called_files.cache_clear()
        jit._stamp.cache_clear()
        last = importlib.import_module("a_third").last
        assert last(1.0) == factor
        return sum(last.stats.cache_hits.values())

    for factor in (2.0, 3.25):
        (tmp_path / "a_first.py").write_text(text.format("", "once", f"{factor} * x"))
        assert [hits(factor), hits(factor)] == [0, 1]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="kernels are interpreted")
def test_a_kernel_without_an_entry_refuses_python_before_and_after_a_kernel_has_called_it():
    def _double(x):
        return 2.0 * x

    double = jit.kernel(_double)
    for _ in range(2):
        with pytest.raises(TypeError, match="_double: only kernels may call it"):
            double(1.0)
        assert entry(double)(1.0) == 2.0
