"""Convert parameters of one stack into those of another.

Translate the measurement model in a parameter file of one stack, or beamfield's own beam_model.yaml, into the
parameters of another stack. Prints the new file, or writes it with --out, or changes the values in an existing file of
the other stack with --patch. Both formulas are computed and compared; what differs is said.

for example:

  beamfield translate nav2_params.yaml --to beluga --max-range 12
  beamfield translate result/beam_model.yaml --to nav2 --patch nav2_params.yaml
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield import __version__
from beamfield.cli import options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, count, positive
from beamfield.errors import InvalidInputError

if TYPE_CHECKING:
    from beamfield.stacks.files.parameter_file import StackFile
    from beamfield.stacks.translation.translation import Translation


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "translate", __doc__)
    parser.add_argument(
        "params", type=Path, metavar="PARAMS", help="YAML, ROS 1 launch file, MRPT ini, or beam_model.yaml"
    )
    parser.add_argument("--to", required=True, metavar="STACK",
                        help="nav2, ros1, beluga, mrpt, f1tenth, or chapter for beamfield's own models")  # fmt: skip
    parser.add_argument(
        "--to-model", metavar="NAME", help="the other stack's model (default: the one of the same kind)"
    )
    options.add_whose_files(parser, model=True)
    parser.add_argument("--max-range", type=positive, metavar="M", help="the sensor's longest range")
    parser.add_argument("--beams", type=count, metavar="N", help="beams in a scan, to convert decimations")
    parser.add_argument("--resolution", type=positive, metavar="M", help="side of the map's cells")
    parser.add_argument("--typical-range", type=positive, metavar="M",
                        help="of beam_model.yaml: root mean square of the ranges whose noise becomes sigma_hit "
                        "(default: 4, or 0.4 of the sensor's longest range)")  # fmt: skip
    options.add_out(parser, None, metavar="FILE", what="write a new file (.launch for a ROS 1 launch file)")
    parser.add_argument("--patch", type=Path, metavar="FILE", help="change the values in this file; keeps a backup")
    parser.add_argument("--patch-section", metavar="LABEL", help="which section of it, if several have such parameters")


def run(arguments: argparse.Namespace) -> Outcome:
    """Read, translate, write."""
    from beamfield.stacks.registry import STACKS
    from beamfield.stacks.translation.translation import CHAPTER, CHAPTER_WEIGHTS

    if arguments.out is not None and arguments.patch is not None:
        raise InvalidInputError("--out: writes a new file, --patch changes one; give only one of them")
    if arguments.patch_section is not None and arguments.patch is None:
        raise InvalidInputError("--patch-section: is a section of the file to --patch, but there is none")
    if arguments.to == CHAPTER:
        options.refuse(arguments, ("patch", "out"), "is for files of a stack, chapter has none")
    if arguments.to not in (*STACKS, CHAPTER):
        raise InvalidInputError(f"--to: expected one of {', '.join((*STACKS, CHAPTER))}, got {arguments.to!r}")
    models = CHAPTER_WEIGHTS if arguments.to == CHAPTER else STACKS[arguments.to].models
    if arguments.to_model is not None and arguments.to_model not in models:
        raise InvalidInputError(f"--to-model: {arguments.to} has {', '.join(models)}, got {arguments.to_model!r}")
    result, source, more = _translate(arguments)
    head = f"{result.stack} {result.model}, from {source} by beamfield {__version__}"
    said = [result.summary, *result.assumptions, *result.notes, *more]
    document = {"stack": result.stack, "model": result.model, "from": source, "values": dict(result.values)}
    if arguments.patch is not None:
        line, more = _patch(arguments, result)
        return Outcome(line, "", document, [*said, *more], [arguments.patch])
    if result.stack == CHAPTER:
        values = "\n".join(f"{name} = {value:.6g}" for name, value in result.values.items())
        return Outcome(values, "", document, said)
    text = _new_file(arguments.out, result, head, said)
    if arguments.out is not None:
        return Outcome(f"wrote {arguments.out}", "", document, said, [arguments.out])
    # What the head of the file says need not be twice on a screen.
    shown = arguments.json or (sys.stderr.isatty() and not sys.stdout.isatty())
    return Outcome(text.rstrip("\n"), "", {**document, "file": text}, said if shown else [])


def _translate(arguments: argparse.Namespace) -> tuple[Translation, str, list[str]]:
    """Return the translation, what it is from, and notes on that file."""
    from beamfield.stacks.files.other_files import own_model
    from beamfield.stacks.files.parameter_file import read_stack_file
    from beamfield.stacks.translation.translate import translate

    if own_model(arguments.params) == "beam_model":
        return _translate_beam_model(arguments)
    if arguments.typical_range is not None:
        raise InvalidInputError("--typical-range: is for beamfield's own beam_model.yaml")
    file = read_stack_file(arguments.params, stack=arguments.stack, model=arguments.model, section=arguments.section)
    result = translate(
        file, arguments.to, model=arguments.to_model, max_range=arguments.max_range, n_beams=arguments.beams,
        resolution=arguments.resolution,
    )  # fmt: skip
    return result, f"{file.stack} {file.model}", [file.uncertainty] if file.uncertainty else []


def _translate_beam_model(arguments: argparse.Namespace) -> tuple[Translation, str, list[str]]:
    from beamfield.stacks.translation.translate_beam_model import translate_beam_model

    names = ("stack", "model", "section", "max_range", "beams")
    options.refuse(arguments, names, f"is for files of a stack, {arguments.params} is beamfield's own")
    model, more = arguments.to_model, []
    if model is None and arguments.patch is not None:
        model = _patched_file(arguments, None).model
        more = [f"{model} was chosen, because {arguments.patch} chooses it"]
    result = translate_beam_model(
        arguments.params, arguments.to, model=model, typical_range=arguments.typical_range,
        resolution=arguments.resolution,
    )  # fmt: skip
    return result, "beamfield's beam model", more


def _patched_file(arguments: argparse.Namespace, model: str | None) -> StackFile:
    from beamfield.stacks.files.parameter_file import check_patch_target, read_stack_file

    target = read_stack_file(arguments.patch, stack=arguments.to, model=model, section=arguments.patch_section)
    check_patch_target(target)
    return target


def _patch(arguments: argparse.Namespace, result: Translation) -> tuple[str, list[str]]:
    """Change the user's file; return a line that says so, and notes."""
    from beamfield.stacks.files.parameter_file import write_values

    target = _patched_file(arguments, result.model)
    ran = _patched_file(arguments, None).model
    values = target.by_names_in_file(result.values)
    backup = write_values(target.section, values)
    notes = [f"the file chose {ran} before, now {result.model}"] if ran != result.model else []
    if arguments_replaced := target.section.arguments_replaced_by(values):
        notes.append(arguments_replaced)
    return f"changed {arguments.patch}, the old file is {backup.name}", notes


def _new_file(path: Path | None, result: Translation, head: str, said: list[str]) -> str:
    """Return the text of the new file, which is written if it has a name."""
    from beamfield.io.files.atomic import write_file
    from beamfield.stacks.files.new_file import new_file_text

    if path is not None:
        _check_suffix(path, result.stack)
    launch = path is not None and path.suffix in (".launch", ".xml")
    text = new_file_text(result.stack, result.values, comments=[head, *said], launch=launch)
    if path is not None:
        write_file(path, text)
    return text


def _check_suffix(path: Path, stack: str) -> None:
    """Say if a file of this name would not be read as the stack's."""
    from beamfield.stacks.registry import stack_named

    described = stack_named(stack)
    launch = path.suffix in (".launch", ".xml")
    ini = path.suffix in (".ini", ".cfg")
    if ini is not (described.syntax == "ini") or (launch and not described.in_launch_files):
        expected = ".ini" if described.syntax == "ini" else ".yaml or .launch" if described.in_launch_files else ".yaml"
        raise InvalidInputError(f"--out: files of {stack} end in {expected}, got {path.name!r}")
