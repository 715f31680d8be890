"""``beamfield likelihood``: p(z | x, m) of one scan over a whole map, drawn and as arrays (Figure 6.7)."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli.calibrate import add_log_options, log_options
from beamfield.cli.formats import LOG_FORMATS, MAP_FORMATS
from beamfield.cli.progress import StageProgress
from beamfield.cli.terminal import say
from beamfield.errors import InvalidInputError

if TYPE_CHECKING:
    from beamfield.localization.likelihood_map import LikelihoodMap
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.models.base import MeasurementModel
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.models.field_parameters import LikelihoodFieldParameters
    from beamfield.sensors import Scan, SensorLog

DESCRIPTION = """
Compute how likely a scan is at every free place of a map, with the heading that suits it best, say where the maximum is
and how far from the reference pose, and draw it: the scan at its reference pose, and the likelihood over the map.
"""

PICTURES = (".png", ".svg", ".pdf")
# Without --params: a laser scanner in a building with a few people.
DEFAULTS = {"z_hit": 0.8, "z_short": 0.08, "z_max": 0.02, "z_rand": 0.1, "sigma_hit": 0.2, "lambda_short": 0.4}
# And a sonar: many echoes are lost or take a detour.
SONAR_DEFAULTS = {"z_hit": 0.5, "z_short": 0.05, "z_max": 0.2, "z_rand": 0.25, "sigma_hit": 0.1, "lambda_short": 0.4}
# Without --beams, unless a file of a learned field says.
DEFAULT_BEAMS = 30
# Local maps for map matching have cells of at least this size, metres: time is proportional to their number.
LOCAL_RESOLUTION = 0.2


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser(
        "likelihood", help="draw how likely a scan is over a whole map", description=DESCRIPTION
    )
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_FORMATS)
    parser.add_argument("--map", type=Path, required=True, metavar="MAP", help=MAP_FORMATS)
    parser.add_argument("--scan", type=int, required=True, metavar="I", help="index of the scan in the log, from 0 on")
    parser.add_argument("--model", choices=("beam", "field", "matching"), default="beam",
                        help="beam model, likelihood field or map matching (default: beam)")  # fmt: skip
    parser.add_argument("--poses", type=Path, metavar="FILE", help="reference poses: TUM or CSV file")
    parser.add_argument("--params", "--parameters", dest="parameters", type=Path, metavar="FILE",
                        help="a beam_model.yaml, or with --model field a likelihood_field.yaml, from beamfield "
                        "calibrate (default: typical values)")  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="FILE", help=f"draw into this file ({', '.join(PICTURES)})")
    parser.add_argument("--npz", type=Path, metavar="FILE", help="write the arrays into this NumPy .npz file")
    lattice = parser.add_argument_group("poses that are compared")
    lattice.add_argument("--resolution", type=float, default=0.10, metavar="M", help="step in x and y (default: 0.1)")
    lattice.add_argument("--headings", type=int, default=72, metavar="N", help="headings per place (default: 72)")
    lattice.add_argument("--no-widening", action="store_true",
                         help="do not widen the noise of hits by what lies between the poses")  # fmt: skip
    model = parser.add_argument_group("model")
    model.add_argument("--beams", type=int, metavar="K",
                       help="beams of the scan that count, equally spaced; 0: all (default: 30, or as a "
                       "likelihood_field.yaml says; with another number its exponent is scaled)")  # fmt: skip
    model.add_argument("--local-scans", type=int, default=10, metavar="N",
                       help="matching: scans in the local map, up to this one (default: 10)")  # fmt: skip
    add_log_options(parser)
    parser.add_argument("--threads", type=int, help="processors to use (default: all)")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Read, evaluate, write, say."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.read_map import read_map
    from beamfield.localization.likelihood_map import likelihood_map

    _check(arguments)
    with StageProgress(quiet=arguments.quiet) as progress:
        progress("reading the map", 0, 1)
        grid = read_map(arguments.map)
        if not grid.occupied.any():
            raise InvalidInputError(f"{arguments.map}: the map has no occupied cell, so all places are alike")
        if not grid.free.any():
            raise InvalidInputError(f"{arguments.map}: the map has no free cell, so there is no place to compare")
        progress("reading the log", 0, 1)
        sensor = _sensor(arguments)
        scan = _scan(sensor, arguments)
        measured, model = _measurement_and_model(sensor, scan, grid, arguments)
        result = likelihood_map(
            model,
            measured,
            grid,
            resolution=arguments.resolution,
            headings=arguments.headings,
            progress=lambda done, total: progress("comparing poses", done, total),
        )
        reference = sensor.poses[arguments.scan]
        reference = reference if math.isfinite(float(reference.sum())) else None
        progress("drawing", 0, 1)
        _write(scan, grid, result, reference, arguments)
    say(_summary(result, measured, model, reference))
    for path in (arguments.out, arguments.npz):
        if path is not None:
            say(f"wrote {path}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    from beamfield.io.files.atomic import check_writable

    if arguments.out is not None and arguments.out.suffix.lower() not in PICTURES:
        raise InvalidInputError(f"--out: expected a name ending in {', '.join(PICTURES)}, got {arguments.out.name!r}")
    if arguments.npz is not None and arguments.npz.suffix.lower() != ".npz":
        raise InvalidInputError(f"--npz: expected a name ending in .npz, got {arguments.npz.name!r}")
    for path in (arguments.out, arguments.npz):
        if path is not None:
            check_writable(path)
    if arguments.beams is not None and arguments.beams < 0:
        raise InvalidInputError(f"--beams: expected 0 (all) or more, got {arguments.beams}")
    if arguments.local_scans < 1:
        raise InvalidInputError(f"--local-scans: expected at least 1, got {arguments.local_scans}")


def _sensor(arguments: argparse.Namespace) -> SensorLog:
    from beamfield.io.read_log import read_log
    from beamfield.io.trajectory import attach_poses, read_trajectory

    log = read_log(arguments.log, **log_options(arguments))
    if arguments.poses is not None:
        log = attach_poses(log, read_trajectory(arguments.poses))
    if arguments.sensor and len(arguments.sensor) > 1:
        raise InvalidInputError(f"--sensor: expected one, got {len(arguments.sensor)}")
    return log.only_sensor(arguments.sensor[0] if arguments.sensor else None)


def _scan(sensor: SensorLog, arguments: argparse.Namespace) -> Scan:
    """Return the scan, or say what there is instead."""
    from beamfield.sensors import usable_ranges

    index = arguments.scan
    if not 0 <= index < len(sensor):
        what = f"scans 0 to {len(sensor) - 1}" if len(sensor) else "no scan"
        raise InvalidInputError(f"--scan: {arguments.log} has {what}, got {index}")
    scan = sensor.scan(index)
    ranges = usable_ranges(scan.ranges, scan.finder)
    if not (ranges < scan.finder.max_range).any():
        raise InvalidInputError(f"--scan: scan {index} of {arguments.log} has no measured range")
    return scan


def _measurement_and_model(
    sensor: SensorLog, scan: Scan, grid: OccupancyGrid, arguments: argparse.Namespace
) -> tuple[Any, MeasurementModel[Any]]:
    """Return what is measured (a scan or a local map) and the model that scores it."""
    from beamfield.localization.lattice_noise import widened_field_for_lattice, widened_for_lattice
    from beamfield.models.beam import BeamModel
    from beamfield.models.likelihood_field import LikelihoodFieldModel
    from beamfield.models.map_matching import MapMatchingModel
    from beamfield.models.sonar import SonarModel

    if arguments.model == "matching":
        return _local_map(sensor, grid, arguments), MapMatchingModel(grid)
    lattice = {"resolution": arguments.resolution, "headings": arguments.headings}
    n_beams = DEFAULT_BEAMS if arguments.beams is None else arguments.beams or None
    options: dict[str, Any] = {"n_beams": n_beams}
    if arguments.model == "beam":
        parameters = _parameters(arguments, scan)
        if not arguments.no_widening:
            parameters = widened_for_lattice(parameters, **lattice)
        return scan, (SonarModel if scan.finder.opening_angle > 0.0 else BeamModel)(grid, parameters, **options)
    of_field, learned = _field(arguments, scan)
    if not arguments.no_widening:
        of_field = widened_field_for_lattice(of_field, scan, **lattice)
    return scan, LikelihoodFieldModel(grid, of_field, **options | learned)


def _parameters(arguments: argparse.Namespace, scan: Scan) -> BeamParameters:
    from beamfield.io.parameters.beam_model_file import read_beam_model
    from beamfield.models.beam_parameters import BeamParameters

    if arguments.parameters is None:
        return BeamParameters(**(SONAR_DEFAULTS if scan.finder.opening_angle > 0.0 else DEFAULTS))
    return read_beam_model(arguments.parameters)


def _field(arguments: argparse.Namespace, scan: Scan) -> tuple[LikelihoodFieldParameters, dict[str, Any]]:
    """Return the parameters of the field, and the options that a file of learned ones adds."""
    from beamfield.io.parameters.likelihood_field_file import is_likelihood_field, read_likelihood_field
    from beamfield.models.field_parameters import NOT_OF_A_FIELD, LikelihoodFieldParameters

    if arguments.parameters is not None and is_likelihood_field(arguments.parameters):
        saved = read_likelihood_field(arguments.parameters)
        if arguments.beams is None:
            return saved.parameters, {"exponent": saved.exponent, "n_beams": saved.n_beams}
        # A scan is worth about as many independent beams, however many of its beams are used.
        used = min(arguments.beams or scan.finder.n_beams, scan.finder.n_beams)
        return saved.parameters, {"exponent": min(1.0, saved.exponent * saved.n_beams / used)}
    beam = _parameters(arguments, scan)
    for name in NOT_OF_A_FIELD:
        if getattr(beam, name) != 0.0:
            say(
                f"note: {arguments.parameters} has {name} {getattr(beam, name):.4g}, which a likelihood field cannot "
                "have; it is left out. The likelihood_field.yaml of beamfield calibrate is learned without."
            )
    return LikelihoodFieldParameters.from_beam_parameters(beam, drop=NOT_OF_A_FIELD), {}


def _local_map(sensor: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace) -> OccupancyGrid:
    """Return the local map of the last scans; of this scan alone if there are no poses to join them by."""
    import numpy as np

    from beamfield.maps.mapping import local_map

    track = sensor.poses if np.isfinite(sensor.poses[arguments.scan]).all() else sensor.odometry
    joined = bool(np.isfinite(track[arguments.scan]).all())
    return local_map(
        sensor,
        arguments.scan,
        n=arguments.local_scans if joined else 1,
        resolution=max(grid.resolution, LOCAL_RESOLUTION),
        poses=track if joined else np.zeros((len(sensor), 3)),
    )


def _write(
    scan: Scan, grid: OccupancyGrid, result: LikelihoodMap, reference: Any, arguments: argparse.Namespace
) -> None:
    """Write what was asked for: all of it or nothing."""
    import numpy as np

    from beamfield.figures.gallery import save_figure
    from beamfield.figures.likelihood_over_map import likelihood_figure
    from beamfield.io.files.atomic import atomic_files

    wanted = [path for path in (arguments.out, arguments.npz) if path is not None]
    names = {"beam": "beam model", "field": "likelihood field", "matching": "map matching"}
    with atomic_files(wanted) as parts:
        for path, part in zip(wanted, parts, strict=True):
            if path is arguments.out:
                figure = likelihood_figure(scan, grid, result, reference, model_name=names[arguments.model])
                save_figure(figure, part)
            else:
                rows, cols = np.nonzero(result.evaluated)
                heading = np.full(result.evaluated.shape, np.nan)
                heading[rows, cols] = result.headings[result.heading_index[rows, cols]]
                np.savez_compressed(
                    part,
                    log_likelihood=result.log_likelihood,
                    evaluated=result.evaluated,
                    heading=heading,
                    resolution=result.resolution,
                    origin=result.origin,
                    best_pose=result.best_pose,
                    reference_pose=np.full(3, np.nan) if reference is None else reference,
                )


def _summary(result: LikelihoodMap, measured: Any, model: MeasurementModel[Any], reference: Any) -> str:
    """Return in words how much was compared, where the maximum is, and what the reference pose is worth."""
    from beamfield.geometry import between

    places, n_headings = int(result.evaluated.sum()), len(result.headings)
    lattice = f"{places:,} places of {result.resolution:g} m, {n_headings} headings"
    lines = [f"compared {result.n_poses:,} poses: {lattice}"]
    if result.is_flat:
        lines.append("all places are equally likely: the scan says nothing here")
        return "\n".join(lines)
    best = result.best_pose
    top = float(result.log_likelihood[result.best_cell])
    lines.append(f"maximum: {_pose_text(best)}, log p(z | x, m) = {top:.2f} nats")
    if reference is None:
        lines.append("the scan has no reference pose to compare with")
        return "\n".join(lines)
    step = between(reference, best)
    lines.append(f"reference: {_pose_text(reference)}; the maximum is {math.hypot(step[0], step[1]):.2f} m and "
                 f"{math.degrees(abs(step[2])):.1f} deg away")  # fmt: skip
    value = float(model.log_likelihood(measured, reference))
    share = result.share_above(value)
    if value > top:
        lines.append(f"the reference lies between the poses compared and is likelier still, by {value - top:.2f} nats")
    else:
        lines.append(
            f"at the reference: {top - value:.2f} nats below the maximum; {share:.2%} of the places are likelier"
        )
    return "\n".join(lines)


def _pose_text(pose: Any) -> str:
    return f"x {pose[0]:.2f} m, y {pose[1]:.2f} m, heading {math.degrees(pose[2]):.1f} deg"
