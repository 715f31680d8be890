"""``beamfield figures``: the chapter's figures, from simulated data or from a log and a map of one's own."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli.calibrate import add_log_options, log_options
from beamfield.cli.formats import LOG_FORMATS, MAP_FORMATS
from beamfield.cli.progress import StageProgress
from beamfield.cli.provenance import file_name
from beamfield.cli.terminal import complain, say
from beamfield.errors import InvalidInputError, TooLittleDataError

if TYPE_CHECKING:
    from beamfield.figures.gallery import ChapterFigure
    from beamfield.figures.world import FigureWorld

DESCRIPTION = """
Draw the figures of the chapter on measurement models (6.1 to 6.13) from a simulated office, or from your own log and
map, and write them with their captions (gallery.md) into a folder, all at once. A figure that your log is too short for
or that does not go with it is left out, with the reason; the exit code is 3 then.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser("figures", help="draw the chapter's figures", description=DESCRIPTION)
    parser.add_argument("log", type=Path, nargs="?", metavar="LOG", help=f"{LOG_FORMATS} (default: simulate one)")
    parser.add_argument("--map", type=Path, metavar="MAP", help=f"the log's map: {MAP_FORMATS}")
    parser.add_argument("--poses", type=Path, metavar="FILE", help="reference poses: TUM or CSV file")
    parser.add_argument("--scan", type=int, metavar="I", help="index of the scan to show (default: chosen)")
    parser.add_argument("--only", nargs="+", metavar="N", help="draw only these figures, for example 6.7 6.10")
    parser.add_argument("--list", action="store_true", help="say which figures there are")
    parser.add_argument("--out", type=Path, default=Path("beamfield_figures"), metavar="DIR",
                        help="output folder (default: %(default)s)")  # fmt: skip
    parser.add_argument("--format", choices=("svg", "png", "pdf"), default="svg", help="of the pictures (default: svg)")
    parser.add_argument("--seed", type=int, default=1, help="of the simulated office (default: 1)")
    add_log_options(parser, several=True)
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Read or simulate, draw, write, print the captions."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.figures.gallery import chosen_figures, gallery_page, save_figure
    from beamfield.io.files.atomic import atomic_folder

    figures = chosen_figures(arguments.only)
    if arguments.list:
        say("\n".join(f"{figure.number:<5} {figure.title}" for figure in figures))
        return 0
    _check(arguments)
    drawn: list[ChapterFigure] = []
    missing: dict[ChapterFigure, InvalidInputError | TooLittleDataError] = {}
    with StageProgress(quiet=arguments.quiet) as progress, atomic_folder(arguments.out) as folder:
        world = _world(arguments, progress)
        source = world.name if arguments.log is None else file_name(arguments.log)
        for number, figure in enumerate(figures, 1):
            progress(f"drawing {figure.name} ({number} of {len(figures)})", 0, 1)
            try:
                picture = figure.draw(world)
            except (InvalidInputError, TooLittleDataError) as error:
                missing[figure] = error
                continue
            save_figure(picture, folder / f"{figure.stem}.{arguments.format}")
            drawn.append(figure)
        if not drawn:
            figure, why = next(iter(missing.items()))
            raise type(why)(f"{figure.name}: {why}") from why
        reasons = {figure: str(why) for figure, why in missing.items()}
        page = gallery_page(drawn, source, suffix=arguments.format, missing=reasons)
        (folder / "gallery.md").write_text(page, encoding="utf-8")
    for figure in drawn:
        say(f"{figure.name}: {figure.title}. {figure.caption}")
    count = "1 figure" if len(drawn) == 1 else f"{len(drawn)} figures"
    say(f"\nwrote {count} and gallery.md into {arguments.out}, drawn from: {source}")
    for reason in dict.fromkeys(reasons.values()):
        names = [figure.name for figure in reasons if reasons[figure] == reason]
        complain(f"beamfield: warning: not drawn: {', '.join(names)}: {reason}")
    return 3 if missing else 0


def _check(arguments: argparse.Namespace) -> None:
    if (arguments.log is None) != (arguments.map is None):
        raise InvalidInputError("LOG and --map: expected both, or neither for simulated data")
    if arguments.log is None and (arguments.poses is not None or arguments.scan is not None):
        raise InvalidInputError("--poses and --scan: go with a LOG of your own")
    if arguments.seed < 0:
        raise InvalidInputError(f"--seed: expected a number >= 0, got {arguments.seed}")


def _world(arguments: argparse.Namespace, progress: StageProgress) -> FigureWorld:
    from beamfield.figures.world import simulated_world, world_of_log
    from beamfield.io.read_log import read_log
    from beamfield.io.read_map import read_map
    from beamfield.io.trajectory import attach_poses, read_trajectory

    if arguments.log is None:
        progress("simulating", 0, 1)
        return simulated_world(arguments.seed)
    progress("reading", 0, 1)
    grid = read_map(arguments.map)
    log = read_log(arguments.log, **log_options(arguments))
    if arguments.poses is not None:
        log = attach_poses(log, read_trajectory(arguments.poses))
    # The first sensor that is asked for is shown, the others are drawn beside it.
    shown = arguments.sensor[0] if arguments.sensor else None
    return world_of_log(log, grid, sensor=shown, index=arguments.scan)
