"""Write files whole or not at all: an error, or a kill, never leaves half a result under the final name.

New content is written in a scratch folder beside its target, which nobody else can open, and renamed when it is
whole. The folder is locked while its run lives. What a killed run leaves is removed by the next run that writes the
same target and gets the lock; where folders cannot be locked (Windows, some network disks), it stays.
"""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import secrets
import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path

from beamfield.errors import InvalidInputError

if sys.platform != "win32":
    import fcntl

_KEPT: ContextVar[frozenset[str]] = ContextVar("kept_files", default=frozenset())


@contextmanager
def kept_files(paths: Iterable[str | os.PathLike[str]]) -> Iterator[None]:
    """Refuse meanwhile to replace any of these files: they are what a result is made from.

    In a folder that is written, before the work only for the names that `check_folder_writable` is told.
    """
    before = _KEPT.set(frozenset(map(os.path.realpath, paths)))
    try:
        yield
    finally:
        _KEPT.reset(before)


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write one file whole or not at all.

    Parameters
    ----------
    path
        The file to write; missing parents are created. If it exists it is replaced, and its permissions are kept, as
        are owner and group where the system allows it.

    Yields
    ------
    A path of the same name in a scratch folder, which does not exist yet. Create that file inside the ``with`` block;
    at its end the file is flushed to the disk and renamed. If the block raises, or creates nothing, `path` is
    untouched.

    Raises
    ------
    InvalidInputError
        If `path` exists and is not a regular file, or the block created nothing.
    OSError
        As the file system says, with `path` untouched.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with atomic_file(folder / "result.txt") as part:
    ...     _ = part.write_text("complete")
    >>> [file.name for file in folder.iterdir()]
    ['result.txt']
    """
    with atomic_files([path]) as (part,):
        yield part


@contextmanager
def atomic_files(paths: Sequence[str | os.PathLike[str]]) -> Iterator[list[Path]]:
    """Write several files that belong together: all of them or none.

    Parameters
    ----------
    paths
        The files to write, the one that refers to the others last. They are renamed in this order.

    Yields
    ------
    One path per file to create inside the block, as for `atomic_file`.

    Raises
    ------
    InvalidInputError, OSError
        As for `atomic_file`. If a rename fails, those before it are undone.

    Notes
    -----
    No file system renames two files in one step: a power failure between two renames can leave the first file new and
    the last one old. A folder that is new is one rename; see `atomic_folder`.
    """
    targets = [_replaceable(Path(path)) for path in paths]
    with _parents(targets), ExitStack() as stack:
        scratch = [stack.enter_context(scratch_folder(target.parent, target.name)) for target in targets]
        parts = [folder / target.name for folder, target in zip(scratch, targets, strict=True)]
        with _known_names(parts, targets):
            yield parts
        for target, part in zip(targets, parts, strict=True):
            if not part.is_file():
                raise InvalidInputError(f"{target}: nothing was written to the temporary file {part.name!r}")
        _replace_all(parts, targets)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise now what `atomic_file` would raise after the work is done; its folder and their parents need not exist.

    InvalidInputError if `path` exists and is not a regular file, or is one of the `kept_files`; OSError if it is a
    folder, or nothing can be created where it is to be.
    """
    _require_access(_replaceable(Path(path)).parent, Path(path))


def check_folder_writable(path: str | os.PathLike[str], *names: str) -> None:
    """Raise now what `atomic_folder` would raise after the work is done; the folder and its parents need not exist.

    NotADirectoryError if it, or the nearest of its parents that exists, is not a folder; OSError if nothing can be
    created where it is to be; InvalidInputError if one of these names in it is one of the `kept_files`.
    """
    for name in names:
        _replaceable(Path(path, name))
    _require_access(Path(os.path.realpath(path)), Path(path))


@contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a folder of files: all of them or none.

    What is yielded is an empty folder to create files and folders in. Missing parents of `path` are created. If it
    exists, the files written replace those of the same name and everything else in it stays as it is.
    NotADirectoryError if it is not a folder; InvalidInputError if a file to be replaced is none, or one of the
    `kept_files`; OSError as the file system says; all with `path` untouched.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_dir():
        raise NotADirectoryError(20, "Not a directory", str(path))
    # In a folder that exists, for its parent may be another disk (a mount point) or not ours to write (a home).
    place = target if target.exists() else target.parent
    with _parents([target]) as created, scratch_folder(place, target.name) as scratch:
        part = scratch / target.name
        part.mkdir()
        with _known_names([part], [target]):
            yield part
        files = sorted(file for file in part.rglob("*") if not file.is_dir())
        if target.exists() or not _rename_folder(part, files, target):
            goals = [target / file.relative_to(part) for file in files]
            for goal in goals:
                _replaceable(goal)
            created += [folder for goal in goals for folder in _create_parents(goal)]
            _replace_all(files, goals)


