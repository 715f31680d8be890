"""Find the parameters of MRPT's particle filter in its files, which hold them apart from the measurement model's."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, replace

from beamfield.io.files.yaml_file import read_yaml
from beamfield.stacks.mrpt.filter import ALGORITHM, MrptFilterParameters
from beamfield.stacks.mrpt.motion import MrptMotion
from beamfield.stacks.mrpt.resampling import METHODS
from beamfield.stacks.syntax.ini_sections import ini_sections
from beamfield.stacks.syntax.parameter_text import Entry, ParameterSection, Signs, Value
from beamfield.stacks.syntax.yaml_sections import yaml_sections

NAMES = frozenset(item.name for kind in (MrptFilterParameters, MrptMotion) for item in fields(kind))
INI_SECTIONS = ("KLD_options", "PF_options", "LocalizationExperiment")
# Beside the section of the measurement model; what comes later holds.
YAML_SECTIONS = ("", "kld_options", "pf_options", "motion_model_2d", "motion_model_no_odom_2d")
ALGORITHMS = (ALGORITHM, "pfAuxiliaryPFStandard", "pfOptimalProposal", "pfAuxiliaryPFOptimal")
# Times per second that mrpt_pf_localization updates if its file does not say.
USUAL_RATE = 2.0


def filter_section(sensor: ParameterSection) -> ParameterSection:
    """Return the parameters of the filter and the motion model as one section, in the units of their dataclasses.

    Parameters
    ----------
    sensor
        The section of the measurement model: of an ini file, or of a YAML file of mrpt_pf_localization.

    Notes
    -----
    mrpt_pf_localization 2.1.1 looks for a1 ... and alfa1_rot_rot ... under motion_model_2d itself, and not under
    gaussianModel and thrunModel, where its own file has them: those change nothing, neither there nor here. What stands
    under motion_model_no_odom_2d overwrites motion_model_2d.

    References
    ----------
    mrpt_pf_localization_core.cpp: Parameters::load_from; CParticleFilter.cpp and TKLDParams.cpp: loadFromConfigFile.
    """
    if sensor.syntax == "ini":
        found = {section.label: section.entries for section in ini_sections(sensor.path, NAMES)}
        return replace(sensor, entries=_converted(found, INI_SECTIONS, _FROM_INI))
    root = sensor.label.rpartition(".")[0]
    sections = yaml_sections(read_yaml(sensor.path, number_keys=True, last_counts=True), Signs(NAMES, (), ()))
    beside = [section for section in sections if section.label.startswith(root)]
    found = {section.label.removeprefix(root).removeprefix("."): section.entries for section in beside}
    entries = _converted(found, YAML_SECTIONS, {})
    rate = Entry("rate_hz", USUAL_RATE, sensor.line, 0, 0)
    return replace(sensor, entries={"rate_hz": rate, **entries})


def _converted(
    found: Mapping[str, Mapping[str, Entry]],
    labels: tuple[str, ...],
    converters: Mapping[str, Callable[[Value], Value]],
) -> dict[str, Entry]:
    entries = {name: entry for label in labels for name, entry in found.get(label, {}).items() if name in NAMES}
    for name, convert in converters.items():
        if name in entries and (value := entries[name].value) is not None:
            entries[name] = replace(entries[name], value=convert(value))
    return entries


def _radians(value: Value) -> Value:
    return value if isinstance(value, (bool, str)) else math.radians(value)


def _first(value: Value) -> Value:
    """Return the first of the counts that pf-localization runs one after the other."""
    words = value.split() if isinstance(value, str) else []
    return int(words[0]) if words and words[0].isdecimal() else value


def _name_in(names: tuple[str, ...]) -> Callable[[Value], Value]:
    def convert(value: Value) -> Value:
        is_number = isinstance(value, int) and not isinstance(value, bool) and 0 <= value < len(names)
        return names[int(value)] if is_number else value

    return convert


_FROM_INI: Mapping[str, Callable[[Value], Value]] = {
    "KLD_binSize_PHI": _radians, "particles_count": _first, "PF_algorithm": _name_in(ALGORITHMS),
    "resamplingMethod": _name_in(METHODS),
}  # fmt: skip
