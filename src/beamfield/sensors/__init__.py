"""Range finders, scans and logs of scans, in one set of conventions for every sensor and file format."""

from beamfield.sensors.range_finder import SHORTEST_SPAN, RangeFinder
from beamfield.sensors.scan import Scan, usable_ranges
from beamfield.sensors.scan_log import ScanLog, Track
from beamfield.sensors.sensor_log import MAX_GAP, NO_POSE, NoReturnPolicy, SensorLog

__all__ = [
    "MAX_GAP",
    "NO_POSE",
    "SHORTEST_SPAN",
    "NoReturnPolicy",
    "RangeFinder",
    "Scan",
    "ScanLog",
    "SensorLog",
    "Track",
    "usable_ranges",
]
