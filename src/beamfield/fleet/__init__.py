"""Many robots and many logs: a catalogue of beams in Parquet, and work on it by Dask. Needs the extra ``fleet``.

``bf.fleet`` offers what a program needs beside ``bf.open_catalogue``; a name is loaded when it is first used (PEP 562).
"""

from beamfield.lazy_names import lazy_names

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
__all__, __getattr__, __dir__ = lazy_names(__name__, _NAMES, doors=("beamfield",))
