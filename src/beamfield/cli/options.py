"""The options that commands share, spelt once."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from beamfield.cli.parser import count, finite, index, not_negative, positive
from beamfield.cli.progress import StageProgress
from beamfield.errors import InvalidInputError

# Not `SUPPORTED` of `beamfield.io.read_log`: that loads the numerical libraries, and --help is to answer at once.
LOG_FORMATS = (
    "CARMEN, Wean Hall, GMapping, g2o or CoreSLAM text, plain or .gz; a folder with measurement.txt and poses.txt; "
    "ROS 1 .bag; ROS 2 folder, .db3 or .mcap"
)
MAP_FORMATS = "map_server .yaml, Wean .dat, or a bag"
PICTURES = (".png", ".svg", ".pdf")
# A new folder of such a name is a misunderstanding.
FILES = (*PICTURES, ".gif", ".html", ".tum", ".csv", ".json", ".yaml", ".yml", ".mcap", ".bag", ".log", ".txt", ".gz")
# What `add_log` adds, and what it is if it was not given.
_READING_THE_LOG: dict[str, Any] = {
    "sensor": None,
    "poses_topic": None,
    "map_frame": None,
    "base_frame": None,
    "mount": None,
    "no_return": "detect",
    "max_range": None,
    "min_range": None,
    "mask": [],
    "opening_angle": None,
    "stamps": "file",
    "lone_poses": "reference",
}
# No range sensor of a robot reaches so many metres: millimetres do.
MOST_REACH = 1000.0


class PoseAction(argparse.Action):
    """Stores x, y and an angle, which is refused beyond a full turn; later on the error would speak of radians."""

    def __call__(self, _parser: Any, namespace: argparse.Namespace, values: Any, _option: str | None = None) -> None:
        """Store three numbers."""
        if abs(values[2]) > 360.0:
            raise argparse.ArgumentError(self, f"expected an angle of at most 360 degrees, got {values[2]:g}")
        setattr(namespace, self.dest, values)


def add_out(parser: argparse.ArgumentParser, default: str | None, *, metavar: str, what: str) -> None:
    """Add --out; a command that is there to write has a default, one that answers a question has none."""
    stated = "" if default is None else " (default: %(default)s)"
    kind = _folder if metavar == "DIR" else output_file
    parser.add_argument("-o", "--out", type=kind, default=default and Path(default), metavar=metavar,
                        help=f"{what}; files of the same name are replaced{stated}")  # fmt: skip


def add_map(parser: argparse.ArgumentParser, *, required: bool = False, what: str = "") -> None:
    """Add --map and --map-topic."""
    parser.add_argument(
        "--map", type=Path, required=required, metavar="MAP", help=f"{what or 'the map'}: {MAP_FORMATS}"
    )
    parser.add_argument("--map-topic", metavar="TOPIC", help="topic of the map in a bag (default: the only one)")


def add_poses(parser: argparse.ArgumentParser, *, fitted: bool = False) -> None:
    """Add --poses, and --start if they can be fitted to a map."""
    otherwise = ", or else fitted to the map" if fitted else ""
    parser.add_argument("--poses", type=Path, metavar="FILE",
                        help=f"reference poses: TUM or CSV file (default: those in the log{otherwise})")  # fmt: skip
    if fitted:
        add_start(parser, "for a log without reference poses, ")


def add_start(parser: argparse._ActionsContainer, when: str = "") -> None:
    """Add --start."""
    said = f"{when}where the log begins, to about 2 m and 45 degrees (default: searched)"
    parser.add_argument("--start", type=finite, action=PoseAction, nargs=3, metavar=("X", "Y", "DEG"), help=said)


def start_of(arguments: argparse.Namespace) -> tuple[float, float, float] | None:
    """Return --start in metres and radians."""
    if arguments.start is None:
        return None
    x, y, degrees = arguments.start
    return x, y, math.radians(degrees)


def add_params(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --params."""
    parser.add_argument("--params", type=Path, metavar="FILE", help=what)


def add_range_table(parser: argparse._ActionsContainer) -> None:
    """Add --range-table."""
    parser.add_argument("--range-table", type=Path, metavar="FILE",
                        help="look expected ranges up in this table of beamfield precompute, with --model beam "
                        "(default: cast rays, which is exact)")  # fmt: skip


def add_whose_files(parser: argparse.ArgumentParser, *, model: bool = False) -> None:
    """Add --stack and --section for parameter files of other programs, and --model if another than theirs will do."""
    group = parser.add_argument_group("parameter files of other programs")
    group.add_argument("--stack", metavar="NAME", help="nav2, ros1, beluga, mrpt or f1tenth (default: find out)")
    if model:
        group.add_argument("--model", metavar="NAME", help="measurement model (default: as the file says)")
    group.add_argument("--section", metavar="LABEL",
                       help="which section, if several have such parameters; its line will do")  # fmt: skip


