"""What is said of values that were fitted for another program."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.report.stack_findings import stack_findings
from beamfield.report.stack_result import StackResult
from beamfield.report.stack_section import stack_verdict
from beamfield.stacks.coordinates import FitSpace, log_of
from beamfield.stacks.filters.amcl_filter import AmclFilterParameters
from beamfield.stacks.fit.fit import _at_edge
from beamfield.stacks.nav2.motion import Nav2Motion


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


class Runs(list):
    """Runs on a stretch, of which so many lost the robot."""

    def __init__(self, n: int, n_lost: int = 0) -> None:
        super().__init__([None] * n)
        self.n_lost = n_lost


def replayed(*, lost: tuple[int, int] = (0, 0), is_better: bool = True, stretches: int = 4) -> StackResult:
    """What replay decided by 15 runs on each stretch, before and after."""
    kept = SimpleNamespace(
        filter=SimpleNamespace(
            model="beam", sensor="fitted", motion=Nav2Motion(), particles=AmclFilterParameters()
        ),
        changes_map=False, key=SimpleNamespace(sensor="fitted"),
    )  # fmt: skip
    before, after = ([Runs(15, n), *[Runs(15)] * (stretches - 1)] for n in lost)
    fit = fitted()
    return StackResult((fit,), fit, SimpleNamespace(
        before=kept, chosen=kept, trials_before=before, trials_finalist=after, is_better=is_better
    ))  # fmt: skip


@pytest.mark.parametrize(
    ("n", "is_better", "names"), [(3, True, ["stack-few-stretches"]), (3, False, []), (4, True, [])]
)
def test_values_that_few_places_have_judged_are_named(n, is_better, names):
    found = stack_findings(replayed(is_better=is_better, stretches=n))
    assert [finding.name for finding in found] == names


def test_random_poses_that_replay_left_out_are_named():
    told = replayed()
    told.replay.before = copy(told.replay.before)
    told.replay.before.filter = copy(told.replay.before.filter)
    told.replay.before.filter.particles = AmclFilterParameters(recovery_alpha_slow=0.001, recovery_alpha_fast=0.1)
    told.replay.parts = {"recovery": SimpleNamespace(before=0.3, after=0.1)}
    (found,) = stack_findings(told)
    assert found.name == "stack-recovery"
    assert "recovery_alpha_slow = 0, recovery_alpha_fast = 0" in found.text
    assert "0.300 m with them, 0.100 m without" in found.why


@pytest.mark.parametrize(
    ("lost", "is_better", "said"),
    [
        ((15, 6), True, None),
        ((15, 7), True, "The filter loses the robot in 7 of 60 runs, with the new values, too."),
        ((7, 0), False, "The filter loses the robot in 7 of 60 runs, and no values tried are better for sure."),
    ],
)
def test_a_filter_that_no_values_keep_on_its_path_is_named(lost, is_better, said):
    found = [one.text for one in stack_findings(replayed(lost=lost, is_better=is_better))]
    assert found == ([said] if said else [])


def test_the_verdict_says_what_replay_decided_and_what_stands_against_it(monkeypatch):
    monkeypatch.setattr("beamfield.report.stack_section.replay_verdict", lambda _: "Use the new values.")
    plain = StackResult((fitted(),), fitted(), SimpleNamespace())
    assert stack_verdict(plain) == "Use the new values."
    in_part, jumps = replace(plain, disagrees=True), replace(plain, leaves_out_jumps=True)
    assert stack_verdict(in_part).startswith("Use the new values. Many scans disagree with the map")
    assert stack_verdict(jumps).startswith("Use the new values. The odometry's jumps were left out: the robot's filter")
    doubtful = replace(plain, doubt="Do not use these values yet: the scale of the map is wrong.")
    assert stack_verdict(doubtful) == doubtful.doubt


def test_without_a_replay_no_value_is_proven():
    assert stack_verdict(result(fitted())) == (
        "no value for nav2 is proven, for its filter could not be replayed: the log has no odometry."
    )


def test_values_as_they_were_are_not_said_to_be_at_the_end_of_what_was_tried():
    kept = fitted()
    kept.chosen = kept.before
    kept.chosen.held_out = scores(0.95, 4.0)
    kept.chosen.setting = {"max_beams": 13}
    assert stack_findings(result(kept)) == []


@pytest.mark.parametrize(("sigma", "names"), [(0.1, ()), (0.0205, ("sigma",)), (0.94, ()), (0.98, ("sigma",))])
def test_a_value_is_at_the_edge_as_near_as_the_optimiser_comes(sigma, names):
    space = FitSpace((log_of("sigma", 0.4, 0.02, 1.0, (0.1,)),), ({},), None, None)
    assert _at_edge(space, SimpleNamespace(sigma=sigma)) == names
