"""The tables for the terminal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.calibration.calibrate import CalibrationOptions
from beamfield.finding import Finding
from beamfield.report.parameter_rows import decimals_for, parameter_rows
from beamfield.report.text_table import (
    aligned,
    form_line,
    parameter_table,
    plus_minus,
    readings_line,
    score_table,
    warning_lines,
)
from beamfield.report.verdict import DOUBTS, verdict, verdict_level


def cells(table: str) -> dict[str, str]:
    """First word of each line -> the line."""
    return {line.split()[0]: line for line in table.splitlines() if line.strip()}


def test_each_parameter_stands_with_its_value_interval_and_unit(case):
    lines = cells(parameter_table(case.calibration))
    assert lines["sigma_hit"].split()[1:5] == ["0.0500", "[0.0480,", "0.0525]", "m"]
    assert lines["lambda_short"].split()[1:5] == ["0.300", "[0.288,", "0.315]", "1/m"]
    assert lines["z_hit"].split()[1:5] == ["0.800", "[0.768,", "0.840]", "-"]


def with_interval(case, name: str, value: float, interval: tuple[float, float]):
    intervals = {**case.calibration.intervals.intervals, name: interval}
    return replace(
        case.calibration,
        parameters=replace(case.calibration.parameters, **{name: value}),
        intervals=replace(case.calibration.intervals, intervals=intervals),
    )


def row(calibration, name: str):
    return next(row for row in parameter_rows(calibration) if row.name == name)


def test_a_rate_of_zero_says_that_it_means_uniform(case):
    found = row(with_interval(case, "lambda_short", 0.0, (0.0, 0.12)), "lambda_short")
    assert (found.value, found.interval) == ("0 (uniform)", "[0.000, 0.120]")


def test_a_rate_that_is_not_determined_has_no_value(case):
    found = row(with_interval(case, "lambda_short", 0.0, (0.0, np.inf)), "lambda_short")
    assert (found.value, found.interval) == ("-", "not determined")


def test_the_floor_of_the_search_is_not_printed_as_noise(case):
    """The room's sensor reaches 10 m: its floor is 0.0001 m."""
    found = row(with_interval(case, "sigma_hit", 1e-4, (0.0, 0.0042)), "sigma_hit")
    assert (found.value, found.interval) == ("below 0.0042", "[0.0000, 0.0042]")
    found = row(with_interval(case, "sigma_hit", 0.002, (0.0, 0.0042)), "sigma_hit")
    assert found.value == "0.0020"


def test_noise_that_grows_is_spelt_out_at_some_ranges(case):
    growing = with_interval(case, "sigma_slope", 0.01, (0.008, 0.012))
    assert "noise of a hit, 0.051, 0.058, 0.112 m at 1, 3, 10 m" in row(growing, "sigma_hit").meaning
    assert "The noise of a hit grows with range: 0.051, 0.058, 0.112 m at 1, 3, 10 m." in verdict(growing)
    assert "sigma_hit" not in verdict(growing)
    short = replace(growing, table=replace(growing.table, max_range=4.0))
    assert "0.051, 0.058 m at 1, 3 m:" in row(short, "sigma_hit").meaning


# Without one of these, values of a wrong map or of wrong poses would be written into the robot's file.
DOUBTFUL = (
    "map-says-nothing", "map-disagrees", "hits-anywhere", "map-scale", "poses-off-map", "reference-stands-still",
    "reference-slides", "few-poses-trusted", "field-says-nothing",
)  # fmt: skip


@pytest.mark.parametrize("name", DOUBTFUL)
def test_the_verdict_does_not_praise_a_fit_to_poses_or_a_map_that_cannot_be_trusted(case, name):
    doubtful = replace(
        case.calibration, findings=(Finding(name, "warning", "..."), Finding("few-blocks", "warning", ""))
    )
    assert verdict(doubtful) == (
        f"Do not use these values yet: {DOUBTS[name]}. Read the 2 warnings before you trust it."
    )
    assert verdict_level(doubtful) == "bad"


@pytest.mark.parametrize("seen", ["cones", "moving-objects"])
def test_a_field_that_says_nothing_of_cones_or_of_crowds_is_no_reason_to_doubt_the_beam_model(case, seen):
    both = (Finding(seen, "info", ""), Finding("field-says-nothing", "warning", ""))
    assert verdict_level(replace(case.calibration, findings=both)) == "care"


def test_the_level_of_the_verdict_is_that_of_its_worst_reason(case):
    calm = replace(case.calibration, findings=case.calibration.findings[1:])
    assert verdict_level(calm) == "good"
    assert verdict_level(case.calibration) == "care"  # a warning
    rival = replace(calm.scores[1], behind_fit=-0.1)
    assert verdict_level(replace(calm, scores=(calm.scores[0], rival))) == "care"
    assert verdict_level(replace(calm, learning=replace(calm.learning, converged=False))) == "bad"


def test_the_form_of_the_hits_is_named_by_what_was_fitted_not_by_its_title(case):
    first, second = case.calibration.candidates
    assert (
        form_line(case.calibration)
        == "Hit model: plain Gaussian. 1 extension did not improve held-out likelihood enough."
    )
    renamed = replace(case.calibration, candidates=(replace(first, name="another title"), second))
    assert form_line(renamed) == form_line(case.calibration)


