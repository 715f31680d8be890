"""Write a stack's parameter file anew, in the stack's own form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from beamfield.errors import InvalidInputError
from beamfield.stacks.parameter_file import check_stack
from beamfield.stacks.parameter_text import Value, value_text

# MRPT's name for the first occupancy grid of a map.
MRPT_SECTION = "MetricMap_occupancyGrid_00_likelihoodOpts"


def new_file_text(
    stack: str,
    values: Mapping[str, Value],
    *,
    comments: Sequence[str] = (),
    notes: Mapping[str, str] | None = None,
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
    notes
        A remark behind a value, by its name; left out in launch files.
    launch
        For ros1: lines for the node of a launch file instead of YAML.

    Raises
    ------
    InvalidInputError
        If the stack is unknown, or has no launch files.
    """
    check_stack(stack)
    if launch and stack != "ros1":
        raise InvalidInputError(f"launch: only ros1 has parameters in launch files, got {stack!r}")
    if launch:
        head = [f"<!-- {line.replace('--', '- -')} -->" for line in comments]
        lines = [f'<param name="{name}" value="{value_text(value, "launch")}"/>' for name, value in values.items()]
        return "\n".join([*head, *lines]) + "\n"
    mark, syntax = ("//", "ini") if stack == "mrpt" else ("#", "yaml")
    head = [f"{mark} {line}" for line in comments]
    above, indent = {
        "nav2": (["amcl:", "  ros__parameters:"], "    "), "beluga": (["amcl:", "  ros__parameters:"], "    "),
        "ros1": (["amcl:"], "  "), "mrpt": ([f"[{MRPT_SECTION}]"], ""), "f1tenth": ([], ""),
    }[stack]  # fmt: skip
    assign = " = " if stack == "mrpt" else ": "
    body = []
    for name, value in values.items():
        written = value_text(value, "ini") if syntax == "ini" else value_text(value, "yaml")
        note = (notes or {}).get(name, "")
        body.append(f"{indent}{name}{assign}{written}" + (f"  {mark} {note}" if note else ""))
    return "\n".join([*head, *above, *body]) + "\n"
