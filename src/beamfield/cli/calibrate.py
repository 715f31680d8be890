"""Learn a sensor model from a log and a map.

Learn the parameters of the beam model (z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short) from a log and a map,
and with --map those of the likelihood field. A log without reference poses gets them first: they are fitted to the map,
by every other beam, and the beams between are judged. Prints tables and writes beam_model.yaml, likelihood_field.yaml,
calibration.json and report.html into the output folder, whole or not at all.

for example:

  beamfield calibrate run.bag --map map.yaml --out result
  beamfield calibrate run.bag --map map.yaml --stack nav2 --patch nav2_params.yaml
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import inputs, options
from beamfield.cli.calibrate_stack import add_stack_options, next_step, read_stack_request, write_patch
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, not_negative, positive
from beamfield.cli.provenance import input_files, provenance
from beamfield.cli.recordings import add_recordings, beam_recording, check_recordings, wants_recording, write_recordings
from beamfield.cli.terminal import filled
from beamfield.errors import InvalidInputError
from beamfield.printable import printable

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import CalibrationOptions
    from beamfield.sensors import ScanLog, SensorLog

ODOMETRY_NOTE = "reference poses: the odometry of the log, as asked for; its drift counts as noise of the sensor"
# How wrong reference poses may be if nobody says so, metres.
REFERENCE_ERROR = 0.04
# Whether a parameter beyond the chapter's is learned.
SWITCH = ("auto", "on", "off")


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "calibrate", __doc__)
    parser.add_argument("log", type=Path, metavar="LOG", help=options.LOG_FORMATS)
    options.add_map(parser, what="the map; without it, two are drawn from the log")
    parser.add_argument("--resolution", type=positive, metavar="M", help="side of a cell of drawn maps (default: 0.05)")
    options.add_poses(parser, fitted=True)
    parser.add_argument("--odometry", action="store_true",
                        help="without --map: the log's odometry as reference poses; drift counts as noise")  # fmt: skip
    options.add_out(parser, "beamfield_calibration", metavar="DIR", what="output folder")
    options.add_log(parser, several=True)
    model = parser.add_argument_group("model")
    model.add_argument("--unknown", choices=("skip", "free", "occupied"), default="skip",
                       help="rays that enter unknown cells: leave them out, pass, or stop (default: skip)")  # fmt: skip
    kept = "keeps it only if it improves held-out likelihood (default: auto)"
    model.add_argument("--range-offset", choices=SWITCH, default="auto", help=f"constant range bias: auto {kept}")
    model.add_argument("--sigma-slope", choices=SWITCH, default="auto", help=f"sigma growing with range: auto {kept}")
    model.add_argument("--hold", type=_held, action="append", default=[], metavar="NAME=VALUE",
                       help="do not learn this parameter; repeatable")  # fmt: skip
    model.add_argument("--block", type=positive, metavar="S", help="length of the blocks of time that are fitted or "
                       "held out (default: 20, or a twelfth of a shorter log)")  # fmt: skip
    model.add_argument("--reference-error", type=float, metavar="M",
                       help="exponents, likelihood field and --stack: how wrong the reference poses may be, standard "
                       "deviation per axis, and a quarter of it in radians (default: 0.04; of fitted poses, what the "
                       "fit says, at least half a cell of the map)")  # fmt: skip
    model.add_argument("--no-refine", action="store_true", help="do not refine reference poses to see their error")
    options.add_seed(model)
    choice = parser.add_argument_group("scans that are used")
    choice.add_argument("--min-travel", type=not_negative, metavar="M",
                        help="least motion since the last scan used (default: 0.02)")  # fmt: skip
    choice.add_argument("--min-turn", type=not_negative, metavar="DEG", help="or least turn (default: 1.15)")
    choice.add_argument("--max-turn-rate", type=positive, metavar="DEG/S",
                        help="drop scans in faster turns (default: 86)")  # fmt: skip
    parser.add_argument("--odometry-noise", action="store_true",
                        help="learn systematic errors and noise of the odometry too, for motion models")  # fmt: skip
    add_stack_options(parser)
    add_recordings(parser)
    options.add_threads(parser)


def run(arguments: argparse.Namespace) -> Outcome:
    """Parse, read, calibrate, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.cli.calibrate_sensor import CalibrationJob
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable
    from beamfield.stacks.files.calibration_record import MOVED_MAP

    error_is_given = arguments.reference_error is not None
    if not error_is_given:
        arguments = argparse.Namespace(**{**vars(arguments), "reference_error": REFERENCE_ERROR})
    _check(arguments)
    inputs.refuse_moved_map(arguments.map)
    check_folder_writable(arguments.out, "beam_model.yaml", "likelihood_field.yaml", "calibration.json", "report.html")
    check_recordings(arguments)
    learning = _options(arguments)
    patched = read_stack_request(arguments)
    if arguments.stack is not None:
        _check_stack_files(arguments)
    with options.progress(arguments) as progress:
        grid = None
        if arguments.map is not None:
            progress("reading the map", 0, 1)
            grid = inputs.read_walls(arguments)
        progress("reading the log", 0, 1)
        log = inputs.read_scans(arguments)
        sensors = _chosen_sensors(log, arguments)
        if patched is not None and len(sensors) > 1:
            raise InvalidInputError(
                "--patch: one file cannot hold the parameters of several sensors; choose one with --sensor"
            )
        unread = () if patched is None else patched.unread
        notes = (*log.notes, *([ODOMETRY_NOTE] if arguments.odometry else []), *unread)
        job = CalibrationJob(
            arguments, grid, learning, provenance(arguments), notes, patched, progress, error_is_given=error_is_given
        )
        results = {name: job.learn(sensor) for name, sensor in sensors.items()}
    first, folders = next(iter(results.values())), _folders(results)
    with atomic_folder(arguments.out) as folder:
        for name, result in results.items():
            place = folder / folders[name]
            place.mkdir(exist_ok=True)
            for file_name, content in result.files.items():
                (place / file_name).write_bytes(content if isinstance(content, bytes) else content.encode())
        recorded = [] if grid is None else write_recordings(arguments, partial(beam_recording, *first.learned, grid))
    if arguments.stack is not None:
        maps = [
            arguments.out / folders[name] / MOVED_MAP for name, one in results.items() if MOVED_MAP not in one.files
        ]
        notes += tuple(f"{path}: of an earlier run; these values do not go with it" for path in maps if path.exists())
    line = ", ".join([f"wrote {', '.join(first.files)} into {arguments.out}", *map(str, recorded)])
    verdicts = [(result.stack or result).document["verdict"] for result in results.values()]
    brief = "; ".join(verdicts)
    if patched is not None and first.stack is not None:
        changed, backup = write_patch(patched, first.stack)
        line, brief = f"{line}\n{changed}", f"{brief.removesuffix('.')}; {changed}"
        if backup is not None and (step := next_step(arguments, backup, first.stack, patched)):
            line += f"\n{step}"
    heads = {name: f"== {printable(name)}\n" if len(results) > 1 else "" for name in results}
    # The answer comes last, where it is seen without scrolling.
    tables = [f"{heads[name]}{result.table}" for name, result in results.items()]
    answers = [f"{heads[name]}{filled(said)}" for name, said in zip(results, verdicts, strict=True)]
    problems = [problem for result in results.values() for problem in result.problems]
    return Outcome(
        line,
        "\n\n".join([*tables, *answers]),
        {"sensors": {name: result.document for name, result in results.items()}},
        notes,
        [arguments.out, *recorded],
        3 if problems else 0,
        "; ".join(problems),
        brief,
    )


