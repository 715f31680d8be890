"""Compare emulators with the programs they emulate, exact with approximate distances and ranges, and time them.

Run: python benchmarks/stacks.py

The first table needs other programs' answers, in the folder ``shared/oracle`` beside the checkout; else it is left out.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from beam_model import MAX_RANGE, N_BEAMS, N_POSES, PARAMETERS, anywhere, near, office
from beamfield.kernels.threads import set_threads
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.beluga.models import BelugaBeam, BelugaField, BelugaFieldProb
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.f1tenth.parameters import F1tenthParameters
from beamfield.stacks.f1tenth.table import F1tenthTable
from beamfield.stacks.mrpt.field import MrptField
from beamfield.stacks.mrpt.parameters import MrptFieldParameters, MrptRayParameters
from beamfield.stacks.mrpt.rays import MrptRays
from beamfield.stacks.nav2.models import Nav2Beam, Nav2Field, Nav2FieldProb
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.registry import parameter_class
from measure import least_seconds
from tables import print_table

ORACLE = Path(os.environ.get("BEAMFIELD_SHARED", Path(__file__).resolve().parents[2] / "shared")) / "oracle"
KINDS = (Nav2Field, Nav2FieldProb, Nav2Beam, BelugaField, BelugaFieldProb, BelugaBeam)
MRPT_KINDS = (MrptField, MrptRays)
# range_libc's ray methods whose ranges the oracle has.
METHODS = ("bl", "rm", "cddt112")
COMMON = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")


def main() -> None:
    """Print Markdown tables: agreement, range_libc's rays, what the approximations and the cut change, and times."""
    with past_the_message():
        answered = agreement(), range_methods()
    for rows in (*answered, approximations(), cuts(), times()):
        if rows:
            print_table(rows)
            print()


@contextmanager
def past_the_message() -> Iterator[None]:
    """Take resolutions as they are: the compiled programs got their maps past the message's single precision."""
    modules = ("emulation.stack_map", "f1tenth.table")
    patches = [patch(f"beamfield.stacks.{module}.message_resolution", float) for module in modules]
    with patches[0], patches[1]:
        yield


def agreement() -> list[dict[str, Any]]:
    """Return the largest difference from each program's own weights over the poses of both oracle maps."""
    if not ORACLE.is_dir():
        return []
    rows = []
    cases = [_oracle_case(name) for name in ("tiny", "building")]
    for kind in (*KINDS, *MRPT_KINDS):
        row: dict[str, Any] = {"emulator": kind.__name__}
        for title, options in (("as the program", _program(kind)), ("exact", _exact(kind))):
            worst = 0.0
            for grid, scan, poses, values, answers in cases:
                parameters = _oracle_parameters(kind, values)
                mode = "trinary" if kind in MRPT_KINDS else "raw"
                got = kind(grid, parameters, map_mode=mode, **options).log_likelihood(scan, poses)
                worst = max(worst, np.abs(np.expm1(got - _log_answer(kind, answers))).max())
            row[f"{title}: largest relative difference of a weight"] = f"{worst:.1e}"
        rows.append(row)
    return rows


def range_methods() -> list[dict[str, Any]]:
    """Return F1TENTH's weights on range_libc's own ranges against its answers, and what exact rays change."""
    if not ORACLE.is_dir():
        return []
    rows = []
    for name in ("tiny", "building"):
        grid, scan, poses, values, answers = _oracle_case(name)
        parameters = F1tenthParameters(
            **{factor: values[factor] for factor in ("z_hit", "z_short", "z_max", "z_rand")},
            sigma_hit=values["sigma_hit"] / grid.resolution,
            max_range=values["max_range"],
            angle_step=1,
            squash_factor=1.0,
        )
        model = F1tenthTable(grid, parameters, map_mode="raw")
        evidence = model.evidence(scan, poses)
        for method in METHODS:
            ranges = np.reshape(answers["f1tenth"][f"{method}_ranges_PxK"], evidence.expected_ranges.shape)
            log_weights = np.log(answers["f1tenth"][f"{method}_weights_oneshot"])
            on_its_own = model.log_weights(replace(evidence, expected_ranges=ranges))
            worst = np.abs(np.expm1(on_its_own - log_weights)).max()
            change = (model.log_weights(evidence) - log_weights) / F1tenthParameters().squash_factor
            cells = np.abs(np.minimum(ranges, parameters.max_range) - evidence.expected_ranges) / grid.resolution
            rows.append(
                {
                    "map": name,
                    "rays": method,
                    "largest relative difference on its ranges": f"{worst:.1e}",
                    "ranges off by > 1 cell": f"{(cells > 1.0).mean():.0%}",
                    "spread of log w [nats]": f"{log_weights.std() / F1tenthParameters().squash_factor:.2g}",
                    "exact rays: median change [nats]": f"{np.median(np.abs(change - change.mean())):.2g}",
                    "largest [nats]": f"{np.abs(change - change.mean()).max():.2g}",
                }
            )
    return rows


