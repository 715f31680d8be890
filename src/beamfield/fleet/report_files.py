"""The files of a fleet's report: the page, JSON, Parquet, and the places to map again as maps and GeoJSON."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from beamfield import __version__
from beamfield.fleet.beam_schema import require_pyarrow
from beamfield.fleet.fleet_report import FleetReport
from beamfield.fleet.report_page import render_fleet_page
from beamfield.fleet.stale_map import StaleMap
from beamfield.geometry import FloatArray
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report.as_json import json_text, plain

PAGE, JSON_FILE, SCHEMA = "fleet_report.html", "fleet_report.json", "beamfield-fleet-report/1"

# Columns of the tables; SI units.
TABLES = {
    "robots": "robot site light urgency runs left_out why do not_tested",
    "faults": "robot site fault since size low high before after unit from_bearing to_bearing cause p_value q_value "
              "alarm",
    "series": "robot site fault cause unit from_bearing to_bearing day value standard_error contrast",
    "parameters": "site robot max_range min_range opening_angle parameter value low high shrinkage",
    "differences": "robot site parameter value usual low high p_value q_value differs",
    "places": "site map kind reading x y width height since rate readings beams runs_changed runs robots_changed "
              "robots p_value q_value",
    "squares": "site map side x y crossed short tested beyond no_return runs robots disagreement",
}  # fmt: skip
_NUMBERS = (
    "urgency size low high before after from_bearing to_bearing p_value q_value value standard_error contrast "
    "max_range min_range opening_angle shrinkage usual x y width height rate side disagreement"
)
_COUNTS = "runs left_out readings beams runs_changed robots_changed robots crossed short tested beyond no_return"
TYPES = {
    **dict.fromkeys(_NUMBERS.split(), "double"), **dict.fromkeys(_COUNTS.split(), "int64"),
    **dict.fromkeys(("alarm", "differs"), "bool"), **dict.fromkeys(("day", "since"), "date32"),
}  # fmt: skip


def write_fleet_report(folder: Path, report: FleetReport) -> list[str]:
    """Write all files of a report.

    Parameters
    ----------
    folder
        An empty folder.
    report
        Result of `judge_fleet`.

    Returns
    -------
    Names of the files in the folder.
    """
    pa = require_pyarrow()
    pq = pa.parquet
    (folder / PAGE).write_text(render_fleet_page(report), encoding="utf-8")
    (folder / JSON_FILE).write_text(json_text(report_as_dict(report)), encoding="utf-8")
    for name, rows in report_tables(report).items():
        pq.write_table(pa.Table.from_pylist(rows, _schema(pa, name)), folder / f"{name}.parquet", compression="zstd")
    (folder / "maps").mkdir()
    for stale in report.stale_maps:
        name = f"{quote(stale.site, safe='')}-{stale.map_hash[:8]}"
        write_map(disagreement_map(stale), folder / f"maps/{name}.yaml", mode="raw")
        (folder / f"maps/{name}.geojson").write_text(json_text(places_as_geojson(stale)), encoding="utf-8")
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def _schema(pa: Any, table: str) -> Any:
    """Return the schema of a table: columns are text unless their name is among `TYPES`."""
    return pa.schema([(name, pa.type_for_alias(TYPES.get(name, "string"))) for name in TABLES[table].split()])


def report_as_dict(report: FleetReport) -> dict[str, Any]:
    """Return what a report says as values that strict JSON can hold; numbers per day and square are in Parquet."""
    return {
        "schema": SCHEMA,
        "program": f"beamfield {__version__}",
        "days": plain(report.days),
        "sites": plain(report.sites),
        "tests": plain(report.tests),
        "robots": plain(report.states),
        "faults": [plain(drift) for drift in report.alarms],
        "parameters": plain(report.hierarchies),
        "findings": plain(report.findings),
        "differences": plain([one for one in report.differences if one.differs]),
        "maps": [
            {
                "site": one.site, "map": one.map_hash, "runs": one.runs, "robots": one.robots, "days": one.days,
                "not_asked": plain(one.not_asked), "places": plain(one.places),
            }
            for one in report.stale_maps
        ],
        "runs": [
            {name: plain(getattr(one, name)) for name in ("run", "robot", "site", "status", "reason", "notes")}
            for one in report.records
        ],
    }  # fmt: skip


def report_tables(report: FleetReport) -> dict[str, list[dict[str, Any]]]:
    """Return the tables by name, row by row, with the columns of `TABLES`."""
    groups = [
        (asdict(hierarchy.limits), group)
        for hierarchy in report.hierarchies
        for group in (hierarchy.fleet, *hierarchy.sites, *hierarchy.robots)
    ]
    rows: dict[str, list[dict[str, Any]]] = {
        "robots": [
            _row("robots", one, why=" ".join(f.text for f in one.findings), do=" ".join(f.do for f in one.findings),
                 not_tested="; ".join(one.not_tested))
            for one in report.states
        ],
        "faults": [_row("faults", one, **_sector(one.bearings)) for one in report.drifts],
        "series": [
            _row("series", one, **_sector(one.bearings), day=day, value=value, standard_error=error, contrast=contrast)
            for one in report.series
            for day, value, error, contrast in zip(
                one.days, one.values.tolist(), one.standard_errors.tolist(), one.contrasts.tolist(), strict=True
            )
        ],
        "parameters": [
            _row("parameters", group, **limits, parameter=name, value=getattr(group.parameters, name), low=low,
                 high=high, shrinkage=group.shrinkage.get(name))
            for limits, group in groups
            for name, (low, high) in group.intervals.items()
        ],
        "differences": [_row("differences", one) for one in report.differences],
        "places": [
            _row("places", place, site=stale.site, map=stale.map_hash)
            for stale in report.stale_maps
            for place in stale.places
        ],
    }  # fmt: skip
    columns = TABLES["squares"].split()[3:]
    rows["squares"] = [
        {"site": one.site, "map": one.map_hash, "side": one.side, **dict(zip(columns, values, strict=True))}
        for one in report.stale_maps
        for values in zip(*(getattr(one.squares, name).tolist() for name in columns), strict=True)
    ]
    return rows


def _row(table: str, one: object, **rest: Any) -> dict[str, Any]:
    """Return the columns of a table: attributes of an object, and what it does not have."""
    return {name: rest[name] if name in rest else getattr(one, name) for name in TABLES[table].split()}


def _sector(bearings: tuple[float, float] | None) -> dict[str, float | None]:
    low, high = bearings or (None, None)
    return {"from_bearing": low, "to_bearing": high}


def disagreement_map(stale: StaleMap) -> OccupancyGrid:
    """Return the share of beams that disagree as a map in the place of the site's: unknown where no beam came.

    Whole percents, on the cells of the site's map.
    """
    grid, squares = stale.grid, stale.squares
    rows, cols = np.indices(grid.shape)
    points: FloatArray = grid.to_map(np.column_stack([cols.ravel(), rows.ravel()]) + 0.5)
    corner = np.floor(points / stale.side).astype(np.int64)
    seen = np.round(np.column_stack([squares.x, squares.y]) / stale.side).astype(np.int64)
    low = np.minimum(corner.min(axis=0), seen.min(axis=0, initial=0))
    size = np.maximum(corner.max(axis=0), seen.max(axis=0, initial=0)) - low + 1
    shares = np.full(size, np.nan)
    shares[tuple((seen - low).T)] = np.round(squares.disagreement, 2)
    return replace(grid, probability=shares[tuple((corner - low).T)].reshape(grid.shape).astype(np.float32))


def places_as_geojson(stale: StaleMap) -> dict[str, Any]:
    """Return the places to map again as a GeoJSON FeatureCollection; coordinates are metres in the map frame."""
    square = stale.side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    features = [
        {
            "type": "Feature",
            "properties": {name: plain(value) for name, value in vars(place).items() if name != "corners"},
            "geometry": {
                "type": "MultiPolygon", "coordinates": [[(corner + square).tolist()] for corner in place.corners]
            },
        }
        for place in stale.lasting
    ]  # fmt: skip
    return {
        "type": "FeatureCollection",
        "name": f"{stale.site}: places to map again",
        "coordinates_are": "metres in the map frame, not degrees",
        "features": features,
    }
