"""Simulate a fleet with faults, report it in one command, and compare with the truth.

Run: ``python benchmarks/fleet_shown.py FOLDER [options of beamfield fleet simulate]``. What is in FOLDER already is not
made again.
"""

from __future__ import annotations

import datetime
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from beamfield.cli.main import main
from beamfield.fleet.robot_state import LIGHTS
from beamfield.fleet.simulated import FleetSize, changed_site, plan_fleet, site_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.scan_fit.place_visits import FEWEST_BEAMS
from tables import print_table

# A place is right if it is so near to something that changed, metres.
NEAR = 0.25
# A change was seen if so many runs had ten beams there, each in the mean.
SEEN_RUNS = 6
# What is found has the sign of what software sees: a mount turned to the left lets motion seem to go to the right, and
# odometry that is too long falls short of the map.
SIGNS = {"turned-mount": -1.0, "wheel-scale": -1.0, "range-bias": 1.0, "dirty-lens": 1.0}
UNITS = {"turned-mount": (math.degrees(1.0), "degrees"), "wheel-scale": (100.0, "%"), "range-bias": (100.0, "cm"),
         "dirty-lens": (100.0, "% lost, and cut")}  # fmt: skip


def fault_rows(truth: dict[str, Any], report: dict[str, Any]) -> Iterator[dict[str, str]]:
    """Yield each planted fault beside what was found of it."""
    first = truth["size"]["first_day"]
    for robot in truth["robots"]:
        fault = robot["fault"]
        if fault is None:
            continue
        scale, unit = UNITS[fault["kind"]]
        found = [f for f in report["faults"] if (f["robot"], f["fault"]) == (robot["robot"], fault["kind"])]
        sizes = [
            f"{scale * SIGNS[f['fault']] * f['size']:.2g} {f['cause']} "
            f"[{', '.join(f'{scale * v:.2g}' for v in sorted(SIGNS[f['fault']] * f[end] for end in ('low', 'high')))}]"
            for f in found
        ]
        yield {
            "robot": robot["robot"], "fault": fault["kind"],
            "true size": f"{scale * fault['size']:.2g} {unit}",
            "found": "; ".join(sizes) or "missed",
            "since": "the first day" if fault["since"] == first else fault["since"],
            "found since": "; ".join(f["since"] or "the first day" for f in found),
            "light": next(one["light"] for one in report["robots"] if one["robot"] == robot["robot"]),
        }  # fmt: skip


def false_alarms(truth: dict[str, Any], report: dict[str, Any]) -> Iterator[str]:
    planted = {(one["robot"], one["fault"]["kind"]) for one in truth["robots"] if one["fault"]}
    for found in report["faults"]:
        if (found["robot"], found["fault"]) not in planted:
            yield f"{found['robot']}: {found['fault']} since {found['since']}, size {found['size']:.3g}"


def place_rows(
    truth: dict[str, Any], report: dict[str, Any], squares: list[dict[str, Any]]
) -> Iterator[dict[str, str]]:
    """Yield per site how many places to map again are right, and how many changes were found."""
    first_day = datetime.date.fromisoformat(truth["size"]["first_day"])
    plan = plan_fleet(FleetSize(**{**truth["size"], "first_day": first_day}), seed=truth["seed"])
    for number, site in enumerate(truth["sites"]):
        places = [
            place
            for one in report["maps"]
            if one["site"] == site["site"]
            for place in one["places"]
            if place["kind"] != "undecided"
        ]
        right, days = 0, set()
        if site["changes"]:
            world, mapped = changed_site(plan.size, plan.sites[number])[0], site_map(plan.size, plan.sites[number])
            masks = {"short": world.occupied & mapped.free, "beyond": mapped.occupied & world.free}
            for place in places:
                mask = masks.get(place["reading"], masks["beyond"])
                is_right = distance(place, mask, mapped) <= NEAR
                right += is_right
                days |= {place["since"]} if is_right else set()
        there = [square for square in squares if square["site"] == site["site"]]
        seen = [change for change in site["changes"] if runs_at(change, there) >= SEEN_RUNS]
        found = [change for change in seen if any(place["kind"] == change["kind"] and near(place, change)
                                                  for place in places)]  # fmt: skip
        yield {
            "site": site["site"], "changed since": site["changed_since"] or "never", "places to map again": len(places),
            "right": right, "said since": ", ".join(sorted(map(str, days))),
            "changes": len(site["changes"]), "seen by robots": len(seen), "found": len(found),
        }  # fmt: skip


def distance(place: dict[str, Any], mask: np.ndarray, grid: OccupancyGrid) -> float:
    """Return the distance from a place's squares to the nearest cell of a mask, metres."""
    points = grid.to_map(np.argwhere(mask)[:, ::-1] + 0.5)
    gap = np.maximum(np.abs(points[:, None] - (np.array(place["corners"]) + 0.125)) - 0.125, 0.0)
    return float(np.hypot(gap[..., 0], gap[..., 1]).min())


def near(place: dict[str, Any], change: dict[str, Any]) -> bool:
    return all(
        abs(place[at] - change[at]) <= 0.5 * (place[size] + change[size]) + NEAR
        for at, size in (("x", "width"), ("y", "height"))
    )


def runs_at(change: dict[str, Any], squares: list[dict[str, Any]]) -> int:
    """Return how many runs had beams enough at the square around a change that most runs saw."""
    column = "crossed" if change["kind"] == "new obstacle" else "tested"
    inside = [
        square["runs"]
        for square in squares
        if square[column] >= FEWEST_BEAMS * square["runs"]
        and abs(square["x"] + 0.125 - change["x"]) <= 0.5 * change["width"] + 0.125
        and abs(square["y"] + 0.125 - change["y"]) <= 0.5 * change["height"] + 0.125
    ]
    return max(inside, default=0)


def compare(fleet: Path, report: Path) -> None:
    truth = json.loads((fleet / "truth.json").read_text())
    said = json.loads((report / "fleet_report.json").read_text())
    lights = [one["light"] for one in said["robots"]]
    healthy = {one["robot"] for one in truth["robots"] if one["fault"] is None}
    flagged = [one["robot"] for one in said["robots"] if one["robot"] in healthy and one["light"] != "green"]
    used = sum(one["status"] == "used" for one in said["runs"])
    counted = ", ".join(f"{lights.count(light)} {light}" for light in LIGHTS)
    print(f"{used} of {len(said['runs'])} runs used; lights: {counted}\n")
    print_table(list(fault_rows(truth, said)))
    alarms = list(false_alarms(truth, said))
    print(f"\nfalse alarms: {len(alarms)}; healthy robots that are not green: {len(flagged)} of {len(healthy)}")
    print("".join(f"  {line}\n" for line in alarms))
    print_table(list(place_rows(truth, said, pq.read_table(report / "squares.parquet").to_pylist())))


if __name__ == "__main__":
    folder, options = Path(sys.argv[1]), sys.argv[2:]
    fleet, report = folder / "fleet", folder / "report"
    if not (fleet / "manifest.yaml").is_file() and main(["fleet", "simulate", "--out", str(fleet), *options]) != 0:
        raise SystemExit(1)
    if not (report / "fleet_report.json").is_file() and (
        main(["fleet", "report", str(fleet / "manifest.yaml"), "--out", str(report)]) != 0
    ):
        raise SystemExit(1)
    compare(fleet, report)