def _check(arguments: argparse.Namespace) -> None:
    if arguments.start is not None and (arguments.map is None or arguments.poses is not None):
        raise InvalidInputError("--start: is for poses that are fitted to a map: give --map, and no --poses")
    if wants_recording(arguments) and (arguments.map is None or len(arguments.sensor or ()) > 1):
        raise InvalidInputError("--rerun, --mcap: show one sensor in a map: give --map, and one --sensor")
    if arguments.odometry and (arguments.map is not None or arguments.poses is not None):
        raise InvalidInputError("--odometry: only without --map and --poses: odometry is not in the map's frame")
    if arguments.odometry and arguments.odometry_noise:
        raise InvalidInputError("--odometry-noise: needs reference poses that are not the odometry: drop --odometry")
    if arguments.map_topic is not None and arguments.map is None:
        raise InvalidInputError(
            f"--map-topic: is in the bag that --map names; for LOG's own map, --map {arguments.log}"
        )
    if arguments.map is not None and arguments.resolution is not None:
        raise InvalidInputError("--resolution: is for maps drawn from the log, but --map gives one")


def _check_stack_files(arguments: argparse.Namespace) -> None:
    """Refuse an output folder where the stack's new files would replace the file to patch, or another input."""
    from beamfield.io.files.atomic import check_folder_writable, kept_files
    from beamfield.stacks.files.calibration_record import MOVED_MAP, MOVED_PICTURE
    from beamfield.stacks.registry import STACKS

    # The file to patch is changed in the end, but not by a new file of the same name.
    patched = [] if arguments.patch is None else [arguments.patch]
    with kept_files([*input_files(arguments), *patched]):
        own = f"{arguments.stack}.{STACKS[arguments.stack].syntax}"
        check_folder_writable(arguments.out, own, MOVED_MAP, MOVED_PICTURE)


