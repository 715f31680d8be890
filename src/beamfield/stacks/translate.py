"""Translate parameters: values that give another stack's model the same relative weights, where there are such."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from beamfield.errors import InvalidInputError
from beamfield.stacks.mrpt_parameters import MrptFieldParameters
from beamfield.stacks.parameter_file import Stack, StackFile, check_model, check_stack
from beamfield.stacks.parameter_text import Value
from beamfield.stacks.ros1_parameters import Ros1Parameters, ros1_name
from beamfield.stacks.typed_values import checked_values

# amcl and its port see walls half a cell off.
_SHIFTED = frozenset(("nav2", "ros1"))
SQRT_2PI = math.sqrt(2.0 * math.pi)
# beamfield's own LikelihoodFieldModel, whose parameters mean what the chapter says.
CHAPTER = "chapter"

# How a scan's weight comes from the values p of its beams. Parameters can be translated within a row, not across.
_FAMILIES: Mapping[str, frozenset[tuple[str, str]]] = {
    "1 + the sum of p^3 over fields": frozenset(
        (("nav2", "likelihood_field"), ("ros1", "likelihood_field"), ("beluga", "likelihood_field"))
    ),
    "the product of p over fields": frozenset(
        (("nav2", "likelihood_field_prob"), ("ros1", "likelihood_field_prob"), ("beluga", "likelihood_field_prob"),
         ("mrpt", "LF_Thrun"), (CHAPTER, "likelihood_field"))
    ),
    "a sum of p^3 over ray casts": frozenset((("nav2", "beam"), ("ros1", "beam"), ("beluga", "beam"))),
    "1 + the sum of log p over ray casts": frozenset((("mrpt", "rayTracing"),)),
    "the product of p^(1 / squash_factor) over ray casts": frozenset((("f1tenth", "table"),)),
}  # fmt: skip

_MRPT_SWITCHES = {
    "LF_useSquareDist": "the exponent takes the fourth power of the distance",
    "LF_alternateAverageMethod": "the weight is the mean over beams",
}


@dataclass(frozen=True)
class Translation:
    """Parameters for another stack.

    Parameters
    ----------
    stack, model
        Whose they are.
    values
        By the stack's own names; parameters that have no counterpart are left out.
    exact
        Whether the relative weights are the same for the same distances (or ranges) of the same beams.
    notes
        What differs all the same, and what was assumed; one sentence each.
    """

    stack: str
    model: str
    values: Mapping[str, Value]
    exact: bool
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Field:
    """A field model in no stack's words: p(d) = peak exp(-d^2 / 2 sigma^2) + floor, d cut off at max_distance."""

    peak: float
    floor: float
    sigma: float
    max_distance: float
    max_range: float
    max_beams: int | None = None


def translate(
    file: StackFile, to: str, *, model: str | None = None, max_range: float | None = None, n_beams: int | None = None
) -> Translation:
    """Translate a stack's parameters into another's.

    Parameters
    ----------
    file
        From `read_stack_file`.
    to
        The other stack: nav2, ros1, beluga, mrpt, f1tenth; or "chapter" for beamfield's own likelihood field.
    model
        The other stack's model; None takes the one that combines beams in the same way.
    max_range
        The sensor's longest range, metres: nav2 and ROS 1 divide z_rand by it if it is less than laser_max_range.
    n_beams
        Beams in a scan, to translate a number of beams into a decimation or back.

    Raises
    ------
    InvalidInputError
        If there are no such parameters, with the reason in one line; or if a number makes no sense.
    FormatError
        If the file has a value that its stack cannot use.
    """
    if max_range is not None and not 0.0 < max_range < math.inf:
        raise InvalidInputError(f"max_range: expected a positive number of metres, got {max_range}")
    if n_beams is not None and n_beams < 1:
        raise InvalidInputError(f"n_beams: expected at least 1, got {n_beams}")
    target = _target(file, to, model)
    parameters = checked_values(file)
    if target[0] == file.stack:
        return Translation(*target, asdict(parameters), True, ())
    if (file.stack, target[0]) == ("ros1", "nav2"):
        return Translation(*target, asdict(parameters.as_nav2()), True, ())
    if (file.stack, target[0]) == ("nav2", "ros1"):
        return Translation(*target, asdict(Ros1Parameters.from_nav2(parameters)), True, ())
    if file.model == "beam":
        return _beam(file, target, parameters, max_range)
    notes: list[str] = []
    source = _field(file, parameters, max_range, n_beams, notes)
    values = _field_values(target, source, max_range, n_beams, notes)
    exact = not any("assumed" in note for note in notes)
    return Translation(*target, values, exact, tuple(notes + _map_notes(file.stack, target[0])))


