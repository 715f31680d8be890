"""Check whether scans fit the map, and whether the robot is lost.

Judge every scan of a log at its pose: a p-value (how many good scans fit the map as badly) and a running probability
that the robot is lost. Draw over the map where the world differs from it: new obstacles, missing walls, glass, people.
What good scans look like is learned from the log itself, or from another one with --good. A log without poses gets them
first, fitted to the map.
Prints a table and writes scan_fit.json, scan_fit.csv, scan_fit.html, and what it learned (beam_model.yaml,
scan_fit_reference.json), whole or not at all.

for example:

  beamfield check run.bag --map map.yaml
  beamfield check run.bag --map map.yaml --params result/beam_model.yaml --good good_run.bag
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import inputs, options
from beamfield.cli.fitted_poses import NAME, Start, as_document, posed_log, with_map_judged
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, index, positive, rate
from beamfield.cli.progress import StageProgress
from beamfield.cli.provenance import provenance
from beamfield.cli.recordings import add_recordings, beam_recording, check_recordings, write_recordings
from beamfield.cli.wording import in_options
from beamfield.errors import FormatError, InvalidInputError, TooLittleDataError, about_file

if TYPE_CHECKING:
    from beamfield.localization.fitted_poses import FittedPoses
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.models.range_mixture import RangeMixtureModel
    from beamfield.scan_fit.changed_places import ChangedPlaces
    from beamfield.scan_fit.reference import ScanFitReference
    from beamfield.scan_fit.scan_fit import ScanFits
    from beamfield.sensors import SensorLog


# Names in the output folder.
PAGE, TABLE, MODEL, REFERENCE = "scan_fit.html", "scan_fit.csv", "beam_model.yaml", "scan_fit_reference.json"
DOCUMENT = "scan_fit.json"
# The worst scans are drawn this far apart in time, seconds: neighbours look alike.
APART_S = 2.0


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "check", __doc__)
    parser.add_argument("log", type=Path, metavar="LOG", help=options.LOG_FORMATS)
    options.add_map(parser, required=True)
    options.add_poses(parser, fitted=True)
    options.add_params(parser, "a beam_model.yaml from beamfield calibrate (default: calibrate now)")
    parser.add_argument("--good", type=Path, metavar="LOG2",
                        help="log of a good run to compare with (default: LOG, but no neighbours)")  # fmt: skip
    parser.add_argument("--good-poses", type=Path, metavar="FILE", help="reference poses of LOG2: TUM or CSV file")
    parser.add_argument("--good-scans", type=Path, metavar="FILE",
                        help="a scan_fit_reference.json of an earlier run, in place of --good")  # fmt: skip
    options.add_out(parser, "beamfield_check", metavar="DIR", what="output folder")
    parser.add_argument("--worst", type=index, default=6, metavar="N", help="worst scans to list and draw (default: 6)")
    parser.add_argument("--lose-rate", type=rate, default=1.0 / 600.0, metavar="HZ",
                        help="how often the robot gets lost, before any scan is seen (default: 1/600)")  # fmt: skip
    parser.add_argument("--find-rate", type=rate, default=1.0 / 60.0, metavar="HZ",
                        help="how often a lost robot finds its place (default: 1/60)")  # fmt: skip
    parser.add_argument("--reference-error", type=positive, default=0.04, metavar="M",
                        help="how wrong the poses may be where the map is right, standard deviation per axis, and a "
                        "quarter of it in radians (default: 0.04)")  # fmt: skip
    add_recordings(parser)
    options.add_log(parser)
    options.add_seed(parser)
    options.add_threads(parser)


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
    fitted: FittedPoses | None


def run(arguments: argparse.Namespace) -> Outcome:
    """Read, calibrate, judge, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable
    from beamfield.models.sonar import model_of_sensor
    from beamfield.report.as_json import plain
    from beamfield.report.scan_fit_page import fit_as_dict, fit_table
    from beamfield.scan_fit.lost import LostRates
    from beamfield.scan_fit.scan_fit import judge_log

    _check(arguments)
    check_folder_writable(arguments.out, DOCUMENT, TABLE, PAGE, MODEL, REFERENCE)
    check_recordings(arguments)
    rates = LostRates(arguments.lose_rate, arguments.find_rate)
    with options.progress(arguments) as progress:
        given = _read(arguments, progress)
        with about_file(arguments.log):
            parameters, doubt = _parameters(given, arguments, progress)
            problem = _lost(given) or doubt or _disagreement(given)
            model = model_of_sensor(given.log.finder)(given.grid, parameters)
            origin = provenance(arguments)
            reference = _reference(model, given, origin, arguments, progress)
            fits = judge_log(
                model, given.log, reference, is_own=given.is_own, rates=rates,
                progress=lambda done, total: progress("judging scans", done, total),
            )  # fmt: skip
            progress("comparing places with the map", 0, 1)
            places = _changed_places(given, parameters, fits, arguments.reference_error)
        worst = fits.worst(arguments.worst, apart_s=APART_S)
        progress("drawing", 0, 1)
        document = {
            "provenance": origin,
            "notes": [*given.notes, *([problem] if problem else [])],
            NAME: as_document(given.fitted),
            **fit_as_dict(fits, reference, worst, own=given.is_own),
            "changed_places": plain(places),
        }
        files = _files(fits, worst, places, model, reference, given, document, in_options(problem))
    with atomic_folder(arguments.out) as folder:
        for name, content in files.items():
            (folder / name).write_text(content, encoding="utf-8")
        numbers = {"p-value": fits.p_value, "probability of being lost": fits.lost}
        recorded = write_recordings(arguments, lambda: beam_recording(parameters, given.log, given.grid, numbers))
    table = fit_table(fits, worst)
    text = f"{table}\n\n{_basis(reference, given)}" + ("" if places is None else f"\n\n{places.summary()}")
    brief = "; ".join(table.splitlines()[:2])
    line = ", ".join([f"wrote {', '.join(files)} into {arguments.out}", *map(str, recorded)])
    code = 3 if problem else 0
    return Outcome(line, text, document, given.notes, [arguments.out, *recorded], code, problem, brief)


