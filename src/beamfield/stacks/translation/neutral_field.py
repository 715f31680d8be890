"""A field's parameters in no stack's words, from and to those of each stack."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from beamfield.errors import InvalidInputError
from beamfield.stacks.files.parameter_text import Value
from beamfield.stacks.mrpt.parameters import LF_THRUN, MrptFieldParameters
from beamfield.stacks.ros1.parameters import ros1_name
from beamfield.stacks.translation.translation import AMCL, CHAPTER, above_one

SQRT_2PI = math.sqrt(2.0 * math.pi)
_MRPT_SWITCHES = {
    "LF_useSquareDist": "the exponent takes the fourth power of the distance",
    "LF_alternateAverageMethod": "the weight is the mean over beams",
}


@dataclass(frozen=True)
class NeutralField:
    """p(d) = peak exp(-d^2 / 2 sigma^2) + floor, with d cut off at max_distance.

    Parameters
    ----------
    peak, floor
        Heights of a hit and of random readings.
    sigma, max_distance
        Metres.
    max_range
        What random readings are divided by, metres.
    max_beams
        Number of beams; None if it is not known.
    """

    peak: float
    floor: float
    sigma: float
    max_distance: float
    max_range: float
    max_beams: int | None = None


def read_field(
    stack: str, model: str, parameters: Any, max_range: float | None, n_beams: int | None, notes: list[str]
) -> NeutralField:
    """Return a stack's field, and add to the notes what is left out."""
    if stack == "mrpt":
        return _mrpt_field(parameters, n_beams, notes)

    def value(name: str) -> Any:
        return getattr(parameters, ros1_name(name) if stack == "ros1" else name)

    limit = value("laser_max_range") if stack == "beluga" else sensor_limit(value("laser_max_range"), max_range)
    peak = value("z_hit") / (SQRT_2PI * value("sigma_hit")) if stack == "beluga" else value("z_hit")
    if getattr(parameters, "do_beamskip", False):
        notes.append("beam skipping is left out: only nav2 and ROS 1 have it")
    if stack == "beluga" and model == "likelihood_field" and parameters.model_unknown_space:
        notes.append("model_unknown_space is left out: only Beluga has it")
    if stack == "beluga" and model == "likelihood_field" and parameters.only_obstacle_boundaries:
        notes.append("only_obstacle_boundaries is left out: elsewhere the inner cells of thick walls are obstacles too")
    return NeutralField(
        peak, value("z_rand") / limit, value("sigma_hit"), value("laser_likelihood_max_dist"), limit, value("max_beams")
    )


def sensor_limit(laser_max_range: float, max_range: float | None) -> float:
    """Return what amcl divides z_rand by, metres: the lesser of its parameter, if positive, and the sensor's limit.

    Raises
    ------
    InvalidInputError
        If neither is known.
    """
    if max_range is None and laser_max_range <= 0.0:
        raise InvalidInputError(
            "max_range: the sensor's longest range is needed, as the file leaves laser_max_range to the sensor"
        )
    if max_range is None:
        return laser_max_range
    return min(laser_max_range, max_range) if laser_max_range > 0.0 else max_range


def field_values(
    target: tuple[str, str], source: NeutralField, max_range: float | None, n_beams: int | None, notes: list[str],
    *, keeps_scale: bool,
) -> dict[str, Value]:  # fmt: skip
    """Return a stack's parameters of a field, and add to the notes what is left out.

    Parameters
    ----------
    target
        Stack and model.
    source
        The field.
    max_range, n_beams
        Of the sensor, if they are known.
    notes
        Get more.
    keeps_scale
        Whether heights stay as they are; otherwise z_hit and z_rand are scaled to a sum of 1.
    """
    stack, model = target
    limit = source.max_range
    scale = SQRT_2PI * source.sigma if stack in ("beluga", CHAPTER) else 1.0
    # nav2 and ROS 1 divide by the lesser of the two, whatever the file says.
    by_sensor = stack in AMCL and max_range is not None and max_range < limit
    hit, rand = source.peak * scale, source.floor * (max_range if by_sensor and max_range is not None else limit)
    if not keeps_scale:
        hit, rand = hit / (hit + rand), rand / (hit + rand)
    if stack == CHAPTER:
        notes.append(f"p_rand is z_rand / max_range: use scans whose max_range is {limit:g} m")
        notes.append("the exponent stays 1, and beams are chosen with n_beams")
        return {"z_hit": hit, "z_rand": rand, "sigma_hit": source.sigma, "max_distance": source.max_distance}
    if stack == "mrpt":
        return _mrpt_values(source, hit, rand, n_beams, notes)
    own: dict[str, Value] = {"z_hit": hit, "z_rand": rand, "sigma_hit": source.sigma}
    if source.max_beams is not None:
        own["max_beams"] = source.max_beams
    values: dict[str, Value] = {"laser_model_type": model}
    values |= {ros1_name(name) if stack == "ros1" else name: value for name, value in own.items()}
    values |= {"laser_likelihood_max_dist": source.max_distance, "laser_max_range": limit}
    if stack == "beluga" and model == "likelihood_field":
        values |= {"model_unknown_space": False, "only_obstacle_boundaries": False}
    elif by_sensor:
        notes.append(f"z_rand is for a sensor whose longest range is {max_range:g} m")
    notes += above_one(stack, hit)
    return values


def _mrpt_field(parameters: MrptFieldParameters, n_beams: int | None, notes: list[str]) -> NeutralField:
    for name, what in _MRPT_SWITCHES.items():
        if getattr(parameters, name):
            raise InvalidInputError(f"{name}: {what}, which no other stack does")
    beams = None if n_beams is None else math.ceil(n_beams / parameters.LF_decimation)
    if beams is None:
        notes.append("max_beams is left out: converting LF_decimation needs the number of beams in a scan (--beams)")
    return NeutralField(
        parameters.LF_zHit, parameters.LF_zRandom / parameters.LF_maxRange, parameters.LF_stdHit,
        parameters.LF_maxCorrsDistance, parameters.LF_maxRange, beams,
    )  # fmt: skip


def _mrpt_values(
    source: NeutralField, hit: float, rand: float, n_beams: int | None, notes: list[str]
) -> dict[str, Value]:
    values: dict[str, Value] = {
        "likelihoodMethod": LF_THRUN, "LF_zHit": hit, "LF_zRandom": rand, "LF_stdHit": source.sigma,
        "LF_maxRange": source.max_range, "LF_maxCorrsDistance": source.max_distance,
    }  # fmt: skip
    if n_beams is not None and source.max_beams is not None:
        values["LF_decimation"] = max(1, round(n_beams / source.max_beams))
    elif source.max_beams is not None:
        notes.append("LF_decimation is left out: converting max_beams needs the number of beams in a scan (--beams)")
    notes.append(
        "MRPT leaves out the first reading after one that is not valid, and points within half a cell of the last"
    )
    return values
