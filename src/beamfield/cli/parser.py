"""The parser of every command: what went wrong first, on one line, with what was probably meant."""

from __future__ import annotations

import argparse
import difflib
import math
import re
from collections.abc import Callable, Iterable, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any, TypeVar

from beamfield.cli.outcome import Outcome
from beamfield.cli.terminal import complain
from beamfield.printable import printable

_T = TypeVar("_T", int, float)
ADDRESS = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]+://")
UNITS = "M stands for metres, S for seconds, DEG for degrees, HZ for 1/s."
# What argparse says in the words of a programmer.
_PLAIN = {
    "the following arguments are required:": "missing:",
    "unrecognized arguments:": "not understood:",
    "invalid float value:": "expected a number, got",
    "invalid int value:": "expected a whole number, got",
}


class Parser(argparse.ArgumentParser):
    """A parser that fails on one line and says what was probably meant."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=_Help, allow_abbrev=False, **options)
        # From 3.14 on, Python colours help by escape codes, of which `_print_message` makes text.
        self.color = False
        # As of 3.14: 3.13 takes what is meant as the value of an option, -5:5 or -1e-3, for another option.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Refuse an option that does not exist before one that it was meant for is called missing."""
        words = list(args or ())
        own = list(takewhile(lambda word: word != "--", words))
        if self._subparsers is not None:
            own = list(takewhile(lambda word: word.startswith("-"), words))
        for word in own:
            name = word.partition("=")[0]
            if self._subparsers is not None and name not in self._option_string_actions and _has_option(self, name):
                self.error(f"{name}: options go after the command")
            # As argparse has it, a word with a space is no option.
            if name.startswith("--") and " " not in word and name not in self._option_string_actions:
                self.error(f"no option {name}{_meant(name, self._option_string_actions)}")
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> Any:
        """Print what is wrong and where help is, and exit with code 2."""
        for technical, plain in _PLAIN.items():
            message = message.replace(technical, plain)
        end = "" if message.endswith("?") else "."
        complain(f"beamfield: error: {message.removeprefix('argument ')}{end} See {self.prog} --help")
        raise SystemExit(2)

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        value = super()._get_value(action, arg_string)
        # A path of no name is the folder that the shell is in: a variable that is not set would fill it with results.
        if isinstance(value, Path) and not arg_string:
            raise argparse.ArgumentError(action, "expected a name, got ''")
        # As a path, s3://b/x is in a folder "s3:" here: results would be written there and seem to be in the store.
        if isinstance(value, Path) and ADDRESS.match(arg_string):
            from beamfield.fleet.folder import without_secrets

            got = without_secrets(arg_string)
            raise argparse.ArgumentError(action, f"expected a path on this machine, got the address {got!r}")
        return value

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        if isinstance(action, argparse._SubParsersAction):
            raise argparse.ArgumentError(None, f"no command {value!r}{_meant(value, action.choices)}")
        known = ", ".join(map(str, action.choices))
        raise argparse.ArgumentError(action, f"expected one of {known}, got {value!r}{_meant(value, action.choices)}")

    def _print_message(self, message: str, file: Any = None) -> None:
        super()._print_message(printable(message, keep="\n"), file)


class _Help(argparse.HelpFormatter):
    """Breaks the lines of descriptions, but leaves indented paragraphs, which are examples, as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        parts = text.strip("\n").split("\n\n")
        return "\n\n".join(p if p.startswith("  ") else super(_Help, self)._fill_text(p, width, indent) for p in parts)


def add_command(
    commands: argparse._SubParsersAction[Parser],
    run: Callable[[argparse.Namespace], Outcome],
    name: str,
    text: str | None,
) -> argparse.ArgumentParser:
    """Return the parser of a new command, with the options that all commands have.

    The text is the help, the docstring of the command's module: one line for the list of commands, what it does, and
    examples, which stand below the options.
    """
    parser = _add_parser(commands, name, text)
    parser.add_argument("-q", "--quiet", action="store_true", help="print only errors and the result on one line")
    parser.add_argument("-v", "--verbose", action="store_true",
                        help="number the steps and time them; show where an internal error arose")  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print the result as JSON (metres, radians, seconds)")
    parser.set_defaults(run=run, command=name)
    return parser


def add_group(
    commands: argparse._SubParsersAction[Parser], name: str, text: str | None
) -> argparse._SubParsersAction[Parser]:
    """Return where to add the commands of a group, which are typed after its name."""
    parser = _add_parser(commands, name, text)
    return parser.add_subparsers(title="commands", required=True, metavar="COMMAND", parser_class=Parser)


def _add_parser(commands: argparse._SubParsersAction[Parser], name: str, text: str | None) -> Parser:
    summary, _, rest = (text or "x").partition("\n\n")
    about, head, examples = rest.partition("for example:")
    summary = summary[0].lower() + summary[1:].rstrip(".")
    return commands.add_parser(name, help=summary, description=about, epilog=f"{head}{examples}\n{UNITS}")


def finite(text: str) -> float:
    """Read a finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a finite number, got {text!r}")
    return value


def positive(text: str) -> float:
    """Read a finite number above 0."""
    return _number(text, float, lambda value: 0.0 < value < math.inf, "a number > 0")


def rate(text: str) -> float:
    """Read a number above 0, or a fraction of two, as 1/600."""
    whole, slash, part = text.partition("/")
    try:
        return positive(whole) / positive(part) if slash else positive(whole)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"expected a number > 0 or a fraction such as 1/600, got {text!r}") from None


def not_negative(text: str) -> float:
    """Read a finite number from 0 on."""
    return _number(text, float, lambda value: 0.0 <= value < math.inf, "a number >= 0")


def count(text: str) -> int:
    """Read a whole number from 1 on."""
    return _number(text, int, lambda value: value >= 1, "a whole number >= 1")


def index(text: str) -> int:
    """Read a whole number from 0 on."""
    return _number(text, int, lambda value: value >= 0, "a whole number >= 0")


def _number(text: str, kind: Callable[[str], _T], holds: Callable[[_T], bool], expected: str) -> _T:
    try:
        value = kind(text)
    except ValueError:
        value = kind("-1")
    if not holds(value):
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")
    return value


def _has_option(parser: argparse.ArgumentParser, name: str) -> bool:
    """Return whether a command of a parser, or of its groups, has an option."""
    commands = [action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return any(
        name in command._option_string_actions or _has_option(command, name)
        for choices in commands
        for command in choices.values()
    )


def _meant(word: str, known: Iterable[Any]) -> str:
    close = difflib.get_close_matches(word, [str(name) for name in known], n=1)
    return f"; did you mean {close[0]}?" if close else ""
