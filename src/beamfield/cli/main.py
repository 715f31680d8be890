"""The command ``beamfield``: finds the subcommand and turns known errors into one line and an exit code."""

from __future__ import annotations

import _thread
import argparse
import atexit
import gc
import importlib
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

from beamfield import __version__
from beamfield.cli import (
    calibrate,
    calibrate_landmarks,
    check,
    demo,
    doctor,
    evaluate,
    explore,
    figures,
    fleet,
    inspect,
    likelihood,
    localize,
    precompute,
    simulate,
    trajectory,
    translate,
)
from beamfield.cli import map as map_command
from beamfield.cli.compile_ahead import compile_ahead
from beamfield.cli.outcome import show, show_notes
from beamfield.cli.parser import Parser
from beamfield.cli.terminal import complain, silence
from beamfield.cli.wording import in_options
from beamfield.errors import BeamfieldError
from beamfield.kernels.threads import set_threads
from beamfield.localization.parallel_runs import parallel_runs

COMMANDS = (
    calibrate, calibrate_landmarks, check, doctor, evaluate, explore, translate, inspect, trajectory, map_command,
    precompute, simulate, likelihood, localize, figures, fleet, demo,
)  # fmt: skip
INTERNAL_ERROR, INTERRUPTED = 70, 130
# New objects between two searches for garbage, where Python's 700 or 2,000 cost a twelfth of a command's time: imports
# and Numba's compiler make millions of objects that stay.
OBJECTS_PER_COLLECTION = 50_000
INTERRUPT_AGAIN_S = 0.01


def build_parser() -> Parser:
    """Return the parser with all subcommands."""
    parser = Parser(
        prog="beamfield",
        description="See when and where a robot gets lost in its map, and calibrate its sensor and AMCL from a log.",
        epilog="Exit codes: 0 done; 1 bad input, or doctor found a problem; 2 wrong usage; 3 too little data, not "
        "converged, or a result not to be trusted; 70 an error in beamfield itself.",
    )
    parser.add_argument("--version", action="version", version=f"beamfield {__version__}")
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND", parser_class=Parser)
    for command in COMMANDS:
        command.add_parser(subparsers)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    The words come without the program's name; None takes them from the process. Only then runs of filters start others
    beside it, which would run a script of the caller's anew.
    """
    try:
        return _main(arguments)
    except KeyboardInterrupt:
        return _fail("interrupted", INTERRUPTED)


def _main(arguments: Sequence[str] | None) -> int:
    # Closed, as >&- does: files that are opened later would take its place.
    sys.stdout, sys.stderr = (stream or Path(os.devnull).open("w") for stream in (sys.stdout, sys.stderr))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        # A terminal that has no "±", or a file name that is no text, must not end a finished job with a traceback.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    is_ours = arguments is None
    if is_ours:
        # Its linear algebra is small: more threads of OpenBLAS would spin while they wait, a tenth of the CPU time.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        gc.set_threshold(OBJECTS_PER_COLLECTION, *gc.get_threshold()[1:])
        # Else Python would look through all modules for garbage before it ends, another twentieth.
        atexit.register(gc.freeze)
        sys.unraisablehook = _interrupt_again
        # As Ctrl-C, lest files stay behind that bags are unpacked into.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    parser = build_parser()
    if "_ARGCOMPLETE" in os.environ:  # the shell asks how a word goes on
        importlib.import_module("argcomplete").autocomplete(parser)
    try:
        parsed = parser.parse_args(sys.argv[1:] if is_ours else arguments)
    except SystemExit as end:
        return int(end.code or 0)
    threads = getattr(parsed, "threads", None)
    parsed.noticed = []
    code = INTERRUPTED
    try:
        limited = nullcontext() if threads is None else set_threads(threads)
        others = _other_processes(parsed) if is_ours else nullcontext()
        with _unpacking_limit(parsed), _kept_inputs(parsed), limited, others:
            outcome = parsed.run(parsed)
        code = int(outcome.code)
        show(outcome, parsed)
        sys.stdout.flush()
        return code
    except BeamfieldError as error:
        # What was assumed about the input is often why nothing came of it.
        show_notes(parsed.noticed, parsed)
        return _fail(str(error), error.exit_code)
    except BrokenPipeError:
        # The reader of our output (head, less) has gone; that is no error.
        silence(sys.stdout)
        return code
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        home = "; only the shell knows ~, and not after =: write $HOME" if str(error.filename).startswith("~") else ""
        return _fail(f"{where}{error.strerror or error}{home}", 1)
    except Exception as error:
        if parsed.verbose:
            traceback.print_exc()
        hint = "" if parsed.verbose else "; -v shows where"
        return _fail(f"internal error, please report it: {type(error).__name__}: {error}{hint}", INTERNAL_ERROR)


def _interrupt_again(unraisable: sys.UnraisableHookArgs) -> None:
    """Raise a Ctrl-C once more that came in a destructor, as the compiler has: Python would print it and go on."""
    if unraisable.exc_type is KeyboardInterrupt:
        # From outside, and later: what is raised in here is printed as well.
        threading.Timer(INTERRUPT_AGAIN_S, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(unraisable)


@contextmanager
def _other_processes(parsed: argparse.Namespace) -> Iterator[None]:
    with parallel_runs(), compile_ahead() if parsed.command in ("calibrate", "demo") else nullcontext():
        yield


def _kept_inputs(parsed: argparse.Namespace) -> AbstractContextManager[None]:
    from beamfield.cli.provenance import input_files
    from beamfield.io.files.atomic import kept_files

    return kept_files(input_files(parsed))


def _unpacking_limit(parsed: argparse.Namespace) -> AbstractContextManager[None]:
    gigabytes = getattr(parsed, "max_unpacked", None)
    if gigabytes is None:
        return nullcontext()
    from beamfield.io.bags.unpacking import max_unpacked

    return max_unpacked(gigabytes)


def _fail(message: str, code: int) -> int:
    complain(f"beamfield: error: {in_options(message)}")
    return code


if __name__ == "__main__":
    sys.exit(main())