def approximations() -> list[dict[str, Any]]:
    """Return how much exact distances and ranges change log-weights, at the stacks' defaults, on a synthetic office."""
    grid, scan, sets = _scene()
    rows = []
    for kind in (*KINDS, *MRPT_KINDS):
        parameters = _defaults(kind)
        program, exact = (kind(grid, parameters, **options) for options in (_program(kind), _exact(kind)))
        for name, poses in sets.items():
            a, b = program.log_likelihood(scan, poses), exact.log_likelihood(scan, poses)
            # What matters is how weights of one scan compare.
            change = np.abs((a - a.mean()) - (b - b.mean()))
            rows.append(
                {
                    "emulator": kind.__name__,
                    "poses": name,
                    "spread of log w [nats]": f"{a.std():.2g}",
                    "median change [nats]": f"{np.median(change):.1e}",
                    "largest [nats]": f"{change.max():.1e}",
                }
            )
    return rows


def cuts() -> list[dict[str, Any]]:
    """Return what exact distances change where they are cut off early, and what cutting at metres would change.

    nav2's likelihood_field_prob, sigma_hit 0.2, in the office.
    """
    grid, scan, sets = _scene()
    rows = []
    for limit in (0.12, 0.3, 0.5, 0.7, 2.0):
        parameters = replace(_defaults(Nav2FieldProb), laser_likelihood_max_dist=limit)
        program, exact = (Nav2FieldProb(grid, parameters, distance=way) for way in ("brushfire", "exact"))
        for name, poses in sets.items():
            evidence = exact.evidence(scan, poses)
            d = np.minimum(evidence.distances.astype(np.float64), limit)
            hits = parameters.z_hit * np.exp(-0.5 * (d / parameters.sigma_hit) ** 2)
            in_metres = np.log(hits + parameters.z_rand / evidence.max_range).sum(axis=1)
            a, b = program.log_likelihood(scan, poses), exact.log_weights(evidence)
            change, cut = (
                np.abs((a - a.mean()) - (b - b.mean())),
                np.abs((b - b.mean()) - (in_metres - in_metres.mean())),
            )
            rows.append(
                {
                    "laser_likelihood_max_dist [m]": f"{limit:g}",
                    "poses": name,
                    "spread of log w [nats]": f"{a.std():.2g}",
                    "exact: median change [nats]": f"{np.median(change):.1e}",
                    "largest": f"{change.max():.1e}",
                    "cut at metres: median change [nats]": f"{np.median(cut):.1e}",
                    "largest of it": f"{cut.max():.1e}",
                }
            )
    return rows


def times() -> list[dict[str, Any]]:
    """Return milliseconds for 2000 poses and 60 beams."""
    grid, scan, sets = _scene()
    poses = sets["track"]
    rows = []
    for kind in (*KINDS, *MRPT_KINDS, F1tenthTable):
        parameters = _defaults(kind)
        model = kind(grid, parameters)
        evidence = model.evidence(scan, poses)
        row: dict[str, Any] = {
            "emulator": kind.__name__,
            "evidence [ms]": _least_ms(lambda model=model: model.evidence(scan, poses)),
            "log_weights [ms]": _least_ms(lambda model=model, evidence=evidence: model.log_weights(evidence)),
        }
        row["evidence, exact rays [ms]"] = ""
        if kind.model in ("beam", "rayTracing"):
            exact = kind(grid, parameters, rays="exact")
            row["evidence, exact rays [ms]"] = _least_ms(lambda exact=exact: exact.evidence(scan, poses))
        rows.append(row)
    return rows