def _target(file: StackFile, to: str, model: str | None) -> tuple[str, str]:
    """Return stack and model to translate into, or say why there is none."""
    own = (str(file.stack), file.model)
    if to != CHAPTER:
        check_stack(to)
        if model is not None:
            check_model(to, model)
    how = next(name for name, members in _FAMILIES.items() if own in members)
    same = [member for member in _FAMILIES[how] if member[0] == to]
    if not same:
        raise InvalidInputError(
            f"{to} has no model that can weigh as {file.stack}'s {file.model} does: that takes {how}, and no values of "
            "other parameters imitate it"
        )
    if model is not None and same[0][1] != model:
        other = next((name for name, members in _FAMILIES.items() if (to, model) in members), "something else")
        raise InvalidInputError(
            f"{file.stack}'s {file.model} takes {how}, {to}'s {model} takes {other}: no parameters make these the same"
        )
    return same[0]


def _name(stack: str, nav2: str) -> str:
    return ros1_name(nav2) if stack == "ros1" else nav2


# --- fields -----------------------------------------------------------------------------------------------------------


def _field(file: StackFile, parameters: Any, max_range: float | None, n_beams: int | None, notes: list[str]) -> _Field:
    if file.stack == "mrpt":
        return _mrpt_field(parameters, n_beams, notes)

    def value(name: str) -> Any:
        return getattr(parameters, _name(file.stack, name))

    limit = value("laser_max_range")
    if file.stack != "beluga":
        if max_range is not None:
            limit = min(limit, max_range) if limit > 0.0 else max_range
        elif limit <= 0.0:
            raise InvalidInputError(
                "max_range: the sensor's longest range is needed, as the file leaves laser_max_range to the sensor"
            )
        else:
            notes.append(
                f"assumed that the sensor's longest range is {limit:g} m or more: {file.stack} divides z_rand by the "
                "lesser of it and laser_max_range (say what it is)"
            )
    peak = value("z_hit") / (SQRT_2PI * value("sigma_hit")) if file.stack == "beluga" else value("z_hit")
    if value("max_beams") and getattr(parameters, "do_beamskip", False):
        notes.append("beam skipping is left out: only nav2 and ROS 1 have it")
    if file.stack == "beluga" and file.model == "likelihood_field" and parameters.model_unknown_space:
        notes.append("model_unknown_space is left out: only Beluga has it")
    if file.stack == "beluga" and file.model == "likelihood_field" and parameters.only_obstacle_boundaries:
        notes.append(
            "only_obstacle_boundaries is left out: elsewhere the inner cells of thick walls are obstacles, too"
        )
    return _Field(
        peak, value("z_rand") / limit, value("sigma_hit"), value("laser_likelihood_max_dist"), limit, value("max_beams")
    )


def _mrpt_field(parameters: MrptFieldParameters, n_beams: int | None, notes: list[str]) -> _Field:
    for name, what in _MRPT_SWITCHES.items():
        if getattr(parameters, name):
            raise InvalidInputError(f"{name}: {what}, which no other stack does")
    beams = None if n_beams is None else math.ceil(n_beams / parameters.LF_decimation)
    if beams is None:
        notes.append("the number of beams is left out: converting LF_decimation takes the number of beams in a scan")
    return _Field(
        parameters.LF_zHit, parameters.LF_zRandom / parameters.LF_maxRange, parameters.LF_stdHit,
        parameters.LF_maxCorrsDistance, parameters.LF_maxRange, beams,
    )  # fmt: skip


