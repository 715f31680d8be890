"""The columns of a fleet's beams, with their units: what every Parquet file of a catalogue has."""

from __future__ import annotations

from typing import Any

from beamfield.errors import needs

# Raise it when columns change, or what is computed in them does: catalogues are then made anew.
SCHEMA = 2
VERSION_KEY = b"beamfield.schema"
# By name: the type, the unit and what it is.
COLUMNS = {
    "run": ("run", "", "name of the run"),
    "stamp": ("float64", "s", "time of the scan"),
    "scan": ("int32", "", "number of the scan in the log, from 0"),
    "beam": ("int32", "", "number of the beam in the scan, from 0: its mount is in the run's record"),
    "bearing": ("float32", "rad", "direction of the beam in the robot frame"),
    "range": ("float32", "m", "measured range; exactly the sensor's max_range: no return"),
    "expected_range": ("float32", "m", "range by the map; exactly max_range: the beam meets nothing"),
    "incidence": ("float32", "rad", "angle between beam and wall normal; NaN: nothing met, or it has no direction"),
    "hit_row": ("int32", "", "row of the map's cell that the beam meets; -1: none"),
    "hit_col": ("int32", "", "column of that cell; -1: none"),
    "x": ("float64", "m", "pose of the robot in the map"),
    "y": ("float64", "m", "pose of the robot in the map"),
    "heading": ("float64", "rad", "pose of the robot in the map"),
    "var_x": ("float32", "m2", "variance of x; 0: not known"),
    "var_y": ("float32", "m2", "variance of y; 0: not known"),
    "var_heading": ("float32", "rad2", "variance of the heading; 0: not known"),
    "cov_xy": ("float32", "m2", "covariance of x and y; 0: not known"),
    "held_out": ("bool", "", "kept from learning, in whole blocks of time"),
}
# How a file stores what is not the same all over a scan; the rest is numbered in a dictionary.
ENCODINGS = {
    "beam": "DELTA_BINARY_PACKED",
    "range": "BYTE_STREAM_SPLIT",
    "expected_range": "BYTE_STREAM_SPLIT",
    "incidence": "BYTE_STREAM_SPLIT",
    "hit_row": "DELTA_BINARY_PACKED",
    "hit_col": "DELTA_BINARY_PACKED",
}


def require_pyarrow() -> Any:
    """Return PyArrow with its Parquet and data set modules, or say how to get it."""
    with needs("pyarrow", "fleet", "a fleet's catalogue"):
        import pyarrow as pa
        import pyarrow.dataset
        import pyarrow.parquet
    return pa


def beam_schema() -> Any:
    """Return the schema of a file of beams: units and meanings in the columns' metadata, the version in the file's."""
    pa = require_pyarrow()
    types = {"run": pa.dictionary(pa.int32(), pa.string()), "bool": pa.bool_()}
    fields = [
        pa.field(name, types.get(kind) or getattr(pa, kind)(), nullable=False, metadata={"unit": unit, "about": about})
        for name, (kind, unit, about) in COLUMNS.items()
    ]
    return pa.schema(fields, metadata={VERSION_KEY: str(SCHEMA)})
