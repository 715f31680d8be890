"""How many threads a caller may ask for."""

from __future__ import annotations

from numbers import Integral

from beamfield.errors import InvalidInputError


def check_threads(threads: int | None) -> None:
    """Refuse a number of threads that is no number of threads.

    `beamfield.kernels.threads` would take 0 for 1: kernels check nothing.

    Parameters
    ----------
    threads
        Number of threads; None leaves it to `beamfield.kernels.threads.run_in_slices`.

    Raises
    ------
    InvalidInputError
        If it is less than 1.

    Examples
    --------
    >>> check_threads(None)
    >>> check_threads(0)
    Traceback (most recent call last):
    beamfield.errors.InvalidInputError: threads: expected at least 1 or None, got 0
    """
    if threads is not None and (not isinstance(threads, Integral) or threads < 1):
        raise InvalidInputError(f"threads: expected at least 1 or None, got {threads!r}")