def _program(kind: Any) -> dict[str, str]:
    if kind is MrptField:
        return {"precision": "single"}
    return {} if kind.model in ("beam", "rayTracing") else {"distance": "brushfire"}


def _exact(kind: Any) -> dict[str, str]:
    if kind is MrptField:
        return {"precision": "double"}
    return {"rays": "exact"} if kind.model in ("beam", "rayTracing") else {"distance": "exact"}


def _defaults(kind: Any) -> Any:
    """Return the stack's defaults; those that thin out beams are for longer scans than this one."""
    every = {"LF_Thrun": {"LF_decimation": 1}, "rayTracing": {"rayTracing_decimation": 1}, "table": {"angle_step": 1}}
    return parameter_class(kind.stack, kind.model)(**every.get(kind.model, {}))


def _scene() -> tuple[OccupancyGrid, Scan, dict[str, np.ndarray]]:
    rng = np.random.default_rng(7)
    grid = office(rng)
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, N_BEAMS, endpoint=False), MAX_RANGE)
    truth = np.array([25.0, 25.0, 0.3])
    scan = BeamModel(grid, PARAMETERS).sample(truth, finder, rng)[0]
    return grid, scan, {"track": near(truth, rng, N_POSES), "global": anywhere(grid, rng, N_POSES)}


def _oracle_parameters(kind: Any, values: Mapping[str, float]) -> Any:
    if kind is MrptField:
        return MrptFieldParameters(
            LF_stdHit=values["sigma_hit"], LF_zHit=values["z_hit"], LF_zRandom=values["z_rand"], LF_decimation=1,
            LF_maxRange=values["max_range"], LF_maxCorrsDistance=values["max_occ_dist"],
        )  # fmt: skip
    if kind is MrptRays:
        return MrptRayParameters(rayTracing_stdHit=values["sigma_hit"], rayTracing_decimation=1)
    shared = {name: values[name] for name in COMMON}
    shared |= {"laser_likelihood_max_dist": values["max_occ_dist"], "max_beams": int(values["n_beams"])}
    if kind.stack == "nav2":
        return Nav2Parameters(**shared)
    beluga = BelugaParameters(**shared, only_obstacle_boundaries=False)
    return replace(beluga, laser_max_range=values["max_range"])


def _oracle_case(name: str) -> tuple[OccupancyGrid, Scan, np.ndarray, dict[str, float], dict[str, Any]]:
    inputs, *answers = (_flat(ORACLE / name, part) for part in ("inputs", "nav2", "beluga", "mrpt", "rangelibc"))
    cells = np.reshape(inputs["map.data"], (int(inputs["map.height"]), int(inputs["map.width"])))
    grid = OccupancyGrid.from_ros(cells, float(inputs["map.resolution"]), [*inputs["map.origin"], 0.0])
    values = {k.removeprefix("params."): float(v) for k, v in inputs.items() if k.startswith("params.")}
    values["n_beams"] = len(inputs["bearings"])
    scan = Scan(inputs["ranges"], RangeFinder.from_bearings(inputs["bearings"], values["max_range"]))
    return (
        grid,
        scan,
        np.asarray(inputs["poses"]),
        values,
        dict(zip(("nav2", "beluga", "mrpt", "f1tenth"), answers, strict=True)),
    )


def _log_answer(kind: Any, answers: Mapping[str, Any]) -> np.ndarray:
    if kind in MRPT_KINDS:
        return np.asarray(answers["mrpt"]["log_lmLikelihoodField_Thrun" if kind is MrptField else "log_lmRayTracing"])
    return np.log(answers[kind.stack][kind.model])


def _flat(folder: Path, name: str) -> dict[str, Any]:
    if (folder / f"{name}.npz").is_file():
        with np.load(folder / f"{name}.npz") as file:
            return dict(file)
    flat: dict[str, Any] = {}
    for key, value in json.loads((folder / f"{name}.json").read_text()).items():
        flat |= {f"{key}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
    return {k: v if isinstance(v, str) else np.array(v, dtype=np.float64) for k, v in flat.items()}


def _least_ms(function: Callable[[], object]) -> str:
    return f"{1e3 * least_seconds(function):.2f}"


if __name__ == "__main__":
    set_threads(1)
    main()
