"""Files of any address as files on this machine, for readers that know nothing else."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from beamfield.fleet.folder import Folder, is_address
from beamfield.io.files.yaml_file import read_yaml


@contextmanager
def local_copy(address: str, options: Mapping[str, Any]) -> Iterator[Path]:
    """Yield a path under which a file or folder can be read while the block runs.

    A path is yielded as it is, an fsspec address is copied. With a map's YAML file comes the picture that it names.
    Errors name file and address without secrets.
    """
    if not is_address(address):
        yield Path(address)
        return
    parent, _, name = urlsplit(address).path.rstrip("/").rpartition("/")
    folder = Folder(address[: address.rindex(name)] if parent or name else address, options)
    with tempfile.TemporaryDirectory(prefix="beamfield-") as scratch:
        copy = Path(scratch) / name
        _fetch(folder, name, copy)
        if copy.suffix in (".yaml", ".yml"):
            picture = read_yaml(copy).text("image")
            # The last part alone: a hostile name leads nowhere else on this machine.
            _fetch(folder, picture, copy.parent / Path(picture).name)
        yield copy


def _fetch(folder: Folder, name: str, copy: Path) -> None:
    system, path = folder.system, folder.path(name)
    with folder.named_errors(name):
        if system.isdir(path):
            system.get(f"{path}/", f"{copy}/", recursive=True)
        else:
            system.get_file(path, str(copy))
