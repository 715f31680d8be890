"""The command ``beamfield``: finds the subcommand and turns known errors into one line and an exit code."""

from __future__ import annotations

import argparse
import io
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext

from beamfield import __version__
from beamfield.cli import (
    calibrate,
    calibrate_landmarks,
    demo,
    doctor,
    figures,
    fit,
    inspect,
    likelihood,
    simulate,
    translate,
)
from beamfield.cli import map as map_command
from beamfield.cli.terminal import Parser, complain
from beamfield.cli.wording import in_options
from beamfield.errors import BeamfieldError, BeamfieldWarning
from beamfield.kernels.threads import set_threads

COMMANDS = (
    calibrate,
    calibrate_landmarks,
    fit,
    doctor,
    translate,
    inspect,
    map_command,
    simulate,
    likelihood,
    figures,
    demo,
)

UNITS = "In the names of values M stands for metres, S for seconds, DEG for degrees, RAD for radians, HZ for 1/s."


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with all subcommands."""
    parser = Parser(
        prog="beamfield",
        description="Measurement models of probabilistic robotics: calibrate a range sensor from a log and a map.",
        epilog="Exit codes: 0 done; 1 a known error, on one line; 2 wrong usage; 3 not converged or too little data.",
    )
    parser.add_argument("--version", action="version", version=f"beamfield {__version__}")
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add_parser(subparsers)
    for subparser in subparsers.choices.values():
        subparser.epilog = UNITS
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments
        Words of the command line without the program's name; None takes them from the process.
    """
    for stream in (sys.stdout, sys.stderr):
        # A terminal that has no "±", or a file name that is no text, must not end a finished job with a traceback.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    parser = build_parser()
    parsed = parser.parse_args(arguments)
    threads = getattr(parsed, "threads", None)
    if threads is not None and threads < 1:
        parser.error(f"argument --threads: expected at least 1, got {threads}")
    try:
        with warnings.catch_warnings(), set_threads(threads) if threads is not None else nullcontext():
            warnings.simplefilter("default", BeamfieldWarning)
            warnings.showwarning = _show_warning
            with _unpacking_limit(parsed):
                code = int(parsed.run(parsed))
            sys.stdout.flush()
            return code
    except BeamfieldError as error:
        return _fail(str(error), error.exit_code)
    except BrokenPipeError:
        # The reader of our output (head, less) has gone; that is no error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}", 1)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)


def _unpacking_limit(parsed: argparse.Namespace) -> AbstractContextManager[None]:
    gigabytes = getattr(parsed, "max_unpacked", None)
    if gigabytes is None:
        return nullcontext()
    from beamfield.io.bags.unpacking import max_unpacked

    return max_unpacked(gigabytes)


def _fail(message: str, code: int) -> int:
    complain(f"beamfield: error: {in_options(message)}")
    return code


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning without the place in the code, which says nothing to a user."""
    complain(f"beamfield: warning: {in_options(str(message))}")


if __name__ == "__main__":
    sys.exit(main())
