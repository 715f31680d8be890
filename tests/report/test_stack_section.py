"""What is said of values that were fitted for another program."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.report.stack_findings import stack_findings
from beamfield.report.stack_result import StackResult
from beamfield.report.stack_section import stack_verdict
from beamfield.stacks.coordinates import FitSpace, log_of
from beamfield.stacks.fit.fit import _at_edge


def scores(coverage: float, mean: float) -> SimpleNamespace:
    return SimpleNamespace(coverage=coverage, mean=mean, log_score=np.zeros(20))


def fitted(coverage: float = 0.95, error: float = 0.1, setting: int = 9, at_edge: tuple[str, ...] = (), **changes):
    """A fit of nav2's beam model as far as these functions look at it: 4, 9 and 13 beams were tried."""
    before = SimpleNamespace(held_out=scores(0.5, 2.0), setting={"max_beams": 60}, parameters=None)
    return SimpleNamespace(**{
        "model": SimpleNamespace(stack="nav2", model="beam"),
        "before": before,
        "chosen": SimpleNamespace(held_out=scores(coverage, 4.0), setting={"max_beams": setting}, parameters=None),
        "trials": tuple(SimpleNamespace(setting={"max_beams": n}) for n in (4, 9, 13)),
        "update": SimpleNamespace(error_after=np.array([error])),
        "update_before": SimpleNamespace(error_after=np.array([0.2])),
        "covers": coverage >= 0.85,
        "at_edge": at_edge,
        **changes,
    })  # fmt: skip


def result(fit: SimpleNamespace) -> StackResult:
    return StackResult((fit,), fit, None, "the log has no odometry")


@pytest.mark.parametrize(
    ("fit", "names"),
    [
        (fitted(), []),
        (fitted(setting=13), ["stack-most-beams"]),
        (fitted(at_edge=("sigma_hit",)), ["stack-at-edge"]),
        (fitted(coverage=0.6), ["stack-coverage"]),
    ],
    ids=["nothing", "most beams", "edge", "coverage"],
)
def test_choices_at_the_end_of_what_was_tried_are_named(fit, names):
    found = stack_findings(result(fit))
    assert [finding.name for finding in found] == names
    assert all(finding.why and finding.do for finding in found)


@pytest.mark.parametrize(
    ("n", "is_better", "names"), [(3, True, ["stack-few-stretches"]), (3, False, []), (4, True, [])]
)
def test_values_that_few_places_have_judged_are_named(n, is_better, names):
    kept = SimpleNamespace(filter=SimpleNamespace(model="beam"), shift=0.0, sensor="fitted")
    replay = SimpleNamespace(before=kept, chosen=kept, trials_before=[()] * n, is_better=is_better)
    fit = fitted()
    assert [finding.name for finding in stack_findings(StackResult((fit,), fit, replay))] == names


def test_the_verdict_compares_with_the_values_before():
    text = stack_verdict(result(fitted()))
    assert "95% regions hold the reference in 95% of 20 held-out windows, with the values before in 50%" in text
    assert "0.100 m from the reference in the mean, before 0.200 m." in text
    assert "before 0.200 m: the values before were surer" in stack_verdict(result(fitted(error=0.3)))
    assert "still too sure" in stack_verdict(result(fitted(coverage=0.6)))
    kept = fitted()
    kept.chosen = kept.before
    kept.chosen.held_out = scores(0.95, 4.0)
    assert stack_verdict(result(kept)).startswith("Keep the values you have for nav2's beam")
    kept.chosen.setting = {"max_beams": 13}
    assert stack_findings(result(kept)) == []


def test_no_verdict_says_to_use_values_where_map_or_poses_are_wrong():
    doubtful = replace(result(fitted()), doubt="Do not use these values yet: the scale of the map is wrong.")
    assert stack_verdict(doubtful) == doubtful.doubt
    in_part = replace(result(fitted()), disagrees_in_part=True)
    assert stack_verdict(in_part).startswith(f"{stack_verdict(result(fitted()))} Many scans disagree with the map")


@pytest.mark.parametrize(("sigma", "names"), [(0.1, ()), (0.0205, ("sigma",)), (0.94, ()), (0.98, ("sigma",))])
def test_a_value_is_at_the_edge_as_near_as_the_optimiser_comes(sigma, names):
    space = FitSpace((log_of("sigma", 0.4, 0.02, 1.0, (0.1,)),), ({},), None, None)
    assert _at_edge(space, SimpleNamespace(sigma=sigma)) == names