def add_seed(parser: argparse._ActionsContainer, default: int = 0) -> None:
    """Add --seed."""
    parser.add_argument("--seed", type=index, default=default, metavar="N",
                        help="seed of every random choice (default: %(default)s)")  # fmt: skip


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add --threads."""
    parser.add_argument("--threads", type=count, metavar="N", help="processors to use (default: all)")


def add_mount(parser: argparse._ActionsContainer, what: str, default: tuple[float, ...] | None = None) -> None:
    """Add --mount."""
    parser.add_argument("--mount", type=finite, action=PoseAction, nargs=3, default=default, metavar=("X", "Y", "YAW"),
                        help=f"the sensor's pose on the robot, metres and degrees{what}")  # fmt: skip


def add_log(parser: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add the options that say how a log is read, of several sensors or of one."""
    group = parser.add_argument_group("reading the log")
    repeatable = "; repeatable" if several else ""
    group.add_argument("--sensor", action="append", metavar="NAME",
                       help=f"scan topic or sensor{repeatable} (default: the only one)")  # fmt: skip
    group.add_argument("--poses-topic", metavar="TOPIC", help="topic of the reference poses in the bag "
                       "(default: tf from the map, or a topic named as truth)")  # fmt: skip
    group.add_argument("--map-frame", metavar="FRAME", help="name of the map frame in tf (default: map)")
    group.add_argument("--base-frame", metavar="FRAME",
                       help="name of the robot's frame in tf (default: base_link or base_footprint)")  # fmt: skip
    add_mount(group, ", for a bag without /tf_static")
    group.add_argument("--no-return", type=_no_return, default="detect", metavar="detect|none|V[,V...]",
                       help="values (metres) that mean 'no return' besides +inf (default: detect)")  # fmt: skip
    group.add_argument("--max-range", type=_reach, metavar="M", help="the sensor's limit, if the log is wrong about it")
    group.add_argument("--min-range", type=not_negative, metavar="M",
                       help="shortest range that counts (default: as the log says)")  # fmt: skip
    group.add_argument("--mask", type=_sector, action="append", default=[], metavar="DEG:DEG",
                       help="bearings, counter-clockwise, whose readings do not count, as --mask=-170:-155; "
                       "repeatable")  # fmt: skip
    group.add_argument("--opening-angle", type=_opening_angle, metavar="DEG",
                       help="full width of a sonar's cones, if the log does not say it; 0: beams")  # fmt: skip
    group.add_argument("--stamps", choices=("file", "order"), default="file",
                       help="text logs: the file's stamps, or scans one second apart (default: file)")  # fmt: skip
    group.add_argument("--lone-poses", choices=("reference", "odometry"), default="reference",
                       help="text logs with one pose per scan: what it is (default: reference)")  # fmt: skip
    add_unpacking(group)


def add_unpacking(group: argparse._ActionsContainer) -> None:
    """Add --max-unpacked, which is for all files that a command reads."""
    group.add_argument("--max-unpacked", type=positive, metavar="GB",
                       help="gigabytes that a bag may unpack to (default: 500 times its size, 1 a chunk)")  # fmt: skip


def progress(arguments: argparse.Namespace) -> StageProgress:
    """Return the progress that the command line asks for."""
    return StageProgress(quiet=arguments.quiet, verbose=arguments.verbose)


def mount(arguments: argparse.Namespace) -> tuple[float, float, float]:
    """Return --mount in metres and radians."""
    x, y, yaw = arguments.mount
    return x, y, math.radians(yaw)


def check_output(path: Path | None, option: str, *endings: str) -> None:
    """Refuse now a file that could not be written after the work, or by its name's ending is no such file."""
    from beamfield.io.files.atomic import check_writable

    if path is None:
        return
    if path.suffix.lower() not in endings:
        *most, last = endings
        known = f"{', '.join(most)} or {last}" if most else last
        raise InvalidInputError(f"--{option}: expected a name ending in {known}, got {path.name!r}")
    check_writable(path)


def refuse(arguments: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """Refuse options, by their names in the arguments, that were given and mean nothing here."""
    for name in names:
        if getattr(arguments, name) not in (None, False):
            raise InvalidInputError(f"--{name.replace('_', '-')}: {why}")


def refuse_reading(arguments: argparse.Namespace, why: str) -> None:
    """Refuse the options of `add_log` where no log is read; --max-unpacked is for maps in bags as well."""
    for name, usual in _READING_THE_LOG.items():
        if getattr(arguments, name) != usual:
            raise InvalidInputError(f"--{name.replace('_', '-')}: {why}")


def output_file(text: str) -> Path:
    """Return what to write; refuse names that mean something else to other programs."""
    if text == "-":
        raise argparse.ArgumentTypeError("expected a name, not stdout; ./- is a file of this name")
    path = Path(text)
    # Else a folder would be made that `rm -r ~` does not mean.
    if text == "~" or (text.startswith("~") and len(path.parts) > 1):
        raise argparse.ArgumentTypeError(
            f"only the shell knows ~, and not after =: write $HOME, or ./~ for a folder of this name; got {text!r}"
        )
    return path


def _folder(text: str) -> Path:
    path = output_file(text)
    if path.suffix.lower() in FILES and not path.exists():
        raise argparse.ArgumentTypeError(f"expected a folder to write files into, got {path.name!r}")
    return path


def _no_return(text: str) -> str | tuple[float, ...]:
    try:
        return text if text in ("detect", "none") else tuple(float(word) for word in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected detect, none or numbers, got {text!r}") from None


def _sector(text: str) -> str:
    """Check a sector; what was typed is recorded."""
    try:
        holds = all(math.isfinite(value) for value in sector_radians(text))
    except ValueError:
        holds = False
    if not holds:
        raise argparse.ArgumentTypeError(f"expected DEG:DEG, got {text!r}")
    return text


def sector_radians(sector: str) -> tuple[float, float]:
    """Return the first and the last bearing of a sector of the command line."""
    first, last = (math.radians(float(word)) for word in sector.split(":"))
    return first, last


def _reach(text: str) -> float:
    metres = positive(text)
    if metres > MOST_REACH:
        raise argparse.ArgumentTypeError(f"expected metres, at most {MOST_REACH:g}, got {text!r}")
    return metres


def _opening_angle(text: str) -> float:
    degrees = not_negative(text)
    if degrees >= 180.0:
        raise argparse.ArgumentTypeError(f"expected an angle below 180 degrees, got {text!r}")
    return degrees


def radians(degrees: float | None) -> float | None:
    """Return an angle of the command line as the library takes it."""
    return None if degrees is None else math.radians(degrees)
