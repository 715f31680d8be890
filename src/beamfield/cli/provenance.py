"""Where a result comes from: hashes of the inputs, options, version."""

from __future__ import annotations

import argparse
import math
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from beamfield import __version__
from beamfield.errors import BeamfieldError
from beamfield.io.files.content_hash import file_hash
from beamfield.printable import printable

# They say where and how something is printed or computed, and change no result.
_NO_OPTIONS = (
    "animation", "command", "json", "mcap", "noticed", "out", "quiet", "rerun", "run", "seed", "threads", "verbose",
)  # fmt: skip


# Given to be written.
_WRITTEN = ("animation", "mcap", "npz", "out", "patch", "rerun")


def input_files(arguments: argparse.Namespace) -> list[Path]:
    """Return the files that a command is told to read, not to change, with the pictures of maps and all of a bag."""
    given = [value for name, value in vars(arguments).items() if name not in _WRITTEN]
    listed = [one for value in given for one in (value if isinstance(value, list) else [value])]
    paths = [one for one in listed if isinstance(one, Path)]
    for path in list(paths):
        # Here, as --list has no inputs, and does not need numerical libraries.
        from beamfield.io.read_log import files_of_folder, folder_of_log

        with suppress(OSError):  # told where it is read
            folder = folder_of_log(path)
            paths += [] if folder is None else files_of_folder(folder)
        if path.suffix in (".yaml", ".yml"):
            from beamfield.io.maps.ros_map import image_path

            with suppress(BeamfieldError, OSError):  # no map, or one whose faults are told where it is read
                if path.is_file() and b"image" in path.read_bytes():  # parsing parameters takes a tenth of a second
                    paths.append(image_path(path))
    patched = getattr(arguments, "patch", None)
    return [path for path in paths if patched is None or os.path.realpath(path) != os.path.realpath(patched)]


def file_name(path: str | Path) -> str:
    r"""Return a file's name as one line that any output can hold: bytes that are no UTF-8 become ``\xe4``."""
    name = Path(path).name or Path(path).resolve().name
    return printable(os.fsencode(name).decode("utf-8", "backslashreplace"))


def recorded(value: Any) -> Any:
    """Return a value as JSON holds it: `--no-return nan` is a number that it has no word for."""
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def provenance(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what a reader needs to repeat a result; options that were not given and have no default are left out.

    Every path given is an input, but for those that are written; paths are recorded by name only, as results travel.
    """
    from beamfield.io.maps.ros_map import image_path

    inputs: dict[str, Path] = {}
    options: dict[str, Any] = {}
    for name, value in sorted(vars(arguments).items(), key=lambda item: (item[0] not in ("log", "map"), item[0])):
        if name in _NO_OPTIONS or value is None or value == []:  # not given
            continue
        if isinstance(value, list) and value and all(isinstance(one, Path) for one in value):
            inputs.update({f"{name.replace('_', ' ')} {i}": one for i, one in enumerate(value, 1)})
            continue
        if not isinstance(value, Path):
            options[name] = [recorded(one) for one in value] if isinstance(value, tuple) else value
            continue
        inputs[name.replace("_", " ")] = value
        if name == "map" and value.suffix in (".yaml", ".yml"):
            inputs["map image"] = image_path(value)
    return {
        "program": f"beamfield {__version__}",
        "inputs": {role: {"name": file_name(path), "sha256": file_hash(path)} for role, path in inputs.items()},
        "options": options,
        "seed": arguments.seed,
    }
