"""The beam model of range finders: section 6.3, Table 6.1."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from beamfield.arguments import require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels.device import require_device
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_density import (
    as_view,
)
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.blind_zone import counted_from
from beamfield.models.range_mixture import GridCaster, RangeMixtureModel, RangeSource
from beamfield.sensors import RangeFinder, Scan
from beamfield.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class BeamModel(RangeMixtureModel):
    """p(z | x, m) of a range scan by ray casting: the product over beams of a mixture of four causes.

    For each beam, the expected range z* comes from casting the ray in the map; the reading is a hit of that obstacle,
    an unexpected object before it, no return, or random (6.12). Beams are taken as independent given pose and map
    (6.2). It is a proper density over scans, so values can be compared between parameters and with other models.

    Use it when wrong readings have physical causes that matter, for calibration, and where rays must not see through
    walls. It is not smooth in the pose: a likelihood field is the better choice for climbing hills and for scan
    matching in clutter.

    Parameters
    ----------
    grid
        The map.
    parameters
        Weights and shapes of the four densities; or what `read_beam_model` returns, which brings exponent and n_beams
        too.
    exponent
        Power of each beam's value (the alpha of 6.3.4), because neighbouring beams are dependent; None: 1, which leaves
        the product as it is, or what the parameters bring. With another value than 1 the result is no longer
        normalised over z.
    n_beams
        Use only so many beams of each scan (6.3.4): about equally spaced among those that carry a measurement, so that
        NaN and too close readings do not use up the number. None: all, or what the parameters bring.
    unknown
        Whether rays pass unknown cells ("free") or stop there ("occupied").
    finder
        The sensor, for `sample` and `expected`; scans bring their own.
    caster
        Where the expected ranges come from: a `RayCaster` that is there already, or a `RangeTable`, which is quicker
        for very many poses and less exact (6.3.4); None: a new `RayCaster`.
    device
        Where `log_likelihood` is computed: "cpu", or "cuda", a GPU (docs/gpu.md), where `expected` casts too.
        All else is computed on the CPU.

    Raises
    ------
    InvalidInputError
        If the exponent is not positive and finite, n_beams < 1, the caster is of another map or stops elsewhere; or if
        device is "cuda" and there is no GPU, or the caster is not a `RayCaster` there.
    MissingDependencyError
        If device is "cuda" and numba-cuda is not installed.

    Notes
    -----
    Readings follow `Scan`: NaN, and ranges below the sensor's min_range, contribute 0; ranges from max_range on are "no
    return" and have the probability z_max. The density is that of readings from min_range on, and the weights are
    shares of these. A pose inside an obstacle has z* = 0 for all beams, a ray that meets none has z* = max_range; both
    have finite values. See `beam_log_density` for what the chapter leaves open.

    Instances are immutable, can be pickled and may be used from several threads.

    References
    ----------
    Probabilistic Robotics, section 6.1, (6.2); 6.3.1, (6.4) to (6.12), Table 6.1; 6.3.4 for exponent, n_beams and
    caster.

    Examples
    --------
    >>> import numpy as np
    >>> from beamfield.sensors import Scan
    >>> room = np.zeros((40, 40))
    >>> room[[0, -1]] = 100
    >>> room[:, [0, -1]] = 100
    >>> grid = OccupancyGrid.from_ros(room, resolution=0.1)
    >>> parameters = BeamParameters(z_hit=0.8, z_short=0.1, z_max=0.05, z_rand=0.05, sigma_hit=0.1, lambda_short=0.5)
    >>> finder = RangeFinder.from_bearings([0.0, np.pi / 2], max_range=8.0)
    >>> model = BeamModel(grid, parameters)
    >>> model.log_likelihood(Scan([1.95, 0.95], finder), [[1.95, 2.95, 0.0], [2.95, 1.95, 0.0]]).round(2).tolist()
    [2.36, -7.95]
    """

    grid: OccupancyGrid
    parameters: BeamParameters
    exponent: float = field(default=None, kw_only=True)  # type: ignore[assignment]  # always there once constructed
    n_beams: int | None = field(default=None, kw_only=True)
    unknown: Literal["free", "occupied"] = field(default="free", kw_only=True)
    finder: RangeFinder | None = field(default=None, kw_only=True)
    caster: GridCaster | None = field(default=None, kw_only=True)
    device: Literal["cpu", "cuda"] = field(default="cpu", kw_only=True)
    _source: RangeSource = field(init=False, repr=False)

    __repr__ = short_repr

    def _make_source(self) -> RangeSource:
        require_device(self.device)
        if self.caster is None:
            return RayCaster(self.grid, unknown=self.unknown, device=self.device)
        if self.device == "cuda" and getattr(self.caster, "device", "cpu") != "cuda":
            raise InvalidInputError("caster: expected a RayCaster with device='cuda', or None, for device='cuda'")
        require(self.caster.unknown == self.unknown, "caster", f"unknown={self.unknown!r}", self.caster.unknown)
        if not _are_same(self.caster.grid, self.grid):
            raise InvalidInputError("caster: expected one of the model's grid, got one of another map")
        return self.caster

    def _add_up(self, scan: Scan, poses: FloatArray, out: FloatArray) -> None:
        caster = self._source
        if self.device == "cpu" or not isinstance(caster, RayCaster):
            super()._add_up(scan, poses, out)
            return
        finder = scan.finder
        view = as_view(self.parameters, finder.max_range, finder.min_range)
        ranges = counted_from(finder.min_range, scan.ranges, finder.max_range)
        caster.fill_sums_on_device(poses, finder, ranges, view, out)


def _are_same(one: OccupancyGrid, other: OccupancyGrid) -> bool:
    """Whether rays cannot tell two grids apart."""
    if one is other:
        return True
    fields = [(grid.shape, grid.resolution, grid.origin.tolist()) for grid in (one, other)]
    return fields[0] == fields[1] and bool(
        np.array_equal(one.occupied, other.occupied) and np.array_equal(one.free, other.free)
    )
