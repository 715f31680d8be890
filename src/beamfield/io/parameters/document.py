"""What beamfield's own files of parameters share: one section of named numbers, intervals, and where they come from."""

from __future__ import annotations

import io
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from ruamel.yaml import YAML

from beamfield.errors import InvalidInputError
from beamfield.io.files.yaml_file import YamlFile, read_yaml, shorten
from beamfield.printable import printable
from beamfield.sensors import RangeFinder

# Each file has one of these, and is named after it.
SECTIONS = ("beam_model", "likelihood_field", "landmark_model")
# How much beams count (6.3.4).
COUNTING = ("exponent", "single_scan_exponent", "n_beams")

Saved = TypeVar("Saved")


def document_text(
    header: str,
    document: Mapping[str, Any],
    *,
    intervals: Mapping[str, tuple[float, float]] | None,
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """Return the text of a file: a header of comments, and sections of plain values.

    Numbers are written so that reading returns the same bits, 95% intervals with six digits; null where a bound is not
    finite: not determined. The provenance says where the parameters come from, in plain values.
    """
    whole = dict(document)
    if intervals:
        whole["intervals_95"] = {
            name: [six_digits(low), six_digits(high)] if math.isfinite(low) and math.isfinite(high) else None
            for name, (low, high) in intervals.items()
        }
    if provenance:
        whole["provenance"] = dict(provenance)
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    stream = io.StringIO()
    yaml.dump(whole, stream)
    return header + stream.getvalue()


def sensor_section(finder: RangeFinder) -> dict[str, Any]:
    """Return the section that names the sensor and its limits, with six digits: logs have single precision."""
    max_range = six_digits(finder.max_range)
    if max_range > finder.max_range:
        max_range = float(finder.max_range)  # rounded up, readings at the limit would no longer be "no return"
    return {"name": printable(finder.name), "min_range": six_digits(finder.min_range), "max_range": max_range}


def six_digits(value: float) -> float:
    """Return the number that six significant digits give."""
    return float(f"{value:.6g}")


def named_numbers(
    file: YamlFile, section: str, names: Sequence[str], *, required: Collection[str], may_be_null: Collection[str] = ()
) -> dict[str, Any]:
    """Return the numbers of a section, or None where one is null, by name.

    FormatError names the line if the section or a parameter is missing, a parameter is unknown or no finite number.
    """
    if section not in file.values:
        other = next((name for name in SECTIONS if name in file.values), None)
        got = f", got a {other}.yaml" if other else ""
        raise file.error(f"the key {section!r} is missing; expected a {section}.yaml of beamfield{got}")
    given = file.value(section)
    if not isinstance(given, dict):
        raise file.error(f"expected the parameters' names and values, got {shorten(given)}", section)
    for name in given:
        if name not in names:
            raise file.error(f"unknown parameter {name!r}; known parameters are {', '.join(names)}", section, name)
    values: dict[str, Any] = {}
    for name in names:
        if name in given or name in required:
            is_null = name in may_be_null and file.value(section, name) is None
            values[name] = None if is_null else file.number(section, name)
    return values


def read_saved(
    path: str | Path, section: str, names: Sequence[str], kind: type[Saved], *, required: Collection[str]
) -> Saved:
    """Return what the file of a model of scans says: parameters, how much beams count, and the sensor's limits.

    FormatError as of `named_numbers`, and if one of them is outside its range.
    """
    file = read_yaml(path)
    values = named_numbers(file, section, [*names, *COUNTING], required=required)
    counting, limits = _counting(file, section, values), _limits(file)
    try:
        return kind(**values, **counting, **limits)
    except InvalidInputError as error:
        raise file.error(str(error), section) from error


def _limits(file: YamlFile) -> dict[str, Any]:
    """Return the sensor's limits in a file, checked, as keyword arguments of a saved model; no min_range is 0."""
    max_range = file.number("sensor", "max_range")
    min_range = file.number("sensor", "min_range") if "min_range" in file.value("sensor") else 0.0
    if not 0.0 <= min_range < max_range:
        raise file.error(f"expected 0 <= min_range < max_range = {max_range:g}, got {min_range}", "sensor", "min_range")
    return {"min_range": min_range, "max_range": max_range}


def counting_section(exponent: float, single_scan_exponent: float | None, n_beams: int) -> dict[str, Any]:
    """Return how much beams count, with six digits; one scan on its own as much if None is given."""
    return {
        "exponent": six_digits(exponent),
        "single_scan_exponent": six_digits(exponent if single_scan_exponent is None else single_scan_exponent),
        "n_beams": int(n_beams),
    }


def _counting(file: YamlFile, section: str, values: dict[str, Any]) -> dict[str, Any]:
    """Return what a section says of how much beams count, checked, as keyword arguments of a saved model.

    exponent, n_beams and single_scan_exponent are taken out of the values, which are from `named_numbers`. FormatError
    names the line if an exponent is not in (0, 1] or n_beams is not a whole number >= 1.
    """
    counting = {name: values.pop(name) for name in COUNTING if name in values}
    for name, value in counting.items():
        if name == "n_beams":
            if value < 1 or value != int(value):
                raise file.error(f"expected a whole number >= 1, got {value:g}", section, name)
            counting[name] = int(value)
        elif not 0.0 < value <= 1.0:
            raise file.error(f"expected a number in (0, 1], got {value}", section, name)
    if "exponent" in counting:
        counting.setdefault("single_scan_exponent", counting["exponent"])
    return counting
