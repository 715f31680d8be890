"""Localize the robot of a log in a map with a particle filter.

Run a particle filter over the scans and the odometry of a log, and write where the robot was (trajectory.tum), up to
200 particles of each update (particles.csv.gz), a picture of its path and of how sure the filter was
(localization.png), and the numbers (localization.json), whole or not at all; beamfield explore --run shows them. The
filter starts at --start, else at the first reference pose, else, or with --global, anywhere on the map; the other
reference poses only judge the errors. Poses of the log itself that map and odometry refute are replaced by fitted ones.

With --params of nav2 or another stack, the robot's own filter runs instead of ours, emulated; evaluate compares
several.

for example:

  beamfield localize run.bag --map map.yaml --start 2.0 1.5 90
  beamfield localize run.bag --map map.yaml --global --params beamfield_calibration/likelihood_field.yaml
  beamfield localize run.bag --map map.yaml --params nav2_params.yaml
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import inputs, options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, count, finite, index, positive
from beamfield.cli.progress import StageProgress
from beamfield.cli.provenance import provenance
from beamfield.cli.recordings import add_recordings, check_recordings, write_recordings
from beamfield.errors import FormatError, InvalidInputError, TooLittleDataError, about_file

if TYPE_CHECKING:
    from beamfield.cli.film import Film
    from beamfield.finding import Finding
    from beamfield.io.recordings.recording import Recording
    from beamfield.localization.particle_filter import Update
    from beamfield.localization.replay import PoseBelief, ReplayErrors
    from beamfield.localization.scan_localizer import Localization, ScanLocalizer
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog

# Without --params: a laser scanner in a building with a few people.
DEFAULTS = {"z_hit": 0.8, "z_short": 0.08, "z_max": 0.02, "z_rand": 0.1, "sigma_hit": 0.15, "lambda_short": 0.4}
DEFAULT_BEAMS = 60
# What a scan is worth to a filter, in independent beams: neighbours in a scan, and scans half a metre apart, err alike.
# Measured in docs/evidence/localization.md.
INDEPENDENT_BEAMS = 1.8
PARTICLES = 2000

# Findings after which the poses are not to be trusted.
PROBLEMS = {
    "robot-lost": "the robot is most likely lost",
    "lost-at-end": "at the end the robot is most likely lost",
    "not-found": "the robot has not been found for sure",
}


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "localize", __doc__)
    parser.add_argument("log", type=Path, metavar="LOG", help=options.LOG_FORMATS)
    options.add_map(parser, required=True)
    options.add_poses(parser)
    parser.add_argument("--model", choices=("likelihood_field", "beam"),
                        help="measurement model (default: that of the file, or likelihood_field)")  # fmt: skip
    options.add_params(parser, "a likelihood_field.yaml or beam_model.yaml from beamfield calibrate (default: typical "
                       "values), or a file of nav2 or another stack, whose filter then runs")  # fmt: skip
    options.add_range_table(parser)
    options.add_out(parser, "beamfield_localization", metavar="DIR", what="output folder")
    parser.add_argument(
        "--animation", type=options.output_file, metavar="FILE", help="write the particles over time as a .gif"
    )
    start = parser.add_argument_group("start").add_mutually_exclusive_group()
    start.add_argument("--start", type=finite, action=options.PoseAction, nargs=3, metavar=("X", "Y", "DEG"),
                       help="the first pose, within about 0.5 m and 15 degrees (default: the first reference pose; "
                       "without one --global)")  # fmt: skip
    start.add_argument("--global", action="store_true", dest="anywhere", help="it can be anywhere on the map")
    group = parser.add_argument_group("filter")
    group.add_argument("--particles", type=count, metavar="N",
                       help=f"particles of a cloud that knows its place (default: {PARTICLES})")  # fmt: skip
    group.add_argument("--beams", type=index, metavar="N",
                       help=f"beams of a scan that count, equally spaced; 0: all (default: {DEFAULT_BEAMS}, or as the "
                       "file says)")  # fmt: skip
    group.add_argument("--exponent", type=positive, metavar="E",
                       help=f"power of each beam's likelihood (default: {INDEPENDENT_BEAMS} / beams, or as "
                       "the file says)")  # fmt: skip
    group.add_argument("--odometry-error", type=positive, metavar="K",
                       help="the odometry errs K times as much as usual (default: 1)")  # fmt: skip
    group.add_argument("--leave-out-short", action="store_true", help="leave out readings that are likely of people")
    options.add_whose_files(parser)
    add_recordings(parser)
    options.add_log(parser)
    options.add_seed(parser)
    options.add_threads(parser)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read, filter, judge, write."""
    # What imports numerical libraries is imported where it is used, so that --help answers at once.
    import numpy as np

    from beamfield.cli.film import Film
    from beamfield.cli.localize_summary import ended_at, run_facts, run_summary, sure_from
    from beamfield.finding import worst_first
    from beamfield.io.files.atomic import check_folder_writable
    from beamfield.localization.lost_robot import find_lost_robot, lost_not_judged
    from beamfield.localization.trajectory_trust import time_gaps

    check_folder_writable(arguments.out, "trajectory.tum")
    options.check_output(arguments.animation, "animation", ".gif")
    check_recordings(arguments)
    with options.progress(arguments) as progress:
        grid, sensor, notes = inputs.read_map_and_sensor(arguments, progress)
        _check_inputs(sensor, grid, arguments)
        sensor, of_poses = _with_poses_that_hold(sensor, grid, arguments, progress)
        log, start = _start(sensor, grid, arguments)
        run_filter, which, left_out = _filter(log, grid, start, arguments)
        notes = (*notes, *(finding.full_text for finding in of_poses), *left_out)
        film = Film(len(log), arguments.seed)

        progress("localizing", 0, len(log))
        try:
            found = run_filter(film, lambda i: progress("localizing", i, len(log)))
        except TooLittleDataError as error:
            raise FormatError(arguments.log, str(error)) from error
        # Before a robot is found, poses are a guess; if it never is, they are judged all the same.
        is_found = not any(finding.name == "not-found" for finding in found.findings)
        since = (sure_from(found) or 0) if start is None and is_found else 0
        lost = find_lost_robot(log, grid, np.where(np.arange(len(log))[:, None] < since, np.nan, found.poses))
        is_sonar = log.finder.opening_angle > 0.0
        judged = [lost] if lost is not None else [lost_not_judged()] if is_sonar else []
        found = replace(found, findings=worst_first((*found.findings, *time_gaps(log.stamps), *judged)))
        errors = _judged(found, log, 0 if lost is not None and lost.name == "robot-lost" else since)
        progress("drawing", 0, 1)
        facts = run_facts(found, errors, log, start, of_poses)
        document = {"provenance": provenance(arguments), "filter": which, **facts}
        names, recorded = _write(found, log, grid, film, document, arguments)
    notes = (*notes, *(finding.full_text for finding in found.findings))
    seen_names = {finding.name for finding in found.findings}
    problem = next((text for name, text in PROBLEMS.items() if name in seen_names), "")
    line = ", ".join([f"wrote {', '.join(names)} into {arguments.out}", *map(str, recorded)])
    return Outcome(
        line, run_summary(document, errors, arguments, is_sonar=is_sonar), document, notes, [arguments.out, *recorded],
        code=3 if problem else 0, problem=problem, brief=ended_at(document),
    )  # fmt: skip


