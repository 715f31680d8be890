"""How far the memory of this process has grown at most, as the system counts it."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

STATUS, RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_PEAK = re.compile(rb"VmHWM:\s+(\d+) kB")
_NOW = re.compile(rb"VmRSS:\s+(\d+) kB")
_ADDRESSES = re.compile(rb"VmSize:\s+(\d+) kB")


class PeakMemory:
    """Peak of the resident memory since `start`, bytes; on systems without /proc it is always 0."""

    def start(self) -> int:
        """Forget earlier peaks, and return what is in use now."""
        with suppress(OSError):
            RESET.write_bytes(b"5")
        return _read(_NOW)

    def peak(self) -> int:
        return _read(_PEAK)


def address_space() -> int:
    """Bytes of address space in use."""
    return _read(_ADDRESSES)


def _read(pattern: re.Pattern[bytes]) -> int:
    try:
        found = pattern.search(STATUS.read_bytes())
    except OSError:
        return 0
    return int(found[1]) * 1024 if found else 0
