"""``beamfield calibrate-landmarks``: learn a landmark sensor's noise and biases from sightings with true poses."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli.progress import StageProgress
from beamfield.cli.provenance import provenance
from beamfield.cli.terminal import say
from beamfield.cli.wording import in_options
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.printable import printable

if TYPE_CHECKING:
    from beamfield.landmark_noise.learning import LandmarkLearningResult

DESCRIPTION = """
Learn sigma, bias and spurious rate of a sensor that sees landmarks (tags, reflectors, radio or infrared beacons) from
sightings of known landmarks at known poses. SIGHTINGS is a CSV file (stamp,x,y,theta,id,range,bearing; leave empty what
was not measured) with --map, an MRCLAM or Plaza .mat file, Robot*_Measurement.dat of MRCLAM beside its
Robot*_Groundtruth.dat, Barcodes.dat and Landmark_Groundtruth.dat, or a folder with landmark.csv and (Xa,Yb).csv.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser(
        "calibrate-landmarks", help="learn a landmark sensor's noise and biases", description=DESCRIPTION
    )
    parser.add_argument("sightings", type=Path, metavar="SIGHTINGS", help="the sightings, see above")
    parser.add_argument("--map", type=Path, metavar="FILE", help="CSV file of landmarks: id,x,y")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the parameters into this YAML file")
    parser.add_argument("--mount", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "YAW_DEG"),
                        help="the sensor's pose on the robot, metres and degrees (default: 0 0 0)")  # fmt: skip
    parser.add_argument(
        "--scale",
        choices=("auto", "yes", "no"),
        default="auto",
        help="learn a scale of ranges: where held-out sightings ask for it, yes, no (default: auto)",
    )
    parser.add_argument("--truncated-at", type=float, nargs=2, metavar=("M", "RAD"),
                        help="outliers beyond these residuals were taken out of the log before")  # fmt: skip
    parser.add_argument("--max-range", type=float, metavar="M", help="limit of the sensor (default: largest range)")
    parser.add_argument(
        "--block",
        type=float,
        metavar="S",
        help="length of the blocks for intervals (default: the log's places, or a 24th of its duration)",
    )
    parser.add_argument("--replicates", type=int, default=200, metavar="N", help="bootstrap samples (default: 200)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the bootstrap (default: 0)")
    parser.add_argument("--threads", type=int, help="processors to use (default: all)")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Read, learn, write, say."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.files.atomic import check_writable, write_file
    from beamfield.io.parameters.landmark_model_file import landmark_model_text
    from beamfield.io.read_sightings_log import read_sightings_log
    from beamfield.landmark_noise.learning import learn_landmark_parameters

    if arguments.out is not None:
        check_writable(arguments.out)
    with StageProgress(quiet=arguments.quiet) as progress:
        progress("reading", 0, 1)
        landmarks, log = read_sightings_log(arguments.sightings, arguments.map)
        progress("learning", 0, 1)
        try:
            result = learn_landmark_parameters(
                landmarks,
                log,
                mount=(*arguments.mount[:2], math.radians(arguments.mount[2])),
                fit_scale={"auto": None, "yes": True, "no": False}[arguments.scale],
                truncated_at=None if arguments.truncated_at is None else tuple(arguments.truncated_at),
                max_range=arguments.max_range,
                block_s=arguments.block,
                n_replicates=arguments.replicates,
                seed=arguments.seed,
                progress=lambda done, total: progress("intervals", done, total),
            )
        except (InvalidInputError, TooLittleDataError) as error:
            raise type(error)(f"{arguments.sightings}: {error}") from error
    say(in_options(_summary(result, log.notes)))
    if arguments.out is not None:
        text = landmark_model_text(result.parameters, intervals=result.intervals, provenance=_provenance(arguments))
        write_file(arguments.out, text)
        say(f"wrote {arguments.out}")
    return 0 if result.converged else 3


def _summary(result: LandmarkLearningResult, notes: tuple[str, ...]) -> str:
    from beamfield.report.landmark_table import landmark_form_table, landmark_parameter_table

    lines = [f"note: {printable(note)}" for note in notes]
    lines.append(f"{result.n_sightings} sightings in {result.n_blocks} blocks\n")
    lines.append(landmark_parameter_table(result))
    forms = landmark_form_table(result)
    if forms:
        lines += ["", forms]
    if result.findings:
        lines.append("")
    lines += [f"{finding.severity} ({finding.name}): {printable(finding.text)}" for finding in result.findings]
    return "\n".join(lines)


def _provenance(arguments: argparse.Namespace) -> dict[str, Any]:
    inputs = [("sightings", arguments.sightings)]
    if arguments.map is not None:
        inputs.append(("map", arguments.map))
    files = {"sightings", "map", "out", "run", "quiet", "threads", "seed"}
    given = {name: value for name, value in sorted(vars(arguments).items()) if name not in files}
    given["mount"] = list(given["mount"])
    return provenance(inputs, given, arguments.seed)
