"""A folder on this machine or in an object store, by its fsspec address: files are written whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import secrets
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from beamfield.errors import BeamfieldError, InvalidInputError, needs
from beamfield.io.files.atomic import atomic_file, remove_abandoned

# Whose uploads appear when they are complete. Elsewhere a file is uploaded under another name, and renamed.
_OBJECT_STORES = {"s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "adl", "oss", "memory"}
# Shorter values of options, as "us" or "1", say nothing, and stand in many words.
SHORTEST_SECRET = 4
_SCHEME = re.compile(r"^[a-zA-Z][a-zA-Z0-9+.-]+://")


@dataclass(frozen=True)
class Folder:
    """A folder at an fsspec address.

    Parameters
    ----------
    address
        A path, or an address such as ``s3://bucket/fleet``. What it has of secrets is used, and never shown.
    options
        Storage options for fsspec, such as ``endpoint_url``; never shown.
    """

    address: str = field(repr=False)
    options: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        return f"Folder({self.shown!r})"

    @property
    def shown(self) -> str:
        """The address without secrets, for people and records."""
        return without_secrets(self.address)

    @property
    def is_local(self) -> bool:
        """Whether it is on this machine's disks."""
        return not is_address(self.address)

    @cached_property
    def _opened(self) -> tuple[Any, str]:
        fsspec = require_fsspec()
        try:
            with self.named_errors():
                system, root = fsspec.core.url_to_fs(self.address, **self.options)
        except OSError as error:
            raise InvalidInputError(f"{self.shown}: this address cannot be opened: {error.strerror or error}") from None
        return system, root.rstrip("/")

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the connection."""
        return {"address": self.address, "options": dict(self.options)}

    @property
    def system(self) -> Any:
        """The fsspec file system."""
        return self._opened[0]

    @property
    def arrow_system(self) -> Any:
        """The file system as PyArrow takes it."""
        from pyarrow import fs

        return fs.LocalFileSystem() if self.is_local else fs.PyFileSystem(fs.FSSpecHandler(self.system))

    def path(self, name: str = "") -> str:
        """Return the path of a file in it, as the file system takes it."""
        root = self._opened[1]
        return f"{root}/{name}" if name else root

    def shown_path(self, name: str) -> str:
        """Return the address of a file in it without secrets."""
        return f"{self.shown.rstrip('/')}/{name}"

    @contextmanager
    def named_errors(self, name: str = "") -> Iterator[None]:
        """Raise what a store's program raises in its own words as an OSError, without secrets."""
        shown = self.shown_path(name) if name else self.shown
        try:
            yield
        except FileNotFoundError:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), shown) from None
        except (OSError, BeamfieldError):
            raise
        except Exception as error:
            # Without the cause, whose text is the one with secrets.
            raise OSError(errno.EIO, f"{type(error).__name__}: {self._hidden(str(error))}", shown) from None

    def _hidden(self, text: str) -> str:
        """Return a text without what is secret in the address and the options."""
        parts = urlsplit(self.address)
        secret = [self.address, parts.username, parts.password, parts.query, *_texts(self.options)]
        for one in secret:
            text = text.replace(one, "***") if one and len(one) >= SHORTEST_SECRET else text
        return text

    def exists(self, name: str) -> bool:
        """Return whether there is such a file."""
        # Another process may have written it since this file system last looked.
        with self.named_errors(name):
            self.system.invalidate_cache()
            return bool(self.system.exists(self.path(name)))

    def names(self, folder: str = "") -> list[str]:
        """Return the sorted names of the files in a folder of it; none if there is no such folder."""
        try:
            with self.named_errors(folder):
                self.system.invalidate_cache()
                found = self.system.ls(self.path(folder), detail=False)
        except FileNotFoundError:
            return []
        return sorted(str(path).rstrip("/").rpartition("/")[2] for path in found)

    def files_below(self, folder: str) -> list[str]:
        """Return the sorted paths of all files in a folder of it and in those within, but hidden ones."""
        start = len(self.path()) + 1
        with self.named_errors(folder):
            found = sorted(str(path)[start:] for path in self.system.find(self.path(folder)))
        return [path for path in found if "/." not in path]

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        with self.named_errors(name):
            return bytes(self.system.cat_file(self.path(name)))

    def read_all(self, names: Sequence[str]) -> list[bytes | None]:
        """Return the content of many files, read at once where the store can; None for those that are not there."""
        paths = [self.path(name) for name in names]
        with self.named_errors():
            found = self.system.cat(paths, on_error="return") if paths else {}
            for content in found.values():
                if isinstance(content, Exception) and not isinstance(content, FileNotFoundError):
                    raise content
        return [None if isinstance(found[path], Exception) else bytes(found[path]) for path in paths]

    def remove(self, name: str) -> None:
        """Remove a file, which another process may have removed already."""
        with suppress(FileNotFoundError), self.named_errors(name):
            self.system.rm_file(self.path(name))

    def remove_abandoned(self, folder: str) -> None:
        """Remove what killed processes left in a folder of it, if it is on this machine."""
        if self.is_local:
            remove_abandoned(Path(self.path(folder)))

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Write a file whole or not at all: yield a local path to create it at; it takes its name when it is whole."""
        if self.is_local:
            with atomic_file(self.path(name)) as part:
                yield part
            return
        with tempfile.TemporaryDirectory(prefix="beamfield-") as scratch:
            part = Path(scratch) / "part"
            yield part
            with self.named_errors(name):
                self._upload(part, name)

    def _upload(self, part: Path, name: str) -> None:
        if urlsplit(self.address).scheme in _OBJECT_STORES:
            self.system.put_file(str(part), self.path(name))
            return
        hidden = self.path(f"{name}.{secrets.token_hex(6)}.part")
        self.system.makedirs(hidden.rpartition("/")[0], exist_ok=True)
        self.system.put_file(str(part), hidden)
        self.system.mv(hidden, self.path(name))

    def write(self, name: str, content: bytes) -> None:
        """Write bytes to a file, whole or not at all."""
        with self.writing(name) as part:
            part.write_bytes(content)


def _texts(options: Any) -> Iterator[str]:
    """Yield all texts in options."""
    if isinstance(options, Mapping):
        for value in options.values():
            yield from _texts(value)
    elif isinstance(options, str):
        yield options


def is_address(path: str) -> bool:
    """Return whether a path is an fsspec address: it begins with a scheme, as s3://."""
    return _SCHEME.match(path) is not None


def without_secrets(address: str) -> str:
    """Return an address without user, password and query, which may hold keys.

    Examples
    --------
    >>> without_secrets("s3://AKIA:secret@bucket/logs/run.bag?token=abc#x")
    's3://bucket/logs/run.bag'
    >>> without_secrets("logs/run.bag")
    'logs/run.bag'
    """
    if not is_address(address):
        return address
    scheme, _, rest = address.partition("://")
    rest = re.split(r"[?#]", rest, maxsplit=1)[0]
    host, slash, path = rest.partition("/")
    return f"{scheme}://{host.rpartition('@')[2]}{slash}{path}"


def require_fsspec() -> Any:
    """Return fsspec, or say how to get it."""
    with needs("fsspec", "fleet", "a fleet's catalogue"):
        import fsspec.core
    return fsspec
