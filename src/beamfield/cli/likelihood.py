"""Draw how likely a scan is over a whole map.

Compute how likely a scan is at every free place of a map, with the heading that suits it best, say where the maximum
is, which other place comes next, and how far the maximum is from the reference pose, and draw it: the scan at its
reference pose, and the likelihood over the map.

for example:

  beamfield likelihood run.bag --map map.yaml --scan 200
  beamfield likelihood run.bag --map map.yaml --scan 200 --model likelihood_field --out field.png
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import inputs, options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, count, index, positive
from beamfield.cli.wording import pose_text
from beamfield.errors import FormatError, InvalidInputError, about_file

if TYPE_CHECKING:
    from beamfield.localization.likelihood_map import LikelihoodMap
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.models.base import MeasurementModel
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.models.field_parameters import LikelihoodFieldParameters
    from beamfield.sensors import Scan, SensorLog


# Without --params: a laser scanner in a building with a few people.
DEFAULTS = {"z_hit": 0.8, "z_short": 0.08, "z_max": 0.02, "z_rand": 0.1, "sigma_hit": 0.2, "lambda_short": 0.4}
# And a sonar: many echoes are lost or take a detour.
SONAR_DEFAULTS = {"z_hit": 0.5, "z_short": 0.05, "z_max": 0.2, "z_rand": 0.25, "sigma_hit": 0.1, "lambda_short": 0.4}
# Without --beams, unless a file of parameters says.
DEFAULT_BEAMS = 30
# Without --local-scans.
LOCAL_SCANS = 10
# Local maps for map matching have cells of at least this size, metres: time is proportional to their number.
LOCAL_RESOLUTION = 0.2
# The chapter's models, as other programs call those that they have too.
MODELS = {"beam": "beam model", "likelihood_field": "likelihood field", "map_matching": "map matching"}


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "likelihood", __doc__)
    parser.add_argument("log", type=Path, metavar="LOG", help=options.LOG_FORMATS)
    options.add_map(parser, required=True)
    parser.add_argument(
        "--scan", type=index, required=True, metavar="I", help="index of the scan in the log, from 0 on"
    )
    parser.add_argument("--model", choices=tuple(MODELS),
                        help="measurement model (default: that of the file, or beam)")  # fmt: skip
    options.add_poses(parser)
    options.add_params(parser, "a beam_model.yaml or likelihood_field.yaml from beamfield calibrate (default: typical "
                      "values)")  # fmt: skip
    options.add_range_table(parser)
    options.add_out(parser, "beamfield_likelihood.png", metavar="FILE", what=f"picture ({', '.join(options.PICTURES)})")
    parser.add_argument(
        "--npz", type=options.output_file, metavar="FILE", help="write the arrays into this NumPy .npz file"
    )
    lattice = parser.add_argument_group("poses that are compared")
    lattice.add_argument(
        "--resolution", type=positive, default=0.10, metavar="M", help="step in x and y (default: 0.1)"
    )
    lattice.add_argument("--headings", type=count, default=72, metavar="N", help="headings per place (default: 72)")
    lattice.add_argument("--no-widening", action="store_true",
                         help="do not widen the noise of hits by what lies between the poses")  # fmt: skip
    model = parser.add_argument_group("model")
    model.add_argument("--beams", type=index, metavar="N",
                       help="beams of the scan that count, equally spaced; 0: all (default: 30, or as the "
                       "file of --params says; with another number its exponent is scaled)")  # fmt: skip
    model.add_argument("--local-scans", type=count, metavar="N",
                       help="map matching: scans in the local map, up to this one (default: 10)")  # fmt: skip
    options.add_log(parser)
    options.add_threads(parser)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read, evaluate, draw."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.localization.likelihood_map import likelihood_map
    from beamfield.maps.range_scale import require_metres

    options.check_output(arguments.out, "out", *options.PICTURES)
    options.check_output(arguments.npz, "npz", ".npz")
    _check_model(arguments)
    arguments = argparse.Namespace(**{**vars(arguments), "model": inputs.model_of(arguments, "beam")})
    with options.progress(arguments) as progress:
        grid, sensor, notes = inputs.read_map_and_sensor(arguments, progress)
        if not grid.free.any():
            raise FormatError(arguments.map, "the map has no free cell, so there is no place to compare")
        with about_file(arguments.log):
            require_metres(sensor, grid)
        scan = _scan(sensor, arguments)
        measured, model, more = _measurement_and_model(sensor, scan, grid, arguments)
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
        wrote = _write(scan, grid, result, reference, arguments)
    document = {"scan": arguments.scan, "model": arguments.model, **_found(result, measured, model, reference)}
    line, text = f"wrote {' and '.join(map(str, wrote))}", _summary(document)
    return Outcome(line, text, document, (*notes, *more), wrote, brief=text.splitlines()[1])


def _check_model(arguments: argparse.Namespace) -> None:
    """Refuse options of another model than the one that is asked for."""
    if arguments.model == "map_matching":
        options.refuse(arguments, ("params", "no_widening"), "map matching has no noise of beams")
        if arguments.beams is not None:
            raise InvalidInputError("--beams: map matching takes all beams")
    elif arguments.local_scans is not None:
        raise InvalidInputError("--local-scans: is for --model map_matching")


def _scan(sensor: SensorLog, arguments: argparse.Namespace) -> Scan:
    """Return the scan, or say what there is instead."""
    from beamfield.sensors import usable_ranges

    number = arguments.scan
    if number >= len(sensor):
        what = f"scans 0 to {len(sensor) - 1}" if len(sensor) else "no scan"
        raise InvalidInputError(f"--scan: {arguments.log} has {what}, got {number}")
    scan = sensor.scan(number)
    ranges = usable_ranges(scan.ranges, scan.finder)
    if not (ranges < scan.finder.max_range).any():
        raise FormatError(arguments.log, f"scan {number} has no measured range")
    return scan


def _measurement_and_model(
    sensor: SensorLog, scan: Scan, grid: OccupancyGrid, arguments: argparse.Namespace
) -> tuple[Any, MeasurementModel[Any], list[str]]:
    """Return what is measured (a scan or a local map), the model that scores it, and notes on its parameters."""
    from beamfield.localization.lattice_noise import widened_field_for_lattice, widened_for_lattice
    from beamfield.maps.solids import hollowed
    from beamfield.models.beam import BeamModel
    from beamfield.models.likelihood_field import LikelihoodFieldModel
    from beamfield.models.map_matching import MapMatchingModel
    from beamfield.models.sonar import SonarModel

    table = inputs.read_range_table(arguments, grid, scan.finder)
    if arguments.model == "map_matching":
        return _local_map(sensor, grid, arguments), MapMatchingModel(grid), []
    lattice = {"resolution": arguments.resolution, "headings": arguments.headings}
    if arguments.model == "beam":
        parameters = _parameters(arguments, scan)
        more = _counting(parameters, arguments, scan)
        if not arguments.no_widening:
            parameters = widened_for_lattice(parameters, **lattice)
        if scan.finder.opening_angle > 0.0:
            return scan, SonarModel(grid, parameters, **more), []
        return scan, BeamModel(grid, parameters, caster=table, **more), []
    of_field, notes = _field(arguments, scan)
    more = _counting(of_field, arguments, scan)
    if not arguments.no_widening:
        of_field = widened_field_for_lattice(of_field, scan, **lattice)
    return scan, LikelihoodFieldModel(hollowed(grid), of_field, **more), notes


def _parameters(arguments: argparse.Namespace, scan: Scan) -> BeamParameters:
    from beamfield.models.beam_parameters import BeamParameters

    if arguments.params is None:
        return BeamParameters(**(SONAR_DEFAULTS if scan.finder.opening_angle > 0.0 else DEFAULTS))
    return inputs.read_own_beam_model(arguments.params)


def _counting(
    parameters: BeamParameters | LikelihoodFieldParameters, arguments: argparse.Namespace, scan: Scan
) -> dict[str, Any]:
    """Return how many beams of the scan count, and how much."""
    from beamfield.models.beam_parameters import SavedBeamModel
    from beamfield.models.field_parameters import SavedLikelihoodField

    if not isinstance(parameters, SavedBeamModel | SavedLikelihoodField) or parameters.n_beams is None:
        return {"n_beams": DEFAULT_BEAMS if arguments.beams is None else arguments.beams or None, "exponent": 1.0}
    if arguments.beams is None:
        return {"n_beams": parameters.n_beams, "exponent": parameters.single_scan_exponent}
    # A scan is worth about as many independent beams, however many of its beams are used.
    used = min(arguments.beams or scan.finder.n_beams, scan.finder.n_beams)
    exponent = parameters.single_scan_exponent * parameters.n_beams / used
    return {"n_beams": arguments.beams or None, "exponent": min(1.0, exponent)}


def _field(arguments: argparse.Namespace, scan: Scan) -> tuple[LikelihoodFieldParameters, list[str]]:
    """Return the parameters of the field, and what was left out."""
    from beamfield.models.beam_parameters import EXTENSIONS
    from beamfield.models.field_parameters import LikelihoodFieldParameters, SavedLikelihoodField

    if arguments.params is None:
        return LikelihoodFieldParameters.from_beam_parameters(_parameters(arguments, scan)), []
    read = inputs.read_field_or_beam_model(arguments.params)
    if isinstance(read, SavedLikelihoodField):
        return read, []
    notes = inputs.left_out_of_a_field(read, arguments.params)
    return LikelihoodFieldParameters.from_beam_parameters(read, drop=EXTENSIONS), notes


def _local_map(sensor: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace) -> OccupancyGrid:
    """Return the local map of the last scans; of this scan alone if there are no poses to join them by."""
    import numpy as np

    from beamfield.maps.mapping import local_map

    track = sensor.poses if np.isfinite(sensor.poses[arguments.scan]).all() else sensor.odometry
    joined = bool(np.isfinite(track[arguments.scan]).all())
    return local_map(
        sensor,
        arguments.scan,
        n=(arguments.local_scans or LOCAL_SCANS) if joined else 1,
        resolution=max(grid.resolution, LOCAL_RESOLUTION),
        poses=track if joined else np.zeros((len(sensor), 3)),
    )


def _write(
    scan: Scan, grid: OccupancyGrid, result: LikelihoodMap, reference: Any, arguments: argparse.Namespace
) -> list[Path]:
    """Draw the picture and write the arrays if asked for, both or none."""
    import numpy as np

    from beamfield.figures.gallery import save_figure
    from beamfield.figures.likelihood_over_map import likelihood_figure
    from beamfield.io.files.atomic import atomic_files

    wanted = [path for path in (arguments.out, arguments.npz) if path is not None]
    with atomic_files(wanted) as parts:
        for path, part in zip(wanted, parts, strict=True):
            if path is arguments.out:
                figure = likelihood_figure(scan, grid, result, reference, model_name=MODELS[arguments.model])
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
    return wanted


def _found(result: LikelihoodMap, measured: Any, model: MeasurementModel[Any], reference: Any) -> dict[str, Any]:
    """Return how much was compared, where the maximum is, and what the reference pose is worth."""
    from beamfield.geometry import between

    found: dict[str, Any] = {
        "n_poses": result.n_poses,
        "n_places": int(result.evaluated.sum()),
        "n_headings": len(result.headings),
        "resolution_m": result.resolution,
        "maximum": None,
        "rival": None,
        "reference": None,
    }
    if result.is_flat:
        return found
    top = float(result.log_likelihood[result.best_cell])
    found["maximum"] = {"pose": [float(v) for v in result.best_pose], "log_likelihood": top}
    rival = result.rival()
    if rival is not None:
        found["rival"] = {"pose": [float(v) for v in rival[0]], "below_maximum": rival[1]}
    if reference is None:
        return found
    step = between(reference, result.best_pose)
    value = float(model.log_likelihood(measured, reference))
    found["reference"] = {
        "pose": [float(v) for v in reference],
        "distance_m": float(math.hypot(step[0], step[1])),
        "turn_rad": float(abs(step[2])),
        "below_maximum": top - value if math.isfinite(value) else None,
        "share_of_likelier_places": float(result.share_above(value)),
    }
    return found


def _summary(found: Mapping[str, Any]) -> str:
    """Return in words what was found."""
    best, rival, reference = found["maximum"], found["rival"], found["reference"]
    places = f"{found['n_places']:,} places of {found['resolution_m']:g} m, {found['n_headings']} headings"
    lines = [f"compared {found['n_poses']:,} poses: {places}"]
    if best is None:
        return "\n".join([*lines, "all places are equally likely: the scan says nothing here"])
    lines.append(f"maximum: {pose_text(best['pose'])}, log p(z | x, m) = {best['log_likelihood']:.2f} nats")
    if rival is not None:
        lines.append(f"next, 1 m away or more: {pose_text(rival['pose'])}, {rival['below_maximum']:.2f} nats less")
    if reference is None:
        return "\n".join([*lines, "the scan has no reference pose to compare with"])
    lines.append(
        f"reference: {pose_text(reference['pose'])}; the maximum is {reference['distance_m']:.2f} m and "
        f"{math.degrees(reference['turn_rad']):.1f} deg away"
    )
    below = reference["below_maximum"]
    if below is None:
        lines.append("at the reference the scan is impossible: no place compared is less likely")
    elif below < 0.0:
        lines.append(f"the reference lies between the poses compared and is likelier still, by {-below:.2f} nats")
    else:
        likelier = round(reference["share_of_likelier_places"] * found["n_places"])
        lines.append(
            f"at the reference: {below:.2f} nats below the maximum; {likelier:,} of {found['n_places']:,} places "
            f"{'is' if likelier == 1 else 'are'} likelier"
        )
    return "\n".join(lines)