def _check(arguments: argparse.Namespace) -> None:
    if arguments.good is not None and arguments.good_scans is not None:
        raise InvalidInputError("--good-scans: is in place of --good, give only one of them")
    if arguments.good_poses is not None and arguments.good is None:
        raise InvalidInputError("--good-poses: needs --good")
    if arguments.good_scans is not None and arguments.params is None:
        raise InvalidInputError("--good-scans: needs the parameters it was made with, give --params")


def _read(arguments: argparse.Namespace, progress: StageProgress) -> _Inputs:
    saved = None if arguments.params is None else inputs.read_own_beam_model(arguments.params)
    reference = None if arguments.good_scans is None else _read_reference(arguments.good_scans)
    progress("reading the map", 0, 1)
    grid = inputs.read_walls(arguments)
    progress("reading the log", 0, 1)
    start = options.start_of(arguments)
    sensor, log, fitted, notes = _sensor(arguments, arguments.log, arguments.poses, start, grid, progress)
    is_own = arguments.good is None
    good, more = log, tuple[str, ...]()
    if not is_own:
        _, good, _, more = _sensor(arguments, arguments.good, arguments.good_poses, None, grid, progress)
    if fitted is not None and fitted.instead_of is not None:
        # The scans tell what good ones are where they were taken; the log's own poses are what is judged.
        log = sensor
    parameters, limit = (None, good.finder.max_range) if saved is None else (saved.parameters, saved.max_range)
    log, note = _with_limit(log, limit, arguments.log)
    good, _ = _with_limit(good, limit, arguments.good or arguments.log)
    is_own = is_own and reference is None
    return _Inputs(grid, log, good, is_own, parameters, reference, (*notes, *more, *note), fitted)


# Limits found in two logs of one sensor differ by less (81.83 and 81.87 m); those of two sensors by more.
SAME_LIMIT = 0.01


def _with_limit(log: SensorLog, limit: float, path: Path) -> tuple[SensorLog, tuple[str, ...]]:
    """Return the log with the max_range of the model, and a note if that was another."""
    found = log.finder.max_range
    if found == limit:
        return log, ()
    if abs(found - limit) > SAME_LIMIT * limit:
        raise FormatError(
            path,
            f"the sensor's max_range is {found:g} m, but the good log or the parameters are for {limit:g} m; see "
            "--max-range",
        )
    note = f"max_range {found:g} m of the log is taken as {limit:g} m, as in the good log or the parameters"
    return replace(log, finder=replace(log.finder, max_range=limit)), (note,)


def _read_reference(path: Path) -> ScanFitReference:
    from beamfield.scan_fit.reference import ScanFitReference

    try:
        return ScanFitReference.from_json(path.read_text(encoding="utf-8", errors="replace"))
    except (InvalidInputError, TooLittleDataError) as error:
        raise FormatError(path, str(error)) from error


