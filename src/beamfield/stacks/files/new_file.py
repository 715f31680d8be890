"""Write a stack's parameter file anew, in the stack's own form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from beamfield.errors import InvalidInputError
from beamfield.printable import printable
from beamfield.stacks.files.parameter_file import check_stack
from beamfield.stacks.files.parameter_text import Value, value_text

# MRPT's name for the first occupancy grid of a map.
MRPT_SECTION = "MetricMap_occupancyGrid_00_likelihoodOpts"
# The lines above the parameters, each one level deeper.
YAML_SECTIONS: Mapping[str, tuple[str, ...]] = {
    "nav2": ("amcl:", "  ros__parameters:"),
    "beluga": ("amcl:", "  ros__parameters:"),
    "ros1": ("amcl:",),
    "f1tenth": (),
}


def new_file_text(
    stack: str,
    values: Mapping[str, Value],
    *,
    comments: Sequence[str] = (),
    launch: bool = False,
) -> str:
    """Return a parameter file.

    Parameters
    ----------
    stack
        nav2 and beluga get ``amcl: ros__parameters:``, ros1 ``amcl:``, mrpt an ini section, f1tenth a flat file for
        ROS 1 (its names are the same below ``particle_filter: ros__parameters:``).
    values
        By the stack's own names.
    comments
        Lines at the top.
    launch
        For ros1: lines for the node of a launch file instead of YAML.

    Raises
    ------
    InvalidInputError
        If the stack is unknown, or has no launch files.
    """
    check_stack(stack)
    comments = [printable(line) for line in comments]  # a name must not begin a line of its own
    if launch and stack != "ros1":
        raise InvalidInputError(f"launch: only ros1 has parameters in launch files, got {stack!r}")
    if launch:
        head = [f"<!-- {line.replace('--', '- -')} -->" for line in comments]
        lines = [f'<param name="{name}" value="{value_text(value, "launch")}"/>' for name, value in values.items()]
        return "\n".join([*head, *lines]) + "\n"
    if stack == "mrpt":
        head = [*(f"// {line}" for line in comments), f"[{MRPT_SECTION}]"]
        body = [f"{name} = {value_text(value, 'ini')}" for name, value in values.items()]
    else:
        head, indent = [*(f"# {line}" for line in comments), *YAML_SECTIONS[stack]], "  " * len(YAML_SECTIONS[stack])
        body = [f"{indent}{name}: {value_text(value, 'yaml')}" for name, value in values.items()]
    return "\n".join([*head, *body]) + "\n"