def _field_values(
    target: tuple[str, str], source: _Field, max_range: float | None, n_beams: int | None, notes: list[str]
) -> dict[str, Value]:
    stack, model = target
    limit = source.max_range
    scale = SQRT_2PI * source.sigma if stack in ("beluga", CHAPTER) else 1.0
    # nav2 and ROS 1 divide by the lesser of the two, whatever the file says.
    by_sensor = stack in _SHIFTED and max_range is not None and max_range < limit
    hit, rand = source.peak * scale, source.floor * (max_range if by_sensor and max_range is not None else limit)
    if model == "likelihood_field" and stack != CHAPTER:
        notes.append("z_hit and z_rand keep their scale instead of summing to 1: next to the 1 of this model it counts")
    else:
        # In a product only their ratio matters.
        hit, rand = hit / (hit + rand), rand / (hit + rand)
    if stack == CHAPTER:
        notes.append("p_rand is z_rand / max_range: let the scans' max_range be "
                     f"{limit:g} m; the exponent stays 1, and beams are chosen with n_beams")  # fmt: skip
        return {"z_hit": hit, "z_rand": rand, "sigma_hit": source.sigma, "max_distance": source.max_distance}
    if stack == "mrpt":
        return _mrpt_values(source, hit, rand, n_beams, notes)
    values: dict[str, Value] = {
        "laser_model_type": model, _name(stack, "z_hit"): hit, _name(stack, "z_rand"): rand,
        _name(stack, "sigma_hit"): source.sigma, "laser_likelihood_max_dist": source.max_distance,
        "laser_max_range": limit,
    }  # fmt: skip
    if source.max_beams is not None:
        values[_name(stack, "max_beams")] = source.max_beams
    if stack == "beluga":
        if model == "likelihood_field":
            values |= {"model_unknown_space": False, "only_obstacle_boundaries": False}
    elif by_sensor:
        notes.append(f"z_rand is for a sensor whose longest range is {max_range:g} m")
    notes += _above_one(stack, hit)
    return values


def _mrpt_values(source: _Field, hit: float, rand: float, n_beams: int | None, notes: list[str]) -> dict[str, Value]:
    values: dict[str, Value] = {
        "likelihoodMethod": 4, "LF_zHit": hit, "LF_zRandom": rand, "LF_stdHit": source.sigma,
        "LF_maxRange": source.max_range, "LF_maxCorrsDistance": source.max_distance,
    }  # fmt: skip
    if n_beams is not None and source.max_beams is not None:
        values["LF_decimation"] = max(1, round(n_beams / source.max_beams))
    else:
        notes.append("LF_decimation is left out: converting a number of beams takes the number of beams in a scan")
    notes.append("MRPT leaves out the first reading after one that is not valid, and points 2 cm apart or nearer")
    return values


# --- beam models ------------------------------------------------------------------------------------------------------


def _beam(file: StackFile, target: tuple[str, str], parameters: Any, max_range: float | None) -> Translation:
    """Translate between AMCL's beam model (no constants, 1 + sum) and Beluga's (constants, sum alone)."""
    stack = target[0]

    def value(name: str) -> Any:
        return getattr(parameters, _name(file.stack, name))

    sigma, limit = value("sigma_hit"), value("laser_max_range")
    if file.stack != "beluga" and max_range is not None:
        limit = min(limit, max_range) if limit > 0.0 else max_range
    if limit <= 0.0:
        raise InvalidInputError(
            "max_range: the sensor's longest range is needed, as the file leaves laser_max_range to the sensor"
        )
    constant = SQRT_2PI * sigma
    hit = value("z_hit") * constant if stack == "beluga" else value("z_hit") / constant
    weights = {"z_hit": hit, "z_short": value("z_short"), "z_max": value("z_max"), "z_rand": value("z_rand")}
    total = sum(weights.values())
    notes = [
        "nav2 and ROS 1 add 1 to the sum of cubes, Beluga does not: its weights differ more between poses",
        "Beluga normalises z_short by 1 - exp(-lambda_short z*), nav2 and ROS 1 do not: the same only far from walls",
        "Beluga casts rays from the robot's centre, the others from the sensor",
    ]
    if stack == "beluga":
        weights = {name: weight / total for name, weight in weights.items()}
        notes.append("the weights are scaled to sum to 1: in a bare sum of cubes their scale cancels")
    values: dict[str, Value] = {"laser_model_type": "beam"}
    values |= {_name(stack, name): weight for name, weight in weights.items()}
    values |= {_name(stack, name): value(name) for name in ("sigma_hit", "lambda_short", "max_beams")}
    values["laser_max_range"] = limit
    notes += _above_one(stack, weights["z_hit"])
    return Translation(*target, values, False, tuple(notes + _map_notes(file.stack, stack)))


def _above_one(stack: str, hit: float) -> list[str]:
    if stack not in _SHIFTED or hit <= 1.0:
        return []
    return [f"z_hit is above 1, where builds of {stack} with assertions (debug builds) stop"]


def _map_notes(source: Stack | str, target: str) -> list[str]:
    notes = []
    if (source in _SHIFTED) != (target in _SHIFTED):
        notes.append("nav2 and ROS 1 see walls half a cell off, the others where the map has them")
    if "beluga" in (source, target) and _SHIFTED & {source, target}:
        notes.append("nav2 and ROS 1 take every so many-th beam, Beluga max_beams evenly: not the same beams")
    if "beluga" in (source, target):
        notes.append("off the map Beluga gives 1 / laser_max_range, the others what the maximum distance is worth")
    return notes
