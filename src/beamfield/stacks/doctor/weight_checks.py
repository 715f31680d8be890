"""Factors and widths: what they add up to, and what cancels them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

from beamfield.finding import Finding
from beamfield.models.beam_parameters import WEIGHTS
from beamfield.stacks.doctor.subject import Subject
from beamfield.stacks.stack import FIELD_PRODUCT

SUM_TOLERANCE = 1e-3
# A hit that is cut off nearer than this many sigma still weighs something there.
CUT_SIGMAS = 2.5


def weights_sum(subject: Subject) -> Iterator[Finding]:
    """Find weights that the model uses and that do not sum to 1."""
    names = ("z_hit", "z_rand") if subject.model.weight.of_field else WEIGHTS
    values = [subject.value(name) for name in names]
    if None in values or abs(sum(values) - 1.0) <= SUM_TOLERANCE:
        return
    total = float(sum(values))
    terms = " + ".join(f"{subject.name_of(name)} {value:g}" for name, value in zip(names, values, strict=True))
    why = "the stack's documents ask for a sum of 1, but nothing checks it. "
    if subject.model.factor_cancels:
        why += "A common factor scales all poses' weights alike, so only their meaning as shares is lost"
    else:
        why += "The weight of a scan is 1 + the sum of p^3 over its beams, so that a common factor does not cancel"
        if total > 0.0:  # of a sum of 0 there are no shares
            why += f": the beams count {total**3:.2g} times as much against that 1 as with a sum of 1"
    yield subject.finding(
        "weights-sum", "info",
        f"the weights that {subject.file.model} uses sum to {total:.4g}: {terms}", why,
        "divide each by their sum, then check nearly-flat" if total < 1.0 or subject.model.factor_cancels
        else "divide each by their sum; the scan then counts less, so calibrate or check nearly-flat",
        parameter="z_hit", values={"total": total},
    )  # fmt: skip


def value_above_one(subject: Subject) -> Iterator[Finding]:
    """Find factors with which one beam is worth more than 1, which amcl's code takes for impossible."""
    if not subject.stack.asserts_p:
        return
    hit, short, most, rand, rate = (subject.value(n) for n in ("z_hit", "z_short", "z_max", "z_rand", "lambda_short"))
    if None in (hit, short, most, rand, rate):
        return
    # Random readings add z_rand / range_max, a few percent of it at most.
    largest = hit if subject.model.weight.of_field else max(hit + short * rate, hit + most)
    if largest > 1.0 + 1e-9:
        yield subject.finding(
            "value-above-one", "warning", f"one beam can score {largest:.4g}, which is more than 1",
            f"{subject.file.stack} asserts that no beam scores more than 1: builds with assertions, such as debug "
            "builds, stop there",
            "divide the weights by their sum", parameter="z_hit", values={"largest": float(largest)},
        )  # fmt: skip


def unused_weights(subject: Subject) -> Iterator[Finding]:
    """Find values in the file that its model never reads."""
    for names, why in _unused(subject):
        given = [name for name in names if name in subject.file.section.entries]
        if given:
            yield subject.finding(
                "unused-parameters", "info",
                f"{', '.join(given)} {'does' if len(given) == 1 else 'do'} nothing in {subject.file.model}",
                f"{why}; another value changes nothing",
                "leave them out when comparing files", own=given[0],
            )  # fmt: skip


def no_random(subject: Subject) -> Iterator[Finding]:
    """Find a product of beams in which one unexplained reading forbids a pose."""
    # Where values are added up, a beam without value only adds nothing.
    if subject.value("z_rand") == 0.0 and subject.model.multiplies(subject.parameters):
        yield subject.finding(
            "no-random-readings", "warning", f"{subject.name_of('z_rand')} is 0",
            "one reading that nothing in the map explains, such as a person, makes the true pose (nearly) impossible",
            "give it a few percent", parameter="z_rand",
        )  # fmt: skip


def sigma_against_resolution(subject: Subject) -> Iterator[Finding]:
    """Find a sigma that the map's cells cannot show, or one as wide as a corridor."""
    sigma, grid = _sigma_metres(subject), subject.grid
    if sigma is None:
        return
    if grid is not None and sigma < grid.resolution / 2.0:
        yield subject.finding(
            "sigma-below-resolution", "warning",
            f"{subject.name_of('sigma_hit')} is {sigma:g} m, the map's cells are {grid.resolution:g} m",
            "a wall is drawn up to half a cell from where it is: a narrower hit calls most true readings random",
            f"use at least half a cell, {grid.resolution / 2.0:g} m, or calibrate", parameter="sigma_hit",
            values={"sigma": sigma, "resolution": grid.resolution},
        )  # fmt: skip
    if sigma > 0.5:
        yield subject.finding(
            "sigma-huge", "info", f"{subject.name_of('sigma_hit')} is {sigma:g} m",
            "laser readings miss walls of a good map by centimetres; so wide a hit cannot tell nearby poses apart",
            "calibrate it; 0.05 to 0.2 m is usual", parameter="sigma_hit", values={"sigma": sigma},
        )  # fmt: skip


def distance_limit(subject: Subject) -> Iterator[Finding]:
    """Find a maximum distance that cuts into the hits."""
    if not subject.model.weight.of_field:
        return
    sigma, limit = _sigma_metres(subject), subject.value("laser_likelihood_max_dist")
    width = subject.name_of("sigma_hit")
    if sigma is not None and limit is not None and limit < CUT_SIGMAS * sigma:
        yield subject.finding(
            "distance-limit", "info",
            f"{subject.name_of('laser_likelihood_max_dist')} is {limit:g} m, {limit / sigma:.2g} {width}",
            "a reading anywhere beyond it scores as much as one at that distance, which is still a fair hit: weights "
            "get flatter, and far readings that do not fit hardly count",
            f"nothing, if intended; otherwise at least {CUT_SIGMAS:g} {width}, {CUT_SIGMAS * sigma:.2g} m",
            parameter="laser_likelihood_max_dist", values={"limit": limit, "sigma": sigma},
        )  # fmt: skip


def _unused(subject: Subject) -> Iterator[tuple[list[str], str]]:
    """Yield names that the model never reads, and why."""
    model, weight = subject.model, subject.model.weight
    if weight.of_field:
        names = [subject.name_of(name) for name in ("z_short", "z_max", "lambda_short") if model.has(name)]
        yield names, "only the beam model has short and max readings"
    if weight != FIELD_PRODUCT and subject.value("do_beamskip"):
        # Switched off, as in the programs' example files, nobody expects anything of it.
        yield ["do_beamskip"], "only likelihood_field_prob leaves out beams"
    read = {item.name for item in fields(subject.parameters)}
    yield sorted(subject.stack.parameter_names - read), f"{subject.stack.model_key} chooses another model"


def _sigma_metres(subject: Subject) -> float | None:
    if subject.value("sigma_hit") is None:
        return None
    return subject.model.sigma(subject.parameters, None if subject.grid is None else subject.grid.resolution)
