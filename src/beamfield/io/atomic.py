"""Write files whole or not at all: an error, or a kill, never leaves half a result under the final name."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from beamfield.errors import InvalidInputError


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write one file whole or not at all.

    Parameters
    ----------
    path
        The file to write; it is replaced if it exists, and its permissions are kept.

    Yields
    ------
    A path beside it, with the same suffix, that does not exist yet. Create that file inside the ``with`` block; at its
    end the file is flushed to the disk and renamed. If the block raises, or creates nothing, `path` is untouched.

    Raises
    ------
    InvalidInputError
        If `path` exists and is no regular file, or the block created nothing.
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
    parts = [_beside(target) for target in targets]
    try:
        yield parts
        for target, part in zip(targets, parts, strict=True):
            if not part.is_file():
                raise InvalidInputError(f"{target}: the file was to be written, but {part.name!r} was not created")
            if target.exists():
                shutil.copymode(target, part)
            _flush(part)
        _replace_all(parts, targets)
    finally:
        for part in parts:
            part.unlink(missing_ok=True)
    for folder in {target.parent for target in targets}:
        _flush(folder)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise now what `atomic_file` would raise after the work is done.

    Parameters
    ----------
    path
        The file that is to be written.

    Raises
    ------
    InvalidInputError
        If `path` exists and is no regular file.
    OSError
        If it is a folder, or its folder does not exist or nothing can be created in it.
    """
    _require_access(_replaceable(Path(path)).parent)


def check_folder_writable(path: str | os.PathLike[str]) -> None:
    """Raise now what `atomic_folder` would raise after the work is done.

    Parameters
    ----------
    path
        The folder that is to be written; it and its parents need not exist.

    Raises
    ------
    NotADirectoryError
        If it, or the nearest of its parents that exists, is no folder.
    PermissionError
        If nothing can be created where it is to be.
    """
    target = Path(os.path.realpath(path))
    nearest = next(folder for folder in (target, *target.parents) if folder.exists())
    if not nearest.is_dir():
        raise NotADirectoryError(20, "Not a directory", str(path if nearest == target else nearest))
    _require_access(nearest)


@contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a folder of files: all of them or none.

    Parameters
    ----------
    path
        The folder; missing parents are created. If it exists, the files written replace those of the same name and
        everything else in it stays as it is.

    Yields
    ------
    An empty folder beside it, or in it if it exists, to create files in; folders inside that are allowed.

    Raises
    ------
    NotADirectoryError
        If `path` exists and is no folder.
    OSError
        As the file system says, with `path` untouched.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_dir():
        raise NotADirectoryError(20, "Not a directory", str(path))
    created = _create_parents(target)
    # In a folder that exists, for its parent may be another disk (a mount point) or not ours to write (a home).
    part = _beside(target / target.name if target.exists() else target)
    try:
        part.mkdir()
        yield part
        files = sorted(file for file in part.rglob("*") if not file.is_dir())
        for file in files:
            _flush(file)
        if target.exists():
            _merge(part, files, target)
        else:
            for folder in [part, *(entry for entry in part.rglob("*") if entry.is_dir())]:
                _flush(folder)
            part.rename(target)
        _flush(target.parent)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        for folder in reversed(created):
            _remove_if_empty(folder)
        raise
    shutil.rmtree(part, ignore_errors=True)


def write_file(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write text (UTF-8) or bytes to a file, whole or not at all.

    Parameters
    ----------
    path
        The file; replaced if it exists.
    content
        What the file shall hold.
    """
    with atomic_file(path) as part:
        part.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def _replaceable(path: Path) -> Path:
    # A link stays a link: what it points to is replaced.
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise IsADirectoryError(21, "Is a directory", str(path))
    if target.exists() and not target.is_file():
        raise InvalidInputError(f"{path}: expected a regular file to replace, got a device, pipe or socket")
    if not target.parent.is_dir():
        raise FileNotFoundError(2, "No such folder to write into", str(target.parent))
    return target


def _require_access(folder: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(13, "Permission denied", str(folder))


def _beside(target: Path) -> Path:
    # The suffix stays last, because writers choose the format by it. The name is not created here, so that the
    # writer's own creation honours the user's umask.
    return target.with_name(f".{target.stem[:100]}.{secrets.token_hex(6)}.part{target.suffix}")


def _flush(path: Path) -> None:
    if path.is_dir():
        # Windows cannot open a folder and some network file systems cannot flush one; the rename is done either way.
        with suppress(OSError):
            _sync(path, os.O_RDONLY)
    else:
        _sync(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)


def _sync(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _replace_all(parts: Sequence[Path], targets: Sequence[Path]) -> None:
    """Rename every part to its target; if one rename fails, put back what was there before."""
    if len(parts) == 1:
        parts[0].replace(targets[0])
        return
    undo: list[tuple[Path, Path | None]] = []
    try:
        for part, target in zip(parts, targets, strict=True):
            undo.append((target, _keep(target) if target.exists() else None))
            part.replace(target)
    except BaseException:
        for target, old in reversed(undo):
            if old is None:
                target.unlink(missing_ok=True)
            else:
                old.replace(target)
        raise
    for _, old in undo:
        if old is not None:
            old.unlink(missing_ok=True)


def _keep(target: Path) -> Path:
    # A copy, not a rename: readers find the old file under its name until the new one takes it.
    old = _beside(target)
    shutil.copy2(target, old)
    return old


def _merge(part: Path, files: Sequence[Path], target: Path) -> None:
    goals = [target / file.relative_to(part) for file in files]
    for goal in goals:
        if goal.is_dir():
            raise IsADirectoryError(21, "Is a directory", str(goal))
    created = [folder for goal in goals for folder in _create_parents(goal)]
    try:
        _replace_all(files, goals)
    except BaseException:
        for folder in reversed(created):
            _remove_if_empty(folder)
        raise
    for folder in {goal.parent for goal in goals}:
        _flush(folder)


def _create_parents(path: Path) -> list[Path]:
    missing = []
    for folder in path.parents:
        if folder.exists():
            break
        missing.append(folder)
    for folder in reversed(missing):
        folder.mkdir(exist_ok=True)
    return missing[::-1]


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):  # someone else put something there: it is theirs
        folder.rmdir()
