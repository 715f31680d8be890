"""How many processors this process may use."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

# Where Linux tells how many threads run, where it lists the control groups of this process, and where their limits are.
LOAD, MEMBERSHIPS, CONTROL_GROUPS = "/proc/loadavg", Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")


def n_processors() -> int:
    """Return the number of processors that this process may use: by its affinity and its control groups' quota."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, int(min(allowed, _quota())))


def n_idle() -> int:
    """Return the number of processors of the machine that nothing runs on at this moment; all if that is not known."""
    n = os.cpu_count() or 1
    try:
        # The fourth word is "running/existing", threads of the whole machine, the caller's among them.
        running = int(os.pread(_load_file(), 64, 0).split()[3].partition(b"/")[0])
    except (OSError, ValueError, IndexError, AttributeError):
        # Not Linux; or someone has closed all files of the process, and the number is another's by now.
        _load_file.cache_clear()
        return n
    return max(0, n - running)


@functools.cache
def _load_file() -> int:
    """Return a file that stays open: opening it takes 10 us of the 50 that another thread needs to come."""
    return os.open(LOAD, os.O_RDONLY)


@functools.cache
def _quota() -> float:
    """Return the processors' time that the control groups of this process may use, in processors; inf if unlimited.

    A fraction counts as nothing: whoever runs on more threads than the quota holds is stopped for the rest of a period.
    """
    return cpu_quota(MEMBERSHIPS, CONTROL_GROUPS)


def cpu_quota(memberships: Path, control_groups: Path) -> float:
    """Return the least quota of all control groups that a process is in, in processors; inf where there is none.

    Parameters
    ----------
    memberships
        File with lines ``hierarchy:controllers:/path``, as /proc/self/cgroup.
    control_groups
        Where the groups are mounted. A container sees its own group at the root, by another path than is listed.
    """
    quota = float("inf")
    with suppress(OSError):
        for line in memberships.read_text().splitlines():
            _, _, group = line.partition(":")
            controllers, _, path = group.partition(":")
            if controllers == "":
                limits = (_ratio(_words(folder / "cpu.max")) for folder in _with_parents(control_groups, path))
            elif "cpu" in controllers.split(","):
                roots = (control_groups / name for name in ("cpu", controllers))
                limits = (
                    _ratio(_words(folder / "cpu.cfs_quota_us") + _words(folder / "cpu.cfs_period_us"))
                    for root in roots
                    for folder in _with_parents(root, path)
                )
            else:
                continue
            quota = min([quota, *limits])
    return quota


def _with_parents(root: Path, path: str) -> Iterator[Path]:
    folder = root / path.lstrip("/")
    yield folder
    yield from (parent for parent in folder.parents if parent.is_relative_to(root))


def _words(path: Path) -> list[str]:
    try:
        return path.read_text().split()
    except OSError:
        return []


def _ratio(words: list[str]) -> float:
    """Return quota / period; inf for "max", -1 and what is not there."""
    with suppress(ValueError):
        quota, period = (float(word) for word in words)
        if quota > 0.0 and period > 0.0:
            return quota / period
    return float("inf")
