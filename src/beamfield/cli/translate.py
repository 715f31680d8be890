"""``beamfield translate``: the parameters of one stack in the meaning of another."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from beamfield import __version__
from beamfield.cli.doctor import add_file_options

DESCRIPTION = """
Translate the measurement model in a parameter file of one stack into the parameters that give another stack the same
relative weights, exactly where that is possible. Prints the new file, or writes it with --out, or changes the values in
an existing file of the other stack with --patch. What differs all the same is said.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser(
        "translate", help="parameters of one stack in the meaning of another", description=DESCRIPTION
    )
    parser.add_argument("params", type=Path, metavar="PARAMS", help="YAML, ROS 1 launch file or MRPT ini")
    parser.add_argument("--to", required=True, metavar="STACK",
                        help="nav2, ros1, beluga, mrpt, f1tenth, or chapter for beamfield's own field")  # fmt: skip
    parser.add_argument(
        "--to-model", metavar="NAME", help="the other stack's model (default: the one of the same kind)"
    )
    add_file_options(parser)
    parser.add_argument("--max-range", type=float, metavar="M", help="the sensor's longest range, metres")
    parser.add_argument("--beams", type=int, metavar="N", help="beams in a scan, to convert decimations")
    target = parser.add_mutually_exclusive_group()
    target.add_argument("--out", type=Path, metavar="FILE", help="write a new file (.launch for ROS 1 launch lines)")
    target.add_argument("--patch", type=Path, metavar="FILE", help="change the values in this file; keeps a backup")
    parser.add_argument("--patch-section", metavar="LABEL", help="which section of it, if several have such parameters")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Read, translate, write."""
    from beamfield.errors import InvalidInputError
    from beamfield.io.atomic import write_file
    from beamfield.stacks.new_file import new_file_text
    from beamfield.stacks.parameter_file import check_patch_target, read_stack_file, write_values
    from beamfield.stacks.translate import CHAPTER, translate

    if arguments.patch_section is not None and arguments.patch is None:
        raise InvalidInputError("--patch-section: is a section of the file to --patch, but there is none")
    file = read_stack_file(arguments.params, stack=arguments.stack, model=arguments.model, section=arguments.section)
    result = translate(
        file, arguments.to, model=arguments.to_model, max_range=arguments.max_range, n_beams=arguments.beams
    )
    notes = list(result.notes)
    if not file.stack_is_certain:
        notes.append(f"read as {file.stack}'s file; say --stack beluga if it is Beluga's")
    head = f"{result.stack} {result.model}, from {file.stack} {file.model} by beamfield {__version__}"
    how = "the same relative weights" if result.exact else "not exactly the same weights"
    said = [how, *notes]
    if arguments.patch is not None:
        if result.stack == CHAPTER:
            raise InvalidInputError("--patch: is for files of a stack, chapter has none")
        target = read_stack_file(
            arguments.patch, stack=result.stack, model=result.model, section=arguments.patch_section
        )
        check_patch_target(target)
        backup = write_values(target.section, result.values)
        print(f"changed {arguments.patch}, the old file is {backup.name}")
    elif result.stack == CHAPTER:
        if arguments.out is not None:
            raise InvalidInputError("--out: is for files of a stack, chapter has none")
        print("\n".join(f"{name} = {value:.6g}" for name, value in result.values.items()))
    else:
        launch = arguments.out is not None and arguments.out.suffix in (".launch", ".xml")
        if arguments.out is not None:
            _check_suffix(arguments.out, result.stack)
        text = new_file_text(result.stack, result.values, comments=[head, how, *result.notes], launch=launch)
        if arguments.out is None:
            print(text, end="")
            if sys.stdout.isatty():  # its head says the rest: not twice on one screen
                said = notes[len(result.notes) :]
        else:
            write_file(arguments.out, text)
            print(f"wrote {arguments.out}")
    for note in said:
        print(f"note: {note}", file=sys.stderr)
    return 0


def _check_suffix(path: Path, stack: str) -> None:
    """Say if a file of this name would not be read as the stack's."""
    from beamfield.errors import InvalidInputError

    ini = path.suffix in (".ini", ".cfg")
    if ini is not (stack == "mrpt") or (path.suffix in (".launch", ".xml") and stack != "ros1"):
        expected = {"mrpt": ".ini", "ros1": ".yaml or .launch"}.get(stack, ".yaml")
        raise InvalidInputError(f"--out: files of {stack} end in {expected}, got {path.name!r}")