def test_readings_are_accounted_for(case):
    table = replace(case.calibration.table, n_no_measurement=3000, n_too_close=1000, n_unknown=360, min_range=0.15)
    line = readings_line(replace(case.calibration, table=table))
    assert "of their 12,000 readings used" in line
    assert "2,000 (16.7%) NaN, 1,000 (8.3%) nearer than 0.15 m, 360 (3.0%) into unknown space" in line


def test_extensions_stand_only_where_they_are_in_use(case):
    assert "range_offset" not in parameter_table(case.calibration)
    assert "sigma_slope" not in parameter_table(case.calibration)
    other = replace(case.calibration, parameters=replace(case.calibration.parameters, range_offset=0.03))
    assert cells(parameter_table(other))["range_offset"].split()[1] == "0.0300"


def test_a_held_parameter_is_marked_and_has_no_interval(case):
    held = replace(case.calibration, options=CalibrationOptions(hold={"lambda_short": 0.3}))
    assert cells(parameter_table(held))["lambda_short"].split()[2] == "held"


def test_an_interval_that_is_not_finite_is_not_printed(case):
    intervals = {**case.calibration.intervals.intervals, "z_short": (float("nan"), float("nan"))}
    broken = replace(case.calibration, intervals=replace(case.calibration.intervals, intervals=intervals))
    table = parameter_table(broken)
    assert "not determined" in cells(table)["z_short"]
    assert "nan" not in table


@pytest.mark.parametrize(
    ("half_width", "decimals"),
    [(0.2, 3), (0.013, 3), (0.0023, 4), (0.00012, 5), (1e-9, 6), (0.0, 4), (float("nan"), 4)],
)
def test_digits_follow_the_uncertainty(half_width, decimals):
    assert decimals_for(half_width) == decimals


def test_a_zero_has_no_minus(case):
    parameters = replace(case.calibration.parameters, range_offset=-1e-9)
    rows = parameter_rows(replace(case.calibration, parameters=parameters))
    assert next(row for row in rows if row.name == "range_offset").value == "0.0000"


def test_scores_stand_in_nats_with_their_standard_errors(case):
    table = score_table(case.calibration)
    for score in case.calibration.scores:
        line = next(line for line in table.splitlines() if line.startswith(score.name))
        assert f"{score.log_likelihood:.4f} ± {score.standard_error:.4f}" in line
    nav2 = case.calibration.scores[1]
    assert f"{nav2.behind_fit:+.4f} ± {nav2.behind_fit_se:.4f}" in table


def test_columns_line_up(case):
    lines = parameter_table(case.calibration).splitlines()
    starts = [i for i in range(1, len(lines[1])) if lines[1][i - 1] == " " and lines[1][i] == "-"]
    for line in lines[2:]:
        assert all(line[i - 1] == " " for i in starts)


def test_the_meaning_is_broken_to_the_width_of_a_terminal(case):
    whole, narrow = parameter_table(case.calibration), parameter_table(case.calibration, width=80)
    assert max(map(len, whole.splitlines())) > 80 >= max(map(len, narrow.splitlines()))
    words = [[word for word in table.split() if set(word) != {"-"}] for table in (whole, narrow)]
    assert sorted(words[0]) == sorted(words[1])
    # Where there is no room for words, lines stay as they are.
    assert parameter_table(case.calibration, width=50) == whole
    # Intervals of many digits leave less room; three lines of 21 characters still read better than one of 120.
    narrow = aligned(("a", "b"), [("x" * 57, "how fast unexpected objects get rarer with range")], right=(), width=80)
    assert max(map(len, narrow.splitlines())) <= 80


def test_headers_are_broken_where_a_table_is_wider_than_the_terminal():
    header, rows = ("model", "error after update [m]", "coverage"), [("likelihood_field, before", "0.229", "100%")]
    assert aligned(header, rows, right=(1, 2), width=60) == aligned(header, rows, right=(1, 2))
    assert aligned(header, rows, right=(1, 2), width=50).splitlines() == [
        "                          error after",
        "model                      update [m]  coverage",
        "------------------------  -----------  --------",
        "likelihood_field, before        0.229      100%",
    ]


def test_the_form_says_what_was_chosen_and_for_what_gain(case):
    assert "1 extension did not improve held-out likelihood enough" in form_line(case.calibration)
    first, second = case.calibration.candidates
    chosen = (replace(first, chosen=False), replace(second, chosen=True, gain=0.25, gain_se=0.03))
    text = form_line(replace(case.calibration, candidates=chosen))
    assert "range offset" in text
    assert "+0.2500 ± 0.0300" in text
    assert "only one" in form_line(replace(case.calibration, candidates=(first,)))


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.25, 0.5, "1.2500 ± 0.5000"),
        (1.25, np.nan, "1.2500"),
        (-np.inf, np.nan, "-inf"),
        (np.inf, np.nan, "+inf"),
        (np.nan, 1.0, "unknown"),
    ],
)
def test_unknown_errors_and_infinite_values_are_words(value, error, text):
    assert plus_minus(value, error) == text


def test_errors_are_said_as_well_as_warnings():
    """A landmark sensor whose bearings have nothing to do with the landmarks has no other warning."""
    findings = [Finding("bearing-unrelated", "error", "Wrong."), Finding("small", "info", "Fine.")]
    assert warning_lines(findings) == ["error (bearing-unrelated): Wrong."]
