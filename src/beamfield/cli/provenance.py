"""Where a result comes from: hashes of the inputs, options, version."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from beamfield import __version__
from beamfield.printable import printable


def file_name(path: str | Path) -> str:
    r"""Return a file's name as one line that any output can hold: bytes that are no UTF-8 become ``\xe4``."""
    name = Path(path).name or Path(path).resolve().name
    return printable(os.fsencode(name).decode("utf-8", "backslashreplace"))


def file_hash(path: str | Path) -> str:
    """Return the SHA-256 of a file, or of a folder's files with their names, in hexadecimal."""
    path = Path(path)
    digest = hashlib.sha256()
    if path.is_dir():
        for item in sorted(p for p in path.rglob("*") if p.is_file()):
            digest.update(f"{item.relative_to(path).as_posix()} {file_hash(item)}\n".encode(errors="surrogateescape"))
        return digest.hexdigest()
    with path.open("rb") as file:
        while chunk := file.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()


def provenance(inputs: Iterable[tuple[str, str | Path]], options: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Return what a reader needs to repeat a result.

    Parameters
    ----------
    inputs
        (role, path) of every file read; paths are recorded by name only, as results travel.
    options
        The options in force, without paths, which say nothing elsewhere.
    seed
        The seed of every random choice.
    """
    return {
        "program": f"beamfield {__version__}",
        "inputs": {role: {"name": file_name(path), "sha256": file_hash(path)} for role, path in inputs},
        "options": dict(options),
        "seed": seed,
    }
