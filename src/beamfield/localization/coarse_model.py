"""Weighs scans until a robot that can be anywhere is found: bluntly, and with an eye on beams through walls."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import as_count, check_fields, checked, keep
from beamfield.geometry import FloatArray, as_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import BEAMS, passing_shares
from beamfield.maps.raycast import RayCaster
from beamfield.maps.solids import hollowed
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import Scan, usable_ranges
from beamfield.short_repr import short_repr

# Two places are told apart over many metres, on which the same errors of the map are seen again and again: by narrower
# fields, or scans that count more, the filter is sure of a wrong place (docs/evidence/localization.md).
PARAMETERS = LikelihoodFieldParameters(z_hit=0.88, z_rand=0.12, sigma_hit=0.2)
WORTH = 1.8
# Where the map is wrong, up to two fifths of the beams pass its walls at the right place. More than half speak against
# a place: each further tenth by so many nats / 10.
USUAL_THROUGH, THROUGH = 0.5, 18.0
# Poses whose expected ranges are compared at a time: they stay in the cache.
BATCH = 4096


@dataclass(frozen=True, eq=False)
class CoarseModel:
    """Weighs scans by a coarse likelihood field, and by how many beams would have passed through walls.

    For a robot that can be anywhere on a map that is not quite right. End points alone take a place amid racks or
    clutter for the right one, since a field sees through walls; the beam model gives up the right place where walls are
    drawn too thick or too near. This model lets half of a scan's beams pass walls for nothing, then each tenth costs
    1.8 nats. A scan counts as 1.8 independent beams. Of cones only the ends count: walls seen askew send no echo back.

    Parameters
    ----------
    grid
        The map. Solids are hollow.
    n_beams
        So many beams of each scan count, equally spaced.

    Raises
    ------
    InvalidInputError
        If n_beams < 1.

    References
    ----------
    Probabilistic Robotics, section 6.4 and 6.4.2, for the field and what it does not see.

    Examples
    --------
    >>> from beamfield import RangeFinder, draw_floor_plan
    >>> grid = draw_floor_plan(seed=1)
    >>> scan = Scan([4.0, 4.0, 4.0], RangeFinder.from_bearings([-1.5, 0.0, 1.5], max_range=12.0))
    >>> CoarseModel(grid, n_beams=3).log_likelihood(scan, [[3.0, 4.0, 0.0]]).shape
    (1,)
    """

    is_normalized: ClassVar[bool] = False

    grid: OccupancyGrid
    n_beams: int = BEAMS
    _field: LikelihoodFieldModel = field(init=False, repr=False)
    _caster: RayCaster = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        as_count(self.n_beams, "n_beams", least=1)
        ends = LikelihoodFieldModel(hollowed(self.grid), PARAMETERS)
        keep(self, _field=ends, _caster=RayCaster(self.grid))

    @checked
    def log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return log p(z | x, m) of one scan at many poses, up to a constant.

        Parameters
        ----------
        z
            The scan.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        places = as_poses(poses)
        scan = z.every(self.n_beams)
        values: FloatArray = min(1.0, WORTH / max(len(scan.ranges), 1)) * self._field.log_likelihood(scan, places)
        if scan.finder.opening_angle > 0.0:
            return values
        ranges = usable_ranges(scan.ranges, scan.finder)
        measured = np.flatnonzero(~np.isnan(ranges))
        ranges, finder = ranges[measured], scan.finder.subset(measured)
        rows, costs = places.reshape(-1, 3), values.reshape(-1)
        for i in range(0, len(rows), BATCH):
            expected = self._caster.expected_ranges(rows[i : i + BATCH], finder)
            through = passing_shares(ranges, expected, self.grid, finder.max_range)
            costs[i : i + BATCH] -= THROUGH * np.maximum(through - USUAL_THROUGH, 0.0)
        return costs.reshape(values.shape)
