"""Find the poses of a log in a map.

Fit the whole trajectory to odometry, scans and map at once: the start is searched for, stretches that cannot be trusted
are named, and so are slips of the wheels, times at which the robot was carried, and where poses of the log, such as
its filter's, leave the fitted ones. Writes the poses as TUM lines, which
--poses of other commands takes, and a picture of the same name. A trajectory that cannot be found is not written; nor
is one of two that fit equally well.

for example:

  beamfield trajectory run.bag --map map.yaml
  beamfield trajectory run.bag --map map.yaml --start 1.5 2.0 90 --out run.tum
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import inputs, options
from beamfield.cli.fitted_poses import about_its_file
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, positive
from beamfield.cli.provenance import file_name
from beamfield.errors import InvalidInputError, TooLittleDataError, TrajectoryNotFoundError

if TYPE_CHECKING:
    from beamfield.localization.trajectory import TrajectoryFit


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "trajectory", __doc__)
    parser.add_argument("log", type=Path, metavar="LOG", help=options.LOG_FORMATS)
    options.add_map(parser, required=True)
    options.add_start(parser)
    options.add_out(parser, "beamfield_trajectory.tum", metavar="FILE.tum", what="poses, beside their picture .png")
    parser.add_argument("--trusted-only", action="store_true", help="write only the poses that are trusted")
    parser.add_argument("--max-deviation", type=positive, default=0.1, metavar="M",
                        help="a position is trusted up to this standard deviation (default: 0.1)")  # fmt: skip
    options.add_log(parser)
    options.add_threads(parser)
    parser.set_defaults(poses=None)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read, fit, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.finding import worst_first
    from beamfield.io.files.atomic import atomic_files
    from beamfield.io.trajectory import write_tum
    from beamfield.localization.own_poses import compare_own_poses
    from beamfield.localization.trajectory import fit_trajectory
    from beamfield.report.trajectory_figure import draw_fit
    from beamfield.sensors import Track

    inputs.refuse_moved_map(arguments.map)
    picture = _picture(arguments)
    with options.progress(arguments) as progress:
        grid, sensor, notes = inputs.read_map_and_sensor(arguments, progress)
        try:
            fit = fit_trajectory(
                sensor, grid, start=options.start_of(arguments), progress=progress,
                max_deviation=arguments.max_deviation,
            )  # fmt: skip
        except InvalidInputError as error:
            raise about_its_file(error, arguments, arguments.log) from error
        except TooLittleDataError as error:
            raise TooLittleDataError(f"{arguments.log}: {error}") from error
        except TrajectoryNotFoundError as error:
            cones = "; the cones of a sonar are fitted as beams, which rarely works without --start X Y DEG"
            about = cones if sensor.finder.opening_angle > 0.0 and arguments.start is None else ""
            raise TrajectoryNotFoundError(f"{arguments.log}: {error}{about}") from error
        progress("writing", 0, 1)
        written = fit.trusted if arguments.trusted_only else slice(None)
        figure = draw_fit(fit, sensor, grid, f"{file_name(arguments.log)} in {file_name(arguments.map)}")
        with atomic_files([picture, arguments.out]) as (drawn, poses):
            figure.savefig(drawn, dpi=130)
            write_tum(poses, Track(fit.stamps[written], fit.poses[written]))
    own = compare_own_poses(sensor, fit)
    if own is not None:
        fit = replace(fit, findings=worst_first((*fit.findings, own)))
    return _outcome(fit, notes, [arguments.out, picture])


def _picture(arguments: argparse.Namespace) -> Path:
    from beamfield.io.files.atomic import check_writable

    options.check_output(arguments.out, "out", ".tum", ".txt")
    picture: Path = arguments.out.with_suffix(".png")
    check_writable(picture)
    return picture


def _outcome(fit: TrajectoryFit, notes: tuple[str, ...], wrote: list[Path]) -> Outcome:
    from beamfield.report.text_table import finding_line

    found = "\n".join(map(finding_line, fit.findings))
    problem = ""
    if not fit.trusted.all():
        problem = f"{(~fit.trusted).mean():.1%} of the scans are not trusted"
    elif not fit.converged:
        problem = "the fit did not converge"
    return Outcome(
        f"wrote {wrote[0]} and {wrote[1].name}", fit.summary() + (f"\n{found}" if found else ""), _document(fit), notes,
        wrote, code=3 if problem else 0, problem=problem,
        brief=f"{fit.trusted.mean():.1%} of {len(fit)} scans are trusted",
    )  # fmt: skip


def _document(fit: TrajectoryFit) -> dict[str, Any]:
    from beamfield.localization.trajectory import position_deviations

    deviations = position_deviations(fit.covariances)
    return {
        "scans": len(fit),
        "share_trusted": float(fit.trusted.mean()),
        "start": fit.poses[0].tolist(),
        "end": fit.poses[-1].tolist(),
        "deviation_m": {"median": float(sorted(deviations)[len(fit) // 2]), "largest": float(deviations.max())},
        "sigma_m": fit.sigma,
        "odometry": {"distance_scale": fit.distance_scale, "turn_scale": fit.turn_scale,
                     "turn_per_metre_rad": fit.turn_per_metre},
        "hypotheses": [{"start": one.pose.tolist(), "cost": one.cost, "share_that_agrees": one.agrees,
                        "share_through_walls": one.through} for one in fit.hypotheses],
        "findings": [asdict(finding) for finding in fit.findings],
        "converged": fit.converged,
    }  # fmt: skip
