"""Many robots and many logs: a catalogue of beams in Parquet, and work on it by Dask. Needs the extra ``fleet``.

``bf.fleet`` offers what a program needs beside ``bf.open_catalogue``; a name is loaded when it is first used (PEP 562).
"""

from importlib import import_module

_NAMES = {
    "engine": ("Engine",),
    "scan": ("scan_fleet",),
    "learning": ("learn",),
    "hierarchy": ("pool",),
    "comparison": ("compare_robots",),
    "daily": ("daily_series",),
    "drift": ("find_drift",),
    "stale_map": ("find_stale_places",),
    "fleet_report": ("judge_fleet",),
    "report_files": ("write_fleet_report",),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [*_HOMES]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