def _sensor(
    arguments: argparse.Namespace, path: Path, poses: Path | None, start: Start, grid: OccupancyGrid,
    progress: StageProgress,
) -> tuple[SensorLog, SensorLog, FittedPoses | None, tuple[str, ...]]:  # fmt: skip
    """Return the sensor as it is, and with poses, its own or fitted to the map; what was fitted, and notes."""
    sensor, notes = inputs.read_sensor(arguments, path, poses)
    posed, fitted, found = posed_log(sensor, grid, arguments, progress, path, poses, start)
    return sensor, posed, fitted, (*notes, *(finding.full_text for finding in found))


def _parameters(given: _Inputs, arguments: argparse.Namespace, progress: StageProgress) -> tuple[BeamParameters, str]:
    """Return the parameters, and why they should not be used; empty if they may be."""
    from beamfield.calibration.calibrate import CalibrationOptions, calibrate
    from beamfield.report.verdict import DOUBTS, doubts

    if given.parameters is not None:
        return given.parameters, ""
    learned = calibrate(
        given.good, given.grid, CalibrationOptions(refine=False, seed=arguments.seed), progress=progress
    )
    if given.is_own and given.fitted is not None:
        learned = replace(learned, findings=with_map_judged(learned.findings, given.fitted))
    reasons = doubts(learned).rstrip(".")
    if not reasons:
        return learned.parameters, ""
    said = f"{reasons}; what good scans look like was learned all the same."
    return learned.parameters, " ".join([said, *(one.do for one in learned.findings if one.name in DOUBTS)])


def _lost(given: _Inputs) -> str:
    """Return where the log's own poses leave the fitted ones, if others were fitted instead, and what to do."""
    own = None if given.fitted is None else given.fitted.instead_of
    return f"{own.text} {own.do}".rstrip(".") if own is not None and own.name == "own-poses-lost" else ""


def _disagreement(given: _Inputs) -> str:
    from beamfield.calibration.reference_checks import map_findings

    found = tuple(map_findings(given.log, given.grid))
    names = {one.name for one in (found if given.fitted is None else with_map_judged(found, given.fitted))}
    if "map-out-of-date" in names:
        return "most readings disagree with the map, which is out of date"
    return "most readings disagree with the map at the reference poses" if "map-disagrees" in names else ""


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


def _changed_places(
    given: _Inputs, parameters: BeamParameters, fits: ScanFits, reference_error: float
) -> ChangedPlaces | None:
    """Find them where the robot was not lost; None for a sonar, or where it always was."""
    import numpy as np

    from beamfield.scan_fit.changed_places import find_changed_places

    log, scans = given.log, (fits.problem == 0) & (fits.lost <= 0.5)
    if _lost(given):
        log, scans = given.good, np.isfinite(given.good.poses).all(axis=1)
    if log.finder.opening_angle > 0.0 or not scans.any():
        return None
    return find_changed_places(log, given.grid, parameters, scans=scans, reference_error=reference_error)


def _files(
    fits: ScanFits,
    worst: Any,
    places: ChangedPlaces | None,
    model: RangeMixtureModel,
    reference: ScanFitReference,
    given: _Inputs,
    document: Mapping[str, Any],
    problem: str,
) -> dict[str, str]:
    from beamfield.io.parameters.beam_model_file import beam_model_text
    from beamfield.report.as_json import json_text
    from beamfield.report.places_figure import places_figure
    from beamfield.report.scan_fit_figures import fit_over_time, worst_scans
    from beamfield.report.scan_fit_page import fit_csv, render_fit_page

    drawn = (
        fit_over_time(fits, reference, own=given.is_own),
        None if places is None else places_figure(places, given.grid, given.log.poses[:, :2]),
        worst_scans(fits, model, given.log, given.grid, worst),
    )
    origin = document["provenance"]
    title = f"Do the scans of {origin['inputs']['log']['name']} fit the map?"
    return {
        DOCUMENT: json_text(document),
        TABLE: fit_csv(fits),
        PAGE: render_fit_page(title, fits, reference, [f for f in drawn if f is not None], origin, problem),
        MODEL: beam_model_text(model.parameters, given.log.finder, provenance=origin),
        REFERENCE: reference.to_json(),
    }


def _basis(reference: ScanFitReference, given: _Inputs) -> str:
    which = "of this log (without neighbours in time)" if given.is_own else "of the good run"
    return (
        f"compared with {len(reference)} good scans {which}, worth about {reference.n_effective:.0f} independent ones; "
        f"smallest possible p-value {reference.smallest_p_value:.2g}"
    )
