"""The fitted parameters as rows of a table: what each means, its unit, and its value with as many digits as it has."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import NamedTuple

from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.intrinsic.learning_problem import SIGMA_FLOOR_SHARE
from beamfield.models.beam_parameters import EXTENSIONS, BeamParameters

# Unit and meaning; shares have no unit.
MEANINGS = {
    "z_hit": ("", "share of readings that measure the mapped obstacle, with noise"),
    "z_short": ("", "share of readings cut short by something that is not in the map"),
    "z_max": ("", "share of readings without return"),
    "z_rand": ("", "share of readings that nothing explains, spread evenly over all ranges"),
    "sigma_hit": ("m", "standard deviation of the noise of a hit"),
    "lambda_short": ("1/m", "how fast unexpected objects get rarer with range; 0: equally likely at every range"),
    "range_offset": (
        "m",
        "mean of a hit minus the range the map predicts; positive: obstacles lie behind the mapped surface",
    ),
    "sigma_slope": ("m/m", "growth of the noise with the expected range z*: variance sigma_hit^2 + (sigma_slope z*)^2"),
}

# Expected ranges, metres, at which the noise of a hit is spelt out where it grows.
NOISE_AT = (1.0, 3.0, 10.0)

HEADER = ("parameter", "value", "95% interval", "unit", "meaning")


def with_unit(name: str) -> str:
    """Return the name of a parameter with its unit, if it has one."""
    unit = MEANINGS[name][0]
    return f"{name} [{unit}]" if unit else name


class ParameterRow(NamedTuple):
    """The row of a parameter under `HEADER`.

    Parameters
    ----------
    name
        Field of `BeamParameters`.
    value
        The fitted value with as many digits as its interval supports; "below ..." where the fit stopped at the floor of
        sigma_hit, "-" where the log does not determine it.
    interval
        The 95% interval in the same digits, or why there is none.
    unit
        SI unit; "-" for shares.
    meaning
        One line for people.
    """

    name: str
    value: str
    interval: str
    unit: str
    meaning: str


def parameter_rows(calibration: Calibration) -> list[ParameterRow]:
    """Return the parameters in the order of the chapter, then what is beyond it where that is fitted or held."""
    return [
        _row(calibration, item.name)
        for item in fields(BeamParameters)
        if item.name not in EXTENSIONS or _in_use(calibration, item.name)
    ]


def finite_interval(calibration: Calibration, name: str) -> tuple[float, float] | None:
    """Return the 95% interval of a parameter; None if there is none or a bound is not finite."""
    interval = calibration.intervals.intervals.get(name)
    if interval is None or name in calibration.options.hold:
        return None
    low, high = float(interval[0]), float(interval[1])
    return (low, high) if math.isfinite(low) and math.isfinite(high) else None


def decimals_for(half_width: float) -> int:
    """Return how many decimals show two significant digits of an uncertainty; between 3 and 6."""
    if not (math.isfinite(half_width) and half_width > 0.0):
        return 4
    return min(6, max(3, 1 - math.floor(math.log10(half_width))))


def _in_use(calibration: Calibration, name: str) -> bool:
    value = getattr(calibration.parameters, name)
    return value != 0.0 or name in calibration.options.hold or finite_interval(calibration, name) not in (None, (0, 0))


def _row(calibration: Calibration, name: str) -> ParameterRow:
    value = float(getattr(calibration.parameters, name))
    interval = finite_interval(calibration, name)
    if interval is None:
        decimals, text = decimals_for(math.nan), "held" if name in calibration.options.hold else "not determined"
    else:
        decimals = decimals_for((interval[1] - interval[0]) / 2)
        text = f"[{_fixed(interval[0], decimals)}, {_fixed(interval[1], decimals)}]"
    said = _value(calibration, name, value, interval, decimals)
    return ParameterRow(name, said, text, MEANINGS[name][0] or "-", _meaning(calibration, name))


def _value(
    calibration: Calibration, name: str, value: float, interval: tuple[float, float] | None, decimals: int
) -> str:
    """Return the value as text: a bound of the search is no value."""
    if name == "sigma_hit" and interval is not None and interval[0] == 0.0 and at_floor(calibration):
        return f"below {_fixed(interval[1], decimals)}"
    if name == "lambda_short" and name not in calibration.options.hold:
        if value == 0.0 and interval is not None:
            return "0 (uniform)"
        if interval is None and name in calibration.intervals.intervals:
            return "-"
    return _fixed(value, decimals)


def at_floor(calibration: Calibration) -> bool:
    """Return whether sigma_hit stopped where the search does: the noise is smaller, or all of it grows with range."""
    floor = SIGMA_FLOOR_SHARE * calibration.table.max_range
    return "sigma_hit" not in calibration.options.hold and calibration.parameters.sigma_hit <= 1.000001 * floor


def noise_at_ranges(calibration: Calibration) -> str:
    """Return what the noise of a hit comes to at some expected ranges, where it grows with range."""
    sigma, slope = calibration.parameters.sigma_hit, calibration.parameters.sigma_slope
    reach = calibration.table.max_range
    ranges = [z for z in NOISE_AT if z <= reach] or [reach]
    noise = ", ".join(f"{math.hypot(sigma, slope * z):.3f}" for z in ranges)
    return f"{noise} m at {', '.join(f'{z:g}' for z in ranges)} m"


def _meaning(calibration: Calibration, name: str) -> str:
    if name == "sigma_hit" and calibration.parameters.sigma_slope != 0.0:
        return f"noise of a hit, {noise_at_ranges(calibration)}: the part that does not grow with range"
    return MEANINGS[name][1]


def _fixed(value: float, decimals: int) -> str:
    """Fixed-point text; no minus before a zero."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"