def write_file(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write text (UTF-8) or bytes to a file, whole or not at all; one that is there is replaced."""
    with atomic_file(path) as part:
        part.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


@contextmanager
def scratch_folder(parent: Path, name: str) -> Iterator[Path]:
    """Make a folder that only its owner can open, for files that are needed for a while; it is removed at the end.

    Folders that killed runs left under this name are removed.
    """
    start, end = f".{name[:50]}.", _scratch_suffix()
    remove_abandoned(parent, start)
    while True:
        folder = parent / f"{start}{secrets.token_hex(6)}{end}"
        folder.mkdir(mode=0o700)
        with suppress(BlockingIOError, FileNotFoundError):  # another run took it for abandoned before we locked it
            lock = _lock(folder)
            break
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def remove_abandoned(parent: Path, start: str = ".") -> None:
    """Remove the scratch folders whose names begin so and that killed runs left in a folder, if there is one."""
    with suppress(OSError):
        for entry in parent.iterdir():
            if entry.name.startswith(start) and entry.name.endswith(_scratch_suffix()):
                with suppress(OSError):  # it is somebody's, or no folder of ours
                    lock = _lock(entry)
                    if lock is not None:
                        shutil.rmtree(entry, ignore_errors=True)
                        os.close(lock)


@contextmanager
def _known_names(parts: Sequence[Path], targets: Sequence[Path]) -> Iterator[None]:
    """Let errors name files that the user knows: a full disk names none, and scratch folders are gone by then."""
    try:
        yield
    except OSError as error:
        name, known = error.filename, None
        if name is None and error.errno in (errno.ENOSPC, errno.EDQUOT):
            known = str(targets[0])
        for part, target in zip(parts, targets, strict=True):
            if isinstance(name, str) and (name == str(part) or name.startswith(f"{part}{os.sep}")):
                known = f"{target}{name.removeprefix(str(part))}"
        if known is None:
            raise
        raise type(error)(error.errno, error.strerror, known) from error


def _replaceable(path: Path) -> Path:
    # A link stays a link: what it points to is replaced.
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise IsADirectoryError(21, "Is a directory", str(path))
    if target.exists() and not target.is_file():
        raise InvalidInputError(f"{path}: expected a regular file to replace, got a device, pipe or socket")
    if str(target) in _KEPT.get():
        raise InvalidInputError(f"{path}: this is read as input and would be replaced; write under another name")
    return target


@contextmanager
def _parents(targets: Sequence[Path]) -> Iterator[list[Path]]:
    """Create the folders that files are to be in; on an error, remove those that are listed by then."""
    created: list[Path] = []
    try:
        for target in targets:
            created += _create_parents(target)
        yield created
    except BaseException:
        for folder in reversed(created):
            with suppress(OSError):  # someone else put something there: it is theirs
                folder.rmdir()
        raise


def _require_access(folder: Path, path: Path) -> None:
    """Try to create something in a folder, or in its nearest parent that exists; errors name the user's path."""
    nearest = next(place for place in (folder, *folder.parents) if place.exists())
    if not nearest.is_dir():
        raise NotADirectoryError(
            20, "Not a directory", str(path if nearest == Path(os.path.realpath(path)) else nearest)
        )
    try:
        # Trying is the only test: access bits do not tell of a read-only disk or of /proc.
        with scratch_folder(nearest, folder.name):
            pass
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(path)) from error


@cache
def _scratch_suffix() -> str:
    """Return the end of a scratch folder's name, which tells apart systems that may not see each other's locks."""
    try:
        # New with every boot, and shared by the containers of one machine, whose host names differ.
        identity = Path("/proc/sys/kernel/random/boot_id").read_bytes()
    except OSError:
        identity = platform.node().encode()
    return f".{hashlib.sha256(identity).hexdigest()[:8]}.beamfield-part"


def _lock(folder: Path) -> int | None:
    """Lock a folder and return what to close to unlock it; None if folders cannot be locked here.

    Raises BlockingIOError if another run has the lock, FileNotFoundError if the folder is gone.
    """
    if sys.platform == "win32":
        return None
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        folder.stat()
    except (BlockingIOError, FileNotFoundError):
        os.close(handle)
        raise
    except OSError:
        os.close(handle)
        return None
    return handle


def _flush(path: Path) -> None:
    # Else a power failure after the rename could leave an empty file under the final name.
    handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _replace_all(parts: Sequence[Path], targets: Sequence[Path]) -> None:
    """Rename every part to its target; if one rename fails, put back what was there before."""
    for part, target in zip(parts, targets, strict=True):
        if target.is_dir():
            raise IsADirectoryError(21, "Is a directory", str(target))
        if target.exists():
            _keep_access(target, part)
        _flush(part)
    undo: list[tuple[Path, Path, Path | None]] = []
    try:
        for part, target in zip(parts, targets, strict=True):
            # A single rename needs no way back.
            old = _copy(target, part) if len(parts) > 1 and target.exists() else None
            undo.append((part, target, old))
            part.replace(target)
    except BaseException:
        for part, target, old in reversed(undo):
            if part.exists():
                continue  # not renamed
            if old is None:
                target.unlink(missing_ok=True)
            else:
                old.replace(target)
        raise


def _keep_access(target: Path, part: Path) -> None:
    if sys.platform != "win32":
        old = target.stat()
        with suppress(PermissionError):  # only root may give files away
            os.chown(part, old.st_uid, old.st_gid)
    shutil.copymode(target, part)


def _copy(target: Path, part: Path) -> Path:
    # Not a rename: readers find the old file under its name until the new one takes it.
    old = part.with_name(f"{secrets.token_hex(6)}.old")
    shutil.copyfile(target, old)
    _keep_access(target, old)
    return old


def _rename_folder(part: Path, files: Sequence[Path], target: Path) -> bool:
    """Give a new folder its name; False if another run made a folder of that name in the meantime."""
    for file in files:
        _flush(file)
    try:
        part.rename(target)
    except OSError:
        if not target.is_dir():
            raise
        return False
    return True


def _create_parents(path: Path) -> list[Path]:
    missing = []
    for folder in path.parents:
        if folder.exists():
            break
        missing.append(folder)
    for folder in reversed(missing):
        folder.mkdir(exist_ok=True)
    return missing[::-1]
