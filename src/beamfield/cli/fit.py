"""``beamfield fit``: say whether each scan of a log fits the map at its pose, and whether the robot is lost."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli.calibrate import add_log_options, log_options
from beamfield.cli.formats import LOG_FORMATS, MAP_FORMATS
from beamfield.cli.progress import StageProgress
from beamfield.cli.provenance import provenance
from beamfield.cli.terminal import say
from beamfield.cli.wording import in_options
from beamfield.errors import FormatError, InvalidInputError, TooLittleDataError
from beamfield.printable import printable

if TYPE_CHECKING:
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.models.range_mixture import RangeMixtureModel
    from beamfield.scan_fit.reference import ScanFitReference
    from beamfield.scan_fit.scan_fit import ScanFits
    from beamfield.sensors import SensorLog

DESCRIPTION = """
Judge every scan of a log at its pose: a p-value (how many good scans fit the map as badly) and a running probability
that the robot is lost. What good scans look like is learned from the log itself, or from another one with --good.
Prints a table and writes fit.json, fit.csv, fit.html, and what it learned (beam_model.yaml, scan_fit_reference.json),
whole or not at all.
"""

FILES = ("fit.json", "fit.csv", "fit.html", "beam_model.yaml", "scan_fit_reference.json")
# The worst scans are drawn this far apart in time, seconds: neighbours look alike.
APART_S = 2.0


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser(
        "fit", help="say whether scans fit the map, and whether the robot is lost", description=DESCRIPTION
    )
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_FORMATS)
    parser.add_argument("--map", type=Path, required=True, metavar="MAP", help=MAP_FORMATS)
    parser.add_argument("--poses", type=Path, metavar="FILE", help="poses to judge: TUM or CSV file")
    parser.add_argument("--params", "--parameters", type=Path, metavar="FILE",
                        help="a beam_model.yaml from beamfield calibrate (default: calibrate now)")  # fmt: skip
    parser.add_argument("--good", type=Path, metavar="LOG2",
                        help="log of a good run to compare with (default: LOG, but no neighbours)")  # fmt: skip
    parser.add_argument("--good-poses", type=Path, metavar="FILE", help="reference poses of LOG2: TUM or CSV file")
    parser.add_argument("--reference", type=Path, metavar="FILE",
                        help="a scan_fit_reference.json of an earlier run, in place of --good")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("beamfield_fit"), metavar="DIR",
                        help="output folder (default: %(default)s)")  # fmt: skip
    parser.add_argument("--worst", type=int, default=6, metavar="N", help="worst scans to list and draw (default: 6)")
    parser.add_argument("--lose-rate", type=float, default=1.0 / 600.0, metavar="1/S",
                        help="how often the robot gets lost, before any scan is seen (default: 1/600)")  # fmt: skip
    parser.add_argument("--find-rate", type=float, default=1.0 / 60.0, metavar="1/S",
                        help="how often a lost robot finds its place (default: 1/60)")  # fmt: skip
    add_log_options(parser)
    parser.add_argument("--seed", type=int, default=0, help="seed of every random choice (default: 0)")
    parser.add_argument("--threads", type=int, help="processors to use (default: all)")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.set_defaults(run=run)


@dataclass(frozen=True)
class _Inputs:
    """What was read."""

    grid: OccupancyGrid
    log: SensorLog
    good: SensorLog
    is_own: bool
    parameters: BeamParameters | None
    reference: ScanFitReference | None
    notes: tuple[str, ...]


def run(arguments: argparse.Namespace) -> int:
    """Read, calibrate, judge, write, say."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable
    from beamfield.report.scan_fit_page import fit_table
    from beamfield.scan_fit.lost import LostRates
    from beamfield.scan_fit.scan_fit import judge_log

    _check(arguments)
    check_folder_writable(arguments.out)
    rates = LostRates(arguments.lose_rate, arguments.find_rate)
    with StageProgress(quiet=arguments.quiet) as progress:
        given = _read(arguments, progress)
        try:
            parameters = _parameters(given, arguments, progress)
            model = _model(given, parameters)
            origin = _provenance(arguments)
            reference = _reference(model, given, origin, arguments, progress)
            fits = judge_log(
                model, given.log, reference, is_own=given.is_own, rates=rates,
                progress=lambda done, total: progress("judging scans", done, total),
            )  # fmt: skip
        except (InvalidInputError, TooLittleDataError) as error:
            raise type(error)(f"{arguments.log}: {error}") from error
        worst = fits.worst(arguments.worst, apart_s=APART_S)
        progress("drawing", 0, 1)
        files = _files(fits, worst, model, reference, given, origin)
    with atomic_folder(arguments.out) as folder:
        for name, content in files.items():
            (folder / name).write_text(content, encoding="utf-8")
    for note in given.notes:
        say(f"note: {printable(in_options(note))}")
    say(_basis(reference, given))
    say(fit_table(fits, worst))
    say(f"\nwrote {', '.join(FILES)} into {arguments.out}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    if arguments.worst < 0:
        raise InvalidInputError(f"--worst: expected 0 or more, got {arguments.worst}")
    if arguments.seed < 0:
        raise InvalidInputError(f"--seed: expected a number >= 0, got {arguments.seed}")
    if arguments.good is not None and arguments.reference is not None:
        raise InvalidInputError("--reference: is in place of --good, give only one of them")
    if arguments.good_poses is not None and arguments.good is None:
        raise InvalidInputError("--good-poses: needs --good")
    if arguments.reference is not None and arguments.params is None:
        raise InvalidInputError("--reference: needs the parameters it was made with, give --params")
    if arguments.sensor and len(arguments.sensor) > 1:
        raise InvalidInputError(f"--sensor: expected one, got {len(arguments.sensor)}")


def _read(arguments: argparse.Namespace, progress: StageProgress) -> _Inputs:
    from beamfield.io.parameters.beam_model_file import read_saved_beam_model
    from beamfield.io.read_map import read_map

    progress("reading the map", 0, 1)
    grid = read_map(arguments.map)
    if not grid.occupied.any():
        raise InvalidInputError(f"{arguments.map}: the map has no occupied cell: no ray has an expected range")
    progress("reading the log", 0, 1)
    log, notes = _sensor(arguments.log, arguments.poses, arguments)
    is_own = arguments.good is None
    good, more = (log, ()) if is_own else _sensor(arguments.good, arguments.good_poses, arguments)
    parameters, limit = None, good.finder.max_range
    if arguments.params is not None:
        parameters, limit, _ = read_saved_beam_model(arguments.params)
    reference = None if arguments.reference is None else _read_reference(arguments.reference)
    log, note = _with_limit(log, limit)
    good, _ = _with_limit(good, limit)
    is_own = is_own and reference is None
    return _Inputs(grid, log, good, is_own, parameters, reference, (*notes, *more, *note))


# Limits found in two logs of one sensor differ by less (81.83 and 81.87 m); those of two sensors by more.
SAME_LIMIT = 0.01


def _with_limit(log: SensorLog, limit: float) -> tuple[SensorLog, tuple[str, ...]]:
    """Return the log with the max_range of the model, and a note if that was another."""
    found = log.finder.max_range
    if found == limit:
        return log, ()
    if abs(found - limit) > SAME_LIMIT * limit:
        raise InvalidInputError(
            f"{log.finder.name or 'log'}: the sensor's max_range is {found:g} m, but the good log or the parameters "
            f"are for {limit:g} m; see --max-range"
        )
    note = f"max_range {found:g} m of the log is taken as {limit:g} m, as in the good log or the parameters"
    return replace(log, finder=replace(log.finder, max_range=limit)), (note,)


def _read_reference(path: Path) -> ScanFitReference:
    from beamfield.scan_fit.reference import ScanFitReference

    try:
        return ScanFitReference.from_json(path.read_text(encoding="utf-8", errors="replace"))
    except (InvalidInputError, TooLittleDataError) as error:
        raise FormatError(path, str(error)) from error


def _sensor(path: Path, poses: Path | None, arguments: argparse.Namespace) -> tuple[SensorLog, tuple[str, ...]]:
    from beamfield.io.read_log import read_log
    from beamfield.io.trajectory import attach_poses, read_trajectory

    log = read_log(path, **log_options(arguments))
    if poses is not None:
        log = attach_poses(log, read_trajectory(poses))
    sensor = log.only_sensor(arguments.sensor[0] if arguments.sensor else None)
    if not sensor.has_poses:
        raise InvalidInputError(f"{path}: no scan has a pose to judge; give a TUM or CSV file with --poses")
    return sensor, log.notes


def _parameters(given: _Inputs, arguments: argparse.Namespace, progress: StageProgress) -> BeamParameters:
    from beamfield.calibration.calibrate import CalibrationOptions, calibrate

    if given.parameters is not None:
        return given.parameters
    options = CalibrationOptions(refine=False, seed=arguments.seed)
    return calibrate(given.good, given.grid, options, progress=progress).parameters


def _model(given: _Inputs, parameters: BeamParameters) -> RangeMixtureModel:
    from beamfield.models.beam import BeamModel
    from beamfield.models.sonar import SonarModel

    kind = SonarModel if given.log.finder.opening_angle > 0.0 else BeamModel
    return kind(given.grid, parameters)


def _reference(
    model: RangeMixtureModel,
    given: _Inputs,
    origin: dict[str, Any],
    arguments: argparse.Namespace,
    progress: StageProgress,
) -> ScanFitReference:
    from beamfield.scan_fit.reference import calibrate_scan_fit

    if given.reference is not None:
        return given.reference
    roles = ("map", "map image", "params", *(("log", "poses") if given.is_own else ("good", "good poses")))
    return calibrate_scan_fit(
        model,
        given.good,
        seed=arguments.seed,
        inputs={role: entry for role, entry in origin["inputs"].items() if role in roles},
        progress=lambda done, total: progress("scoring wrong poses", done, total),
    )


def _files(
    fits: ScanFits,
    worst: Any,
    model: RangeMixtureModel,
    reference: ScanFitReference,
    given: _Inputs,
    origin: dict[str, Any],
) -> dict[str, str]:
    from beamfield.io.parameters.beam_model_file import beam_model_text
    from beamfield.report.scan_fit_figures import fit_over_time, worst_scans
    from beamfield.report.scan_fit_page import fit_as_dict, fit_csv, render_fit_page

    drawn = (
        fit_over_time(fits, reference, own=given.is_own),
        worst_scans(fits, model, given.log, given.grid, worst),
    )
    title = f"Do the scans of {origin['inputs']['log']['name']} fit the map?"
    document = {
        "provenance": origin,
        "notes": list(given.notes),
        **fit_as_dict(fits, reference, worst, own=given.is_own),
    }
    return {
        "fit.json": json.dumps(document, indent=1, allow_nan=False) + "\n",
        "fit.csv": fit_csv(fits),
        "fit.html": render_fit_page(title, fits, reference, [f for f in drawn if f is not None], origin),
        "beam_model.yaml": beam_model_text(model.parameters, given.log.finder, provenance=origin),
        "scan_fit_reference.json": reference.to_json(),
    }


def _basis(reference: ScanFitReference, given: _Inputs) -> str:
    which = "of this log (without neighbours in time)" if given.is_own else "of the good run"
    return (
        f"compared with {len(reference)} good scans {which}, worth about {reference.n_effective:.0f} independent ones; "
        f"least p-value {reference.smallest_p_value:.2g}"
    )


def _provenance(arguments: argparse.Namespace) -> dict[str, Any]:
    from beamfield.io.maps.ros_map import image_path

    inputs = [("log", arguments.log), ("map", arguments.map)]
    if arguments.map.suffix in (".yaml", ".yml"):
        inputs.append(("map image", image_path(arguments.map)))
    names = ("poses", "params", "good", "good_poses", "reference")
    inputs += [(name.replace("_", " "), getattr(arguments, name)) for name in names if getattr(arguments, name)]
    files = {"log", "map", *names, "out", "run", "quiet", "threads", "seed"}
    options = {name: value for name, value in sorted(vars(arguments).items()) if name not in files}
    return provenance(inputs, options, arguments.seed)
