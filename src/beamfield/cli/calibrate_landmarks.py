"""Learn a landmark sensor's noise and biases.

Learn sigma, bias and spurious rate of a sensor that sees landmarks (tags, reflectors, radio or infrared beacons) from
sightings of known landmarks at known poses. SIGHTINGS is a CSV file with the columns stamp,x,y,theta,id,range,bearing;
leave empty what was not measured.

for example:

  beamfield calibrate-landmarks seen.csv --landmarks tags.csv
  beamfield calibrate-landmarks seen.csv --landmarks tags.csv --mount 0.2 0 90 --out camera.yaml
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, count, positive
from beamfield.cli.provenance import provenance
from beamfield.cli.wording import in_options
from beamfield.errors import FormatError, about_file
from beamfield.printable import printable

if TYPE_CHECKING:
    from beamfield.detection_log import DetectionLog
    from beamfield.landmark_noise.learning import LandmarkLearningResult
    from beamfield.maps.landmarks import LandmarkMap


# Whether a scale is learned: None lets the held-out sightings decide.
SCALE = {"auto": None, "on": True, "off": False}


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "calibrate-landmarks", __doc__)
    parser.add_argument("sightings", type=Path, metavar="SIGHTINGS", help="the sightings, see above")
    parser.add_argument("--landmarks", type=Path, metavar="FILE", required=True,
                        help="where the landmarks are, CSV file: id,x,y")  # fmt: skip
    options.add_out(parser, "beamfield_landmarks.yaml", metavar="FILE", what="parameter file to write")
    options.add_mount(parser, " (default: 0 0 0)", (0.0, 0.0, 0.0))
    parser.add_argument("--scale", choices=tuple(SCALE), default="auto", help="scale of ranges: auto keeps it only if "
                        "it improves held-out likelihood (default: auto)")  # fmt: skip
    parser.add_argument("--max-range", type=positive, metavar="M", help="the sensor's limit (default: largest range)")
    parser.add_argument("--block", type=positive, metavar="S", help="length of the blocks of time for intervals "
                        "(default: a 24th of the log's duration)")  # fmt: skip
    parser.add_argument("--replicates", type=count, default=200, metavar="N", help="bootstrap samples (default: 200)")
    options.add_seed(parser)
    options.add_threads(parser)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read, learn, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.files.atomic import check_writable, write_file
    from beamfield.io.files.bag_storage import BAG_SUFFIXES
    from beamfield.io.parameters.landmark_model_file import landmark_model_text
    from beamfield.io.read_sightings_log import read_sightings_log
    from beamfield.landmark_noise.learning import learn_landmark_parameters

    check_writable(arguments.out)
    if arguments.sightings.suffix in BAG_SUFFIXES:
        raise FormatError(
            arguments.sightings,
            "sightings are not read from bags: write them into a CSV file with the header "
            "stamp,x,y,theta,id,range,bearing",
        )
    with options.progress(arguments) as progress:
        progress("reading", 0, 1)
        landmarks, log = read_sightings_log(arguments.sightings, arguments.landmarks)
        _check_ids(landmarks, log, arguments)
        progress("learning", 0, 1)
        with about_file(arguments.sightings):
            result = learn_landmark_parameters(
                landmarks,
                log,
                mount=options.mount(arguments),
                fit_scale=SCALE[arguments.scale],
                max_range=arguments.max_range,
                block_s=arguments.block,
                n_replicates=arguments.replicates,
                seed=arguments.seed,
                progress=lambda done, total: progress("intervals", done, total),
            )
    text = landmark_model_text(result.parameters, intervals=result.intervals, provenance=provenance(arguments))
    write_file(arguments.out, text)
    problem = "" if result.converged else "the fit did not converge"
    if wrong := [finding.name for finding in result.findings if finding.severity == "error"]:
        problem = f"the parameters are not to be used: {', '.join(wrong)}"
    return Outcome(
        f"wrote {arguments.out}", in_options(_summary(result)), _as_dict(result), log.notes, [arguments.out],
        3 if problem else 0, problem,
    )  # fmt: skip


def _check_ids(landmarks: LandmarkMap, log: DetectionLog, arguments: argparse.Namespace) -> None:
    """Refuse the first sighting of a landmark that is not in --landmarks, by its line."""
    from beamfield.detections import SPURIOUS, UNKNOWN
    from beamfield.io.files.text_lines import word_lines

    known = {*landmarks.ids.tolist(), SPURIOUS, UNKNOWN}
    if all(known.issuperset(seen.ids.tolist()) for seen in log.detections if seen.ids is not None):
        return
    _, *rows = word_lines(arguments.sightings, ",")
    row = next(row for row in rows if row.words[4] and int(row.words[4]) not in known)
    text = f"landmark {row.words[4]} is not in {arguments.landmarks}: add it there, or leave the id empty"
    raise row.error(text, "id")


def _summary(result: LandmarkLearningResult) -> str:
    from beamfield.report.landmark_table import landmark_parameter_table
    from beamfield.report.text_table import finding_line

    lines = [f"{result.n_sightings} sightings in {result.n_blocks} blocks\n", landmark_parameter_table(result)]
    if result.findings:
        lines.append("")
    lines += [finding_line(finding, printable) for finding in result.findings]
    return "\n".join(lines)


def _as_dict(result: LandmarkLearningResult) -> dict[str, Any]:
    from beamfield.report.as_json import plain

    return {
        "parameters": plain(result.parameters),
        "intervals_95": plain(result.intervals),
        "n_sightings": result.n_sightings,
        "n_blocks": result.n_blocks,
        "converged": result.converged,
        "findings": [plain(finding) for finding in result.findings],
    }
