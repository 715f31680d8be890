"""Values that mean "no return": found in data, declared, given."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.io.no_return import resolve_no_return


def readings(rng, n_scans=200, n_beams=90, longest=30.0, step=0.01):
    """Ranges as a laser prints them: many short, few long, in steps."""
    z = rng.gamma(2.0, 3.0, (n_scans, n_beams)) + 0.3
    return np.round(np.minimum(z, longest - rng.uniform(0.0, 5.0, z.shape)) / step) * step


def with_share(rng, z, value, share):
    mask = rng.random(z.shape) < share
    return np.where(mask, value, z), mask


@pytest.mark.parametrize("value", [81.83, 50.0, 32.767, 31.0])
@pytest.mark.parametrize("share", [0.003, 0.05, 0.5])
def test_one_repeated_value_at_the_top_means_no_return_and_is_the_limit(rng, value, share):
    z, mask = with_share(rng, readings(rng), value, share)
    found = resolve_no_return(z)
    assert found.max_range == value
    assert found.policy.values == (value,)
    assert found.policy.origin == "detected"
    np.testing.assert_array_equal(np.isposinf(found.ranges), mask)
    np.testing.assert_array_equal(found.ranges[~mask], z[~mask])
    assert found.policy.share == mask.mean()
    assert f"{value:.6g}" in found.policy.explanation


def test_neighbouring_codes_belong_together_and_the_smallest_is_the_limit(rng):
    z = readings(rng)
    codes = rng.choice([51.14, 51.15, 51.16], z.shape, p=[0.3, 0.6, 0.1])
    mask = rng.random(z.shape) < 0.08
    found = resolve_no_return(np.where(mask, codes, z))
    assert found.policy.values == (51.14, 51.15, 51.16)
    assert found.max_range == 51.14
    np.testing.assert_array_equal(np.isposinf(found.ranges), mask)


@pytest.mark.parametrize(("second", "codes"), [(49.92, (49.92, 50.0)), (49.88, (50.0,))])
def test_codes_belong_together_within_a_fifth_of_a_percent_and_do_not_hide_each_other(rng, second, codes):
    z = np.round(rng.uniform(1.0, 49.5, (200, 90)), 2)
    mask = rng.random(z.shape) < 0.08
    found = resolve_no_return(np.where(mask, rng.choice([second, 50.0], z.shape, p=[0.4, 0.6]), z))
    assert found.policy.values == codes
    assert found.max_range == codes[0]


def test_a_glitch_beyond_the_codes_does_not_hide_them(rng):
    z, _ = with_share(rng, readings(rng), 50.0, 0.02)
    z[3, 3] = 655.35
    found = resolve_no_return(z)
    assert found.max_range == 50.0
    assert found.ranges[3, 3] == np.inf
    assert found.policy.share == np.mean(z >= 50.0)


def test_ranges_without_codes_get_a_limit_beyond_the_largest_and_a_note(rng):
    z = readings(rng)
    found = resolve_no_return(z)
    assert found.policy.origin == "none"
    assert found.policy.share == 0.0
    assert z.max() < found.max_range <= z.max() + 0.011
    assert any("declares no limit" in note for note in found.notes)
    np.testing.assert_array_equal(found.ranges, z)


def test_the_far_wall_of_a_robot_that_stands_still_is_no_code():
    # Every beam sees one wall with noise of a few steps: its values repeat as often as the ones below them.
    rng = np.random.default_rng(5)
    bearings = np.radians(np.arange(-60, 61))
    walls = np.minimum(12.0 / np.cos(bearings), 5.0 / np.maximum(np.abs(np.sin(bearings)), 1e-9))
    z = np.round(walls + rng.normal(0.0, 0.01, (300, len(bearings))), 2)
    assert resolve_no_return(z).policy.origin == "none"


def test_coarse_steps_are_no_codes(rng):
    # In steps of a metre every value is frequent, also the largest.
    z = rng.integers(1, 10, (100, 50)).astype(float)
    assert resolve_no_return(z).policy.origin == "none"


def test_readings_of_one_value_only_are_no_codes():
    assert resolve_no_return(np.full((100, 10), 3.0)).policy.origin == "none"


def test_a_declared_limit_is_used_and_readings_that_reach_it_are_no_return(rng):
    z, mask = with_share(rng, readings(rng), 81.91, 0.02)
    found = resolve_no_return(z, declared_max=80.0)
    assert found.max_range == 80.0
    assert found.policy.origin == "declared"
    np.testing.assert_array_equal(np.isposinf(found.ranges), mask)


def test_a_declared_limit_that_the_readings_contradict_is_not_used_and_a_note_says_so(rng):
    z, mask = with_share(rng, readings(rng), 51.15, 0.05)
    found = resolve_no_return(z, declared_max=10.0)
    assert found.max_range == 51.15
    np.testing.assert_array_equal(np.isposinf(found.ranges), mask)
    assert any("declares a limit of 10 m" in note for note in found.notes)


def test_codes_below_the_declared_limit_are_the_limit(rng):
    z, _ = with_share(rng, readings(rng), 30.5, 0.05)
    found = resolve_no_return(z, declared_max=60.0)
    assert found.max_range == 30.5
    assert found.policy.origin == "detected"


def test_a_given_limit_is_always_believed(rng):
    z = readings(rng)
    found = resolve_no_return(z, max_range=5.0)
    assert found.max_range == 5.0
    np.testing.assert_array_equal(np.isposinf(found.ranges), z >= 5.0)
    assert found.policy.origin == "given"


def test_frequent_zeros_mean_no_return_if_nothing_else_does(rng):
    z, mask = with_share(rng, readings(rng, longest=5.5), 0.0, 0.53)
    found = resolve_no_return(z)
    assert found.policy.values == (0.0,)
    np.testing.assert_array_equal(np.isposinf(found.ranges), mask)
    assert found.max_range < 5.6


@pytest.mark.parametrize(("n_zeros", "means_no_return"), [(180, True), (179, False)])  # of 18 000
def test_zeros_are_frequent_from_a_hundredth_on_and_beside_infinity_they_are_nothing(rng, n_zeros, means_no_return):
    z = readings(rng, longest=5.5)
    z.ravel()[:n_zeros] = 0.0
    assert (resolve_no_return(z).policy.values == (0.0,)) is means_no_return
    z[-1, -1] = np.inf
    found = resolve_no_return(z)
    assert found.policy.values == ()
    assert np.isnan(found.ranges.ravel()[:n_zeros]).all()


def test_glitches_beyond_a_declared_limit_do_not_hide_zeros(rng):
    z, zeros = with_share(rng, readings(rng, longest=5.5), 0.0, 0.2)
    z[0, :5] = rng.uniform(7.0, 9.0, 5)
    found = resolve_no_return(z, declared_max=6.0)
    assert (found.policy.values, found.policy.origin) == ((0.0,), "detected")
    np.testing.assert_array_equal(np.isposinf(found.ranges), zeros | (z > 6.0))
    assert found.max_range == 6.0


def test_zeros_beside_codes_and_negative_readings_are_no_measurement(rng):
    z, _ = with_share(rng, readings(rng), 81.83, 0.05)
    z[:20, 0] = 0.0
    z[0, 1], z[0, 2] = -3.0, -np.inf
    found = resolve_no_return(z)
    assert np.isnan(found.ranges[:20, 0]).all()
    assert np.isnan(found.ranges[0, 1])
    assert found.ranges[0, 2] == -np.inf  # too close
    assert any("0 or negative" in note for note in found.notes)


def test_the_user_names_the_values(rng):
    z, mask = with_share(rng, readings(rng), 12.34, 0.3)
    z[z == 0.0] = 0.3
    mask = z == 12.34
    found = resolve_no_return(z, rule=(12.34,))
    assert found.policy.origin == "given"
    np.testing.assert_array_equal(np.isposinf(found.ranges), mask)
    assert found.max_range > 12.34


def test_no_measurement_may_mean_no_return(rng):
    z, mask = with_share(rng, readings(rng), np.nan, 0.2)
    found = resolve_no_return(z, rule=(np.nan,), max_range=82.0)
    np.testing.assert_array_equal(np.isposinf(found.ranges), mask)
    assert found.policy.share == mask.mean()


def test_a_given_value_at_the_top_is_the_limit(rng):
    z, _ = with_share(rng, readings(rng), 81.83, 0.05)
    assert resolve_no_return(z, rule=(81.83,)).max_range == 81.83


def test_none_converts_nothing(rng):
    z, _ = with_share(rng, readings(rng), 81.83, 0.05)
    found = resolve_no_return(z, rule="none")
    np.testing.assert_array_equal(found.ranges, z)
    assert found.policy.share == 0.0
    assert found.max_range > 81.83


def test_the_callers_array_is_untouched(rng):
    z, _ = with_share(rng, readings(rng), 81.83, 0.05)
    before = z.copy()
    resolve_no_return(z)
    np.testing.assert_array_equal(z, before)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rule": "guess"}, "expected 'detect', 'none' or a tuple"),
        ({"rule": (-1.0,)}, "expected values >= 0"),
        ({"max_range": np.inf}, "max_range: expected a finite number"),
        ({"declared_max": 0.0}, "declared_max: expected a finite number"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        resolve_no_return(np.ones((3, 3)), **options)
