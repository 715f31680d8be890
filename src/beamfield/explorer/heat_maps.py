"""How likely a scan is at places around a pose, and all over the building."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from beamfield.explorer.parameter_set import ParameterSet
from beamfield.geometry import FloatArray
from beamfield.localization.lattice_noise import widened_field_for_lattice, widened_for_lattice
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.emulation.emulator import FieldModel
from beamfield.stacks.filters.scan_weights import ScanWeights

# Nats below the best at which a heat map is empty.
DEPTH = 12.0
# Places along a side and headings, a degree apart; half of both while the robot is dragged for slow models.
PLACES, HEADINGS, HEADING_STEP = 60, 36, np.radians(1.0)
# Rays that one heat map may cast while the robot is dragged, at rest, and over the building.
RAYS_DRAGGED, RAYS_AT_REST, RAYS_BUILDING = 2_600_000, 24_000_000, 45_000_000
FEWEST_BEAMS = 20
# Cells up to which it takes less to work out what each adds to a field than to do so for every end point.
TABLED_CELLS = 4_000_000
# Over the building: metres between places, at least; places, at most; headings of the full turn.
BUILDING_STEP, BUILDING_PLACES, BUILDING_HEADINGS = 0.25, 60_000, 36


Weigh = Callable[[Scan, FloatArray], FloatArray]


class Beams(NamedTuple):
    """Which of the beams that a model uses are looked at."""

    scan: Scan
    used: int
    of: int

    @property
    def scale(self) -> float:
        """What the logarithm is multiplied by, so that a choice of beams stands for all that the model uses."""
        return self.of / max(1, self.used)


def fewer_beams(one: ParameterSet, model: Any, scan: Scan, most: int) -> Beams:
    """Return a scan with at most so many of the beams that a model uses.

    Only rays are costly: models other than the beam model keep all.
    """
    if one.kind != "beam":
        return Beams(scan, 1, 1)
    used = model.used_beams(scan)
    if len(used) <= most:
        return Beams(scan, len(used), len(used))
    chosen = used[np.round(np.linspace(0, len(used) - 1, most)).astype(np.int64)]
    return Beams(scan.subset(chosen), most, len(used))


def quick_weights(one: ParameterSet, model: Any) -> Weigh | None:
    """Return what weighs a scan at many poses at once; None if that takes long.

    Of another program's field, what each cell of the map adds is worked out first.
    """
    if one.kind != "stack":
        return model.log_likelihood  # type: ignore[no-any-return]
    if isinstance(model, FieldModel) and model.takes_poses_alone() and model.grid.probability.size <= TABLED_CELLS:
        return partial(ScanWeights(model), converged=True)
    return None


def heat_around(
    one: ParameterSet, model: Any, weigh: Weigh | None, scan: Scan, pose: tuple[float, float, float], width: float, *,
    dragged: bool,
) -> dict[str, Any]:  # fmt: skip
    """Return how likely a scan is at 60 x 60 places around a pose, each with the best of 36 headings.

    The pose, in the middle of a square of this width in metres, is itself tried. While it is `dragged`, the next one is
    asked for at once: then of a beam model 20 beams stand for all, and a model without quick weights is tried at half
    as many places a side and headings.
    """
    coarse = 2 if dragged and weigh is None else 1
    n, n_headings = PLACES // coarse, HEADINGS // coarse
    steps = (np.arange(n) - n // 2) * (width / n)
    poses = np.empty((n, n, n_headings, 3))
    poses[..., 0] = pose[0] + steps[None, :, None]
    poses[..., 1] = pose[1] + steps[:, None, None]
    poses[..., 2] = pose[2] + coarse * HEADING_STEP * (np.arange(n_headings) - n_headings // 2)
    rays = RAYS_DRAGGED if dragged else RAYS_AT_REST
    beams = fewer_beams(one, model, scan, max(FEWEST_BEAMS, rays // (poses.size // 3)))
    each = beams.scale * (weigh or model.log_likelihood)(beams.scan, poses.reshape(-1, 3)).reshape(poses.shape[:-1])
    best = np.unravel_index(int(np.argmax(each)), each.shape)
    corner = steps[0] - 0.5 * width / n
    with np.errstate(invalid="ignore"):  # impossible everywhere
        over_here = finite(each[best] - each[n // 2, n // 2, n_headings // 2])
    return {
        "heat": _shades(each.max(axis=2)),
        "rows": n,
        "cols": n,
        "step_m": width / n,
        "origin": [pose[0] + corner, pose[1] + corner, 0.0],
        "best": poses[best],
        "best_over_here": over_here,
        "beams": [beams.used, beams.of],
    }


def heat_over(
    one: ParameterSet, values: Mapping[str, float], model: Any, scan: Scan, grid: OccupancyGrid
) -> dict[str, Any]:
    """Return how likely a scan is at all free places of a map.

    Notes
    -----
    Its places and headings are so far apart that peaks could fall between them: hits count as uncertain as that leaves
    them (`widened_for_lattice`). Other programs' models are taken as they are.
    """
    n_free = int(grid.free.sum())
    step = max(BUILDING_STEP, float(np.sqrt(n_free * grid.resolution**2 / BUILDING_PLACES)))
    n_poses = max(1.0, n_free * (grid.resolution / step) ** 2) * BUILDING_HEADINGS
    beams = fewer_beams(one, model, scan, max(FEWEST_BEAMS, int(RAYS_BUILDING / n_poses)))
    found = likelihood_map(
        _widened(one, values, model, scan, step), beams.scan, grid, resolution=step, headings=BUILDING_HEADINGS
    )
    return {
        "heat": _shades(beams.scale * np.where(found.evaluated, found.log_likelihood, -np.inf)),
        "rows": found.evaluated.shape[0],
        "cols": found.evaluated.shape[1],
        "step_m": step,
        "origin": found.origin,
        "best": found.best_pose,
        "beams": [beams.used, beams.of],
    }


def _widened(one: ParameterSet, values: Mapping[str, float], model: Any, scan: Scan, step: float) -> Any:
    if one.kind == "stack":
        return model
    if one.kind == "beam":
        wide = widened_for_lattice(model.parameters, resolution=step, headings=BUILDING_HEADINGS)
        return replace(model, parameters=wide)
    field = widened_field_for_lattice(model.parameters, scan, resolution=step, headings=BUILDING_HEADINGS)
    # Made anew: distances reach as far as its hits do.
    return one.make({**values, "sigma_hit": field.sigma_hit})


def _shades(log: FloatArray) -> str:
    """Return values as bytes in base64, row 0 first: 255 is the best, 0 is `DEPTH` nats below it and less."""
    with np.errstate(invalid="ignore"):
        shade = np.where(np.isfinite(log), 255.0 * (1.0 + (log - log.max()) / DEPTH), 0.0)
    return base64.b64encode(np.clip(shade, 0.0, 255.0).astype(np.uint8).tobytes()).decode()


def finite(value: float) -> float | None:
    """Return a number as strict JSON can hold it; None for one that is not finite."""
    return float(value) if np.isfinite(value) else None