def _with_poses_that_hold(
    sensor: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace, progress: StageProgress
) -> tuple[SensorLog, tuple[Finding, ...]]:
    """Return the log, with poses fitted to the map where its own are refuted, and what refutes them."""
    from beamfield.cli.fitted_poses import REFUTED, posed_log

    if not sensor.has_poses:
        return sensor, ()
    log, fitted, found = posed_log(sensor, grid, arguments, progress, arguments.log, arguments.poses, None)
    return log, found if fitted is not None else tuple(one for one in found if one.name in REFUTED)


def _check_inputs(sensor: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace) -> None:
    from beamfield.maps.range_scale import require_metres

    inputs.require_odometry(sensor, arguments.log)
    if not ((sensor.ranges > 0.0) & (sensor.ranges < sensor.finder.max_range)).any():
        raise FormatError(
            arguments.log, "no reading of any scan hits anything; see what was read with beamfield inspect"
        )
    if not grid.free.any():
        raise FormatError(arguments.map, "the map has no free cell, so there is no place for the robot")
    with about_file(arguments.log):
        require_metres(sensor, grid)


def _start(
    sensor: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace
) -> tuple[SensorLog, PoseBelief | None]:
    """Return the log from where the filter starts, and what it knows there; None: nothing."""
    from beamfield.localization.replay import PoseBelief, reference_start

    start = options.start_of(arguments)
    if start is not None:
        x, y, _ = start
        if not grid.look_up(grid.free, [x, y]).all():
            raise InvalidInputError(
                f"--start: {x:g} {y:g} is not in a free cell of {arguments.map} (see beamfield inspect MAP -o see.png)"
            )
        return sensor, PoseBelief.around(start)
    if arguments.anywhere or not sensor.has_poses:
        return sensor, None
    first, belief = reference_start(sensor)
    return sensor[first:], belief


