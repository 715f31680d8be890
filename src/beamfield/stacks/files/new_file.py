"""Write a stack's parameter file anew, in the stack's own form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from beamfield.errors import InvalidInputError
from beamfield.printable import printable
from beamfield.stacks.registry import STACKS, stack_named
from beamfield.stacks.syntax.parameter_text import Value, pair


def new_file_text(
    stack: str, values: Mapping[str, Value], *, comments: Sequence[str] = (), launch: bool = False
) -> str:
    """Return a parameter file with values by the stack's own names, below comments.

    What stands above the parameters is the stack's `Stack.layout`. f1tenth gets a flat file for ROS 1 (its names are
    the same below ``particle_filter: ros__parameters:``). `launch` makes a launch file with amcl's node instead of
    YAML. InvalidInputError if the stack is unknown, or has no launch files.
    """
    described = stack_named(stack)
    comments = [printable(line) for line in comments]  # a name must not begin a line of its own
    if launch and not described.in_launch_files:
        able = " and ".join(stack.name for stack in STACKS.values() if stack.in_launch_files)
        raise InvalidInputError(f"launch: only {able} has parameters in launch files, got {stack!r}")
    if launch:
        head = [f"<!-- {line.replace('--', '- -')} -->" for line in comments]
        lines = [f"    {pair(name, value, 'launch')}" for name, value in values.items()]
        node = '  <node pkg="amcl" type="amcl" name="amcl">'
        return "\n".join([*head, "<launch>", node, *lines, "  </node>", "</launch>"]) + "\n"
    mark, indent = ("//", "") if described.syntax == "ini" else ("#", "  " * len(described.layout))
    body = [indent + pair(name, value, described.syntax) for name, value in values.items()]
    return "\n".join([*(f"{mark} {line}" for line in comments), *described.layout, *body]) + "\n"
