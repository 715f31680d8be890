"""The errors that beamfield raises on purpose; everything else is a bug or the file system speaking."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from beamfield.printable import printable


class BeamfieldError(Exception):
    """Base of every error that beamfield raises on purpose.

    The command line prints its text on one line and exits with `exit_code`.
    """

    exit_code = 1

    def __init__(self, text: str) -> None:
        # A topic or a section of a file may be named by characters that a terminal obeys, or that begin a line.
        super().__init__(printable(text))


class InvalidInputError(BeamfieldError, ValueError):
    """An argument is not valid; the message names it, what was expected and what was got."""

    exit_code = 2


class NoSuchIndexError(InvalidInputError, IndexError):
    """There is nothing of that number."""


class FormatError(BeamfieldError, ValueError):
    """The content of a file is not what its format promises.

    Parameters
    ----------
    path
        The file.
    message
        What is wrong, quoting the offending text with ``!r``.
    line
        The line number, counted from 1, if the format has lines.
    field
        The key, topic or message that is wrong, if the format has such.
    """

    def __init__(self, path: str | Path, message: str, *, line: int | None = None, field: str | None = None) -> None:
        self.path = Path(path)
        self.line = line
        self.field = field
        place = str(path) + (f":{line}" if line is not None else "")
        super().__init__(f"{place}: {f'{field}: ' if field else ''}{message}")


class TooLittleDataError(BeamfieldError):
    """There is not enough data for what was asked; the text says how much there is and where the rest went."""

    exit_code = 3


class TrajectoryNotFoundError(BeamfieldError):
    """No trajectory, or more than one, fits a log and a map; the text names the best two starts."""

    exit_code = 3


class MissingDependencyError(BeamfieldError, ImportError):
    """An optional dependency is not installed.

    Parameters
    ----------
    package
        The package that is missing.
    extra
        The extra of beamfield that brings it; None if none does.
    purpose
        What it is needed for.
    """

    def __init__(self, package: str, extra: str | None, purpose: str) -> None:
        where = "" if extra is None else f", which is in the extra beamfield[{extra}]"
        super().__init__(f"{purpose} needs the package {package!r}: pip install {package}{where}")


@contextmanager
def needs(package: str, extra: str | None, purpose: str) -> Iterator[None]:
    """Say what is missing where an import fails; parameters as of `MissingDependencyError`."""
    try:
        yield
    except ImportError as error:
        raise MissingDependencyError(package, extra, purpose) from error


@contextmanager
def about_file(path: str | Path) -> Iterator[None]:
    """Name a file in the errors about what it holds: options are to be checked before."""
    try:
        yield
    except InvalidInputError as error:
        raise FormatError(path, str(error)) from error
    except TooLittleDataError as error:
        raise TooLittleDataError(f"{path}: {error}") from error