Step = Callable[[int], None]


def _filter(
    log: SensorLog, grid: OccupancyGrid, start: PoseBelief | None, arguments: argparse.Namespace
) -> tuple[Callable[[Film, Step], Localization], str, list[str]]:
    """Return what runs the filter over the log, keeping its particles; which filter that is, in words; and notes."""
    import numpy as np

    from beamfield.cli.localize_stack import is_stack_file, stack_filter

    if is_stack_file(arguments.params):
        return stack_filter(log, grid, start, arguments)
    options.refuse(arguments, ("stack", "section"), "is for a file of another program, give that with --params")
    arguments = argparse.Namespace(**{**vars(arguments), "model": inputs.model_of(arguments, "likelihood_field")})
    model, notes = _model(log, grid, arguments)
    localizer, rng = _localizer(model, grid, arguments), np.random.default_rng(arguments.seed)

    def run(film: Film, step: Step) -> Localization:
        def watch(i: int, update: Update) -> None:
            step(i)
            film.add(i, update)

        return localizer.run(log, start, rng, watch=watch)

    name = "beam model" if arguments.model == "beam" else "likelihood field"
    return run, f"beamfield's own, {name}", notes


def _localizer(model: Any, grid: OccupancyGrid, arguments: argparse.Namespace) -> ScanLocalizer:
    from beamfield.localization.distance_scale import DistanceScale
    from beamfield.localization.particle_filter import FilterOptions
    from beamfield.localization.scan_localizer import ScanLocalizer
    from beamfield.localization.short_readings import ShortReadings
    from beamfield.models.gaussian_motion import USUAL_MOTION, GaussianMotion

    times = arguments.odometry_error or 1.0
    filter_options = FilterOptions(
        n_particles=arguments.particles or PARTICLES, distance_scale=DistanceScale().times(times)
    )
    motion = GaussianMotion(**{name: times * value for name, value in asdict(USUAL_MOTION).items()})
    return ScanLocalizer(
        grid,
        model,
        motion,
        filter_options,
        short_readings=ShortReadings(grid, sigma=model.parameters.sigma_hit) if arguments.leave_out_short else None,
    )


def _model(log: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace) -> tuple[Any, list[str]]:
    """Return the measurement model, and notes on its parameters."""
    from beamfield.io.parameters.beam_model_file import read_beam_model
    from beamfield.maps.solids import hollowed
    from beamfield.models.beam import BeamModel
    from beamfield.models.beam_parameters import EXTENSIONS, BeamParameters
    from beamfield.models.field_parameters import LikelihoodFieldParameters, SavedLikelihoodField
    from beamfield.models.likelihood_field import LikelihoodFieldModel

    is_field = arguments.model != "beam"
    saved: Any = None
    if arguments.params is not None:
        read: Any = inputs.read_field_or_beam_model if is_field else read_beam_model
        saved = read(arguments.params)
    how = _counting(saved, log.finder.n_beams, arguments)
    table = inputs.read_range_table(arguments, grid, log.finder)
    parameters: Any = BeamParameters(**DEFAULTS) if saved is None else saved.parameters
    if not is_field:
        return BeamModel(grid, parameters, caster=table, **how), []
    notes: list[str] = []
    if not isinstance(saved, SavedLikelihoodField):
        if saved is not None:
            notes = inputs.left_out_of_a_field(parameters, arguments.params)
        parameters = LikelihoodFieldParameters.from_beam_parameters(parameters, drop=EXTENSIONS)
    return LikelihoodFieldModel(hollowed(grid), parameters, **how), notes


