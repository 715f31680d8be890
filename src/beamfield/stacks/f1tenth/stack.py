"""The particle filter of MIT's racecar and F1TENTH."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from beamfield.finding import Finding
from beamfield.models.beam_parameters import WEIGHTS, BeamParameters
from beamfield.stacks.coordinates import FitInputs, FitSpace, log_of, share
from beamfield.stacks.f1tenth.filter import F1tenthFilterParameters, f1tenth_filter
from beamfield.stacks.f1tenth.motion import F1tenthMotion, dispersions
from beamfield.stacks.f1tenth.parameters import F1tenthParameters
from beamfield.stacks.f1tenth.table import F1tenthTable
from beamfield.stacks.stack import SURE, Model, Stack, StackFilter, Weight, models
from beamfield.stacks.syntax.parameter_text import ParameterSection

NODE = "particle_filter"
SIGNS = frozenset(("squash_factor", "range_method", "theta_discretization", "angle_step"))
# Where the search looks first.
PIXELS = (0.5, 1.0, 2.0, 4.0, 8.0)
SQUASHES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)


def _likeness(section: ParameterSection) -> float:
    if NODE in (section.label, section.package):
        return SURE
    found = section.count(SIGNS)
    # Next to as many names of another program they are stray.
    return max(found - 0.25, 0.75 if section.is_ros_2 and NODE in section.label else 0.0)


def _fit_space(model: Model, inputs: FitInputs) -> FitSpace:
    first, learned = model.with_learned(inputs.start, inputs)
    coordinates = [log_of("squash_factor", 0.7, 0.5, 100.0, SQUASHES)]
    if not learned:
        coordinates += [share(WEIGHTS, "z_rand"), log_of("sigma_hit", 0.4, 0.3, 40.0, PIXELS)]
    # One count will do: the exponent 1 / squash_factor makes up for more beams.
    steps = inputs.steps([n for n in inputs.counts if 20 <= n <= 60])
    settings = tuple({"angle_step": step} for step in steps)
    return FitSpace(tuple(coordinates), settings, first, inputs.start, learned)


def _from_chapter(learned: BeamParameters, typical_range: float, cell: float) -> dict[str, float]:
    """Return factors that sum to 1: short readings sum to z_short (d + 1) where d pixels are expected."""
    hit, short, most, rand = learned.weights
    short /= typical_range / cell + 1.0
    total = hit + short + most + rand
    values = {"z_hit": hit / total, "z_short": short / total, "z_max": most / total, "z_rand": rand / total}
    return {**values, "sigma_hit": max(learned.sigma_hit, 1e-3) / cell}


def _chapter_notes(model: Model, plain: BeamParameters, typical_range: float, cell: float) -> list[str]:  # noqa: ARG001
    return [
        (
            f"lambda_short {plain.lambda_short:.3g} is lost: F1TENTH's short readings fall off linearly; z_short keeps "
            f"its share where {typical_range:.3g} m are expected"
        ),
        f"sigma_hit is in cells of {cell:g} m; squash_factor stays as it is",
    ]


def unused_directions(subject: Any) -> Iterator[Finding]:
    """Report a way to cast rays that has no table of directions."""
    method, name = subject.parameters.range_method, "theta_discretization"
    if method in ("bl", "rm", "rmgpu") and name in subject.file.section.entries:
        yield subject.finding(
            "unused-parameters", "info", f"{name} does nothing in {subject.model.name}",
            f"range_method {method} has no table of directions; another value changes nothing",
            "leave them out when comparing files", own=name,
        )  # fmt: skip


F1TENTH = Stack(
    name="f1tenth",
    title="F1TENTH",
    models=models(
        Model(
            emulator=F1tenthTable,
            parameters=F1tenthParameters,
            formula="(Π T)^(1 / squash_factor) over beams; T is the table of ranges by pixels",
            weight=Weight(
                "the product of p^(1 / squash_factor) over ray casts", of_field=False, is_product=True,
                has_exponent=True,
            ),
            fit_space=_fit_space,
            names={"laser_max_range": "max_range", "beam_step": "angle_step"},
            hit_is_density=True,
            unknown_cells="pass",
            from_chapter=_from_chapter,
            chapter_notes=_chapter_notes,
        )
    ),
    likeness=_likeness,
    signs=SIGNS,
    nodes=(NODE,),
    packages=(NODE,),
    flatter="a larger squash_factor",
    filter=StackFilter(motion=F1tenthMotion, parameters=F1tenthFilterParameters, build=f1tenth_filter),
    motions={"dispersion of every scan's step": dispersions},
    checks=(unused_directions,),
)  # fmt: skip