def _options(arguments: argparse.Namespace) -> CalibrationOptions:
    from beamfield.calibration.calibrate import CalibrationOptions
    from beamfield.calibration.selection import SelectionOptions
    from beamfield.models.beam_parameters import BeamParameters

    names = list(BeamParameters.__dataclass_fields__)
    if unknown := [name for name, _ in arguments.hold if name not in names]:
        raise InvalidInputError(f"--hold: expected a name among {', '.join(names)}, got {unknown[0]!r}")
    given = {
        "min_travel": arguments.min_travel,
        "min_turn": options.radians(arguments.min_turn),
        "max_turn_rate": options.radians(arguments.max_turn_rate),
    }
    return CalibrationOptions(
        selection=SelectionOptions(**{name: value for name, value in given.items() if value is not None}),
        unknown=arguments.unknown,
        block_s=arguments.block,
        range_offset=arguments.range_offset,
        sigma_slope=arguments.sigma_slope,
        hold=dict(arguments.hold),
        refine=not arguments.no_refine,
        seed=arguments.seed,
    )


def _held(word: str) -> tuple[str, float]:
    name, _, value = word.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected NAME=NUMBER, got {word!r}") from None


def _chosen_sensors(log: ScanLog, arguments: argparse.Namespace) -> Mapping[str, SensorLog]:
    """Return the sensors to calibrate, those asked for or the only one; without a map, with the poses asked for."""
    names: list[Any] = arguments.sensor or list(log.sensors)
    if not arguments.sensor:
        inputs.require_one_sensor(log, arguments.log)
    logs = {name: log.only_sensor(name) for name in names}
    if arguments.map is not None:  # poses that are missing will be fitted to it
        return logs
    return {name: inputs.require_poses(sensor, arguments) for name, sensor in logs.items()}


def _folders(sensors: Iterable[str]) -> dict[str, str]:
    """Return the folder of each sensor's files: of one sensor the output folder, of several one each of their name."""
    names = list(sensors)
    if len(names) == 1:
        return {names[0]: "."}
    folders: dict[str, str] = {}
    for name in names:
        folder = "".join(c if c.isalnum() or c in "-_." else "_" for c in name.strip("/.")) or "sensor"
        while folder in folders.values():  # /front/scan and /front_scan
            folder += "_"
        folders[name] = folder
    return folders
