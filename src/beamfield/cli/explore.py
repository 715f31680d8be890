"""Explore a log in its map in the browser: move the robot, and see what each model says of the scan there.

Serves one page on the loopback address, for this user only, until Ctrl-C: the map, the scan at its pose with the cause
of each reading, expected ranges, the scores of every model while the robot is dragged, heat maps of p(z | x, m),
sliders for the parameters with the density of any beam, two models side by side, a filter's run with its particles, and
a timeline of how well scans fit. Nothing is written; the page offers changed parameter files for download.

for example:

  beamfield explore run.bag --map map.yaml
  beamfield explore run.bag --map map.yaml --params nav2_params.yaml beamfield_calibration/nav2.yaml
  beamfield explore run.bag --map map.yaml --run beamfield_localization
"""

from __future__ import annotations

import argparse
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli import inputs, options
from beamfield.cli.fitted_poses import posed_log
from beamfield.cli.outcome import Outcome, show_notes
from beamfield.cli.parser import Parser, add_command, index
from beamfield.cli.progress import StageProgress
from beamfield.cli.terminal import complain
from beamfield.errors import BeamfieldError, FormatError, InvalidInputError, TooLittleDataError, needs

if TYPE_CHECKING:
    from beamfield.explorer.session import Session
    from beamfield.localization.fitted_poses import FittedPoses
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog

BY_HAND = "without poses nothing is learned from the log: drag the robot to where it was"


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "explore", __doc__)
    parser.add_argument("log", type=Path, metavar="LOG", help=options.LOG_FORMATS)
    options.add_map(parser, required=True)
    options.add_poses(parser, fitted=True)
    parser.add_argument("--params", type=Path, nargs="+", default=[], metavar="FILE",
                        help="parameter files to compare: beam_model.yaml, likelihood_field.yaml, or of nav2, ROS 1 "
                        "amcl, Beluga, MRPT, F1TENTH")  # fmt: skip
    parser.add_argument("--run", type=Path, metavar="DIR", dest="shown_run",
                        help="a filter's run to show: what localize wrote, or any program's trajectory")  # fmt: skip
    parser.add_argument("--no-fit", action="store_true",
                        help="start at once: fit no poses, learn nothing from the log, and judge no scans")  # fmt: skip
    parser.add_argument("--port", type=index, default=0, metavar="N", help="port to serve on (default: any free one)")
    parser.add_argument("--no-browser", action="store_true", help="only print the address, open nothing")
    options.add_whose_files(parser)
    options.add_log(parser)
    options.add_threads(parser)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read, learn, serve until Ctrl-C."""
    with needs("uvicorn", "explore", "the explorer"):
        import uvicorn
    from beamfield.explorer.server import explorer_app, listening_socket, new_token, page_address

    if arguments.port > 65535:
        raise InvalidInputError(f"--port: expected at most 65535, got {arguments.port}")
    # Before the log is learned from, which takes minutes: a port that is in use is refused at once, and kept.
    try:
        listening = listening_socket(arguments.port)
    except OSError as error:
        raise BeamfieldError(f"--port {arguments.port}: {error.strerror}; without it any free port is taken") from error
    with listening:
        session, notes = _session(arguments)
        show_notes(notes, arguments)
        token = new_token()
        port = listening.getsockname()[1]
        address = page_address(port, token)
        # At once, not with the result: there is none before the end.
        complain(f"serving {address} (Ctrl-C ends it)")
        if not arguments.no_browser:
            webbrowser.open(address)
        app = explorer_app(session, token, port)
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning", lifespan="off"))
        with suppress(KeyboardInterrupt):
            server.run(sockets=[listening])
    # The notes were shown at the start.
    return Outcome("the explorer has ended", document={"notes": list(notes), "address": address})


def _session(arguments: argparse.Namespace) -> tuple[Session, tuple[str, ...]]:
    """Read and learn; return what is served, and notes."""
    from beamfield.explorer.open_session import open_session
    from beamfield.explorer.parameter_set import read_set
    from beamfield.explorer.shown_run import own_poses_as_run, read_shown_run
    from beamfield.stacks.files.other_files import own_model

    with options.progress(arguments) as progress:
        grid, sensor, notes = inputs.read_map_and_sensor(arguments, progress)
        # Before poses are fitted, which takes long: a bad file is refused at once.
        if all(own_model(path) for path in arguments.params):
            options.refuse(arguments, ("stack", "section"), "is for files of other programs, give one with --params")
        sets = [read_set(path, grid, sensor.finder, arguments.stack, arguments.section) for path in arguments.params]
        shown = None if arguments.shown_run is None else read_shown_run(arguments.shown_run, sensor, grid)
        log, fitted, more = _posed(sensor, grid, arguments, progress)
        if shown is None and fitted is not None and fitted.instead_of is not None:
            shown = own_poses_as_run(sensor, grid, fitted.instead_of)
        session, why = open_session(
            log, grid, sets, run=shown, fit=not arguments.no_fit and log.has_poses, progress=progress
        )
    return session, (*notes, *more, *([f"nothing was learned from the log: {why}"] if why else []))


def _posed(
    sensor: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace, progress: StageProgress
) -> tuple[SensorLog, FittedPoses | None, tuple[str, ...]]:
    """Return the log with poses if it has or gets some, what was fitted, and notes: without, drag the robot."""
    if arguments.no_fit and arguments.start is None and not sensor.has_poses:
        return sensor, None, (BY_HAND,)
    try:
        # Like poses from a named file, the log's own are only judged: none are fitted in their place.
        kept = arguments.log if arguments.no_fit and sensor.has_poses else arguments.poses
        start = options.start_of(arguments)
        log, fitted, found = posed_log(sensor, grid, arguments, progress, arguments.log, kept, start)
    except (FormatError, TooLittleDataError) as error:
        if sensor.has_poses:
            raise
        return sensor, None, (f"{error}; {BY_HAND}",)
    return log, fitted, tuple(finding.full_text for finding in found)
