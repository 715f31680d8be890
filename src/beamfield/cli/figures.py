"""Draw the figures of the chapter.

Draw the figures of the chapter on measurement models (6.1 to 6.13) from a simulated office, or from your own log and
map, and write them with their captions (gallery.md) into a folder, all at once. A figure that your log is too short for
or that does not go with it is left out, with the reason; the exit code is 3 then.

for example:

  beamfield figures --only 6.7 6.10
  beamfield figures run.bag --map map.yaml --scan 200 --out figures
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli import inputs, options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, index
from beamfield.cli.progress import StageProgress
from beamfield.cli.provenance import file_name
from beamfield.errors import FormatError, InvalidInputError, TooLittleDataError, about_file

if TYPE_CHECKING:
    from beamfield.figures.gallery import ChapterFigure
    from beamfield.figures.world import FigureWorld


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "figures", __doc__)
    formats = f"{options.LOG_FORMATS} (default: simulate one)"
    parser.add_argument("log", type=Path, nargs="?", metavar="LOG", help=formats)
    options.add_map(parser, what="the log's map")
    options.add_poses(parser)
    parser.add_argument("--scan", type=index, metavar="I", help="index of the scan to show (default: chosen)")
    parser.add_argument("--only", nargs="+", metavar="N", help="draw only these figures, for example 6.7 6.10")
    parser.add_argument("--list", action="store_true", help="list the figures")
    options.add_out(parser, "beamfield_figures", metavar="DIR", what="output folder")
    parser.add_argument("--format", choices=("svg", "png", "pdf"), default="svg", help="of the pictures (default: svg)")
    options.add_seed(parser, 1)
    options.add_log(parser, several=True)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read or simulate, draw, write."""
    from beamfield.figures.gallery import chosen_figures, gallery_page, save_figure
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable

    figures = chosen_figures(arguments.only)
    if arguments.list:
        listed = "\n".join(f"{figure.number:<5} {figure.title}" for figure in figures)
        return Outcome(listed, document={"figures": [_as_dict(figure) for figure in figures]})
    _check(arguments)
    check_folder_writable(arguments.out)
    drawn: list[ChapterFigure] = []
    missing: dict[ChapterFigure, InvalidInputError | TooLittleDataError] = {}
    with options.progress(arguments) as progress, atomic_folder(arguments.out) as folder:
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
    problems = []
    for reason in dict.fromkeys(reasons.values()):
        names = [figure.name for figure in reasons if reasons[figure] == reason]
        problems.append(f"not drawn: {', '.join(names)}: {reason}")
    number_drawn = "1 figure" if len(drawn) == 1 else f"{len(drawn)} figures"
    document = {
        "drawn_from": source,
        "figures": [{**_as_dict(figure), "file": f"{figure.stem}.{arguments.format}"} for figure in drawn],
        "missing": {figure.number: reason for figure, reason in reasons.items()},
    }
    return Outcome(
        f"wrote {number_drawn} and gallery.md into {arguments.out}, drawn from: {source}",
        "\n".join(f"{figure.name}: {figure.title}. {figure.caption}" for figure in drawn),
        document, wrote=[arguments.out], code=3 if missing else 0, problem="; ".join(problems),
    )  # fmt: skip


def _as_dict(figure: ChapterFigure) -> dict[str, str]:
    return {"number": figure.number, "title": figure.title, "caption": figure.caption}


def _check(arguments: argparse.Namespace) -> None:
    if (arguments.log is None) != (arguments.map is None):
        raise InvalidInputError("LOG and --map: expected both, or neither for simulated data")
    if arguments.log is None and (arguments.poses is not None or arguments.scan is not None):
        raise InvalidInputError("--poses and --scan: go with a LOG of your own")
    if arguments.log is None:
        options.refuse_reading(arguments, "says how a LOG of your own is read, and there is none")


def _world(arguments: argparse.Namespace, progress: StageProgress) -> FigureWorld:
    from beamfield.figures.world import simulated_world, world_of_log

    if arguments.log is None:
        progress("simulating", 0, 1)
        return simulated_world(arguments.seed)
    progress("reading", 0, 1)
    grid = inputs.read_walls(arguments)
    # The first sensor that is asked for is shown, the others are drawn beside it.
    shown = arguments.sensor[0] if arguments.sensor else None
    log = inputs.read_scans(arguments)
    if not log.only_sensor(shown).has_poses:
        raise FormatError(
            arguments.log,
            "no scan has a reference pose, and the figures need them; give a TUM or CSV file with --poses, as "
            "beamfield trajectory writes one from the odometry and the map",
        )
    if arguments.scan is not None:
        return world_of_log(log, grid, sensor=shown, index=arguments.scan)
    with about_file(arguments.log):
        return world_of_log(log, grid, sensor=shown)
