"""One input: the files that a reader gets, and which of them it is given."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path


@dataclass(frozen=True)
class Case:
    """Files of one input.

    Parameters
    ----------
    files
        Content by name; names may have folders.
    entry
        What the reader is given: one of the names, or "." for the folder.
    fixed
        Names of files that are not mutated.
    """

    files: Mapping[str, bytes]
    entry: str
    fixed: frozenset[str] = frozenset()

    @property
    def loose(self) -> tuple[str, ...]:
        """Names of the files that may be mutated."""
        return tuple(name for name in self.files if name not in self.fixed)

    @property
    def n_bytes(self) -> int:
        return sum(map(len, self.files.values()))

    def changed(self, name: str, content: bytes) -> Case:
        return replace(self, files={**self.files, name: content})

    def write(self, folder: Path) -> Path:
        """Write the files into a folder that holds nothing else, and return what the reader is given."""
        clear(folder)
        for name, content in self.files.items():
            path = folder / name
            if "/" in name:
                path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return folder / self.entry

    @classmethod
    def read(cls, folder: Path, entry: str) -> Case:
        """Return the case that lies in a folder."""
        paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        return cls({str(path.relative_to(folder)): path.read_bytes() for path in paths}, entry)


def one_file(name: str, content: bytes | str) -> Case:
    """Return a case of a single file."""
    return Case({name: content.encode() if isinstance(content, str) else content}, name)


def clear(folder: Path) -> None:
    """Remove everything from a folder; create it if it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