def _counting(saved: Any, n_in_scan: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the number of beams and the exponent: a scan is worth as much, however many of its beams are used."""
    n_beams, worth = DEFAULT_BEAMS, INDEPENDENT_BEAMS
    if saved is not None and (saved.n_beams is not None or saved.exponent != 1.0):
        n_beams = saved.n_beams or n_in_scan
        worth = saved.exponent * min(n_beams, n_in_scan)
    if arguments.beams is not None:
        n_beams = arguments.beams or n_in_scan
    n_used = min(n_beams, n_in_scan)
    return {"n_beams": n_used, "exponent": arguments.exponent or min(1.0, worth / n_used)}


def _judged(found: Localization, log: SensorLog, since: int) -> ReplayErrors | None:
    """Return the errors of the scans from number `since` on; None without reference poses there."""
    from beamfield.localization.replay import judge_replay

    if not log.has_poses:
        return None
    reference = log.poses.copy()
    reference[:since] = math.nan
    try:
        return judge_replay(found, reference)
    except TooLittleDataError:  # reference poses only where there is no odometry
        return None


def _write(
    found: Localization,
    log: SensorLog,
    grid: OccupancyGrid,
    film: Film,
    document: Mapping[str, Any],
    arguments: argparse.Namespace,
) -> tuple[list[str], list[Path]]:
    """Write the files; return their names in the folder, and the recordings beside it."""
    import numpy as np

    from beamfield.figures.gallery import save_figure
    from beamfield.figures.localization import animation, localization_figure
    from beamfield.io.files.atomic import atomic_folder, write_file
    from beamfield.io.filter_run import PARTICLES, TRAJECTORY, write_particles
    from beamfield.io.trajectory import write_tum
    from beamfield.report.as_json import json_text
    from beamfield.sensors import Track

    known = np.isfinite(found.poses).all(axis=1)
    with atomic_folder(arguments.out) as folder:
        write_tum(folder / TRAJECTORY, Track(log.stamps[known], found.poses[known]))
        write_particles(folder / PARTICLES, film.clouds(log.stamps))
        sure_after = document["sure_after_s"] if document["start"] is None else 0.0
        save_figure(localization_figure(found, log, grid, sure_after=sure_after), folder / "localization.png")
        (folder / "localization.json").write_text(json_text(document), encoding="utf-8")
        names = sorted(path.name for path in folder.iterdir())
        recorded = write_recordings(arguments, lambda: _recording(found, log, grid, film))
        if arguments.animation is not None:
            write_file(arguments.animation, animation(film.frames, found, log, grid))
            recorded.append(arguments.animation)
    return names, recorded


def _recording(found: Localization, log: SensorLog, grid: OccupancyGrid, film: Film) -> Recording:
    import numpy as np

    from beamfield.geometry import wrap_angle
    from beamfield.io.recordings.recording import Recording

    covariances = np.full((len(log), 3, 3), np.nan)
    covariances[found.updates] = found.covariances
    paths = {"estimate": found.poses}
    numbers = {"log evidence [nats]": film.log_evidence, "effective particles": film.effective}
    if log.has_poses:
        off = found.poses - log.poses
        paths["reference"] = log.poses
        numbers["position error [m]"] = np.hypot(off[:, 0], off[:, 1])
        numbers["heading error [deg]"] = np.degrees(np.abs(wrap_angle(off[:, 2])))
    return Recording(grid, log, paths, covariances, film.particles, numbers)
