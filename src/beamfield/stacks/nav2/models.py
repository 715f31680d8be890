"""nav2's AMCL: its three measurement models, emulated. Formulas and options are those of the base classes."""

from __future__ import annotations

from typing import ClassVar

from beamfield.stacks.amcl.beam import AmclBeam
from beamfield.stacks.amcl.field import AmclField
from beamfield.stacks.amcl.field_prob import AmclFieldProb
from beamfield.stacks.nav2.parameters import Nav2Parameters


class Nav2Field(AmclField[Nav2Parameters]):
    """nav2's likelihood_field; see `AmclField`.

    Examples
    --------
    >>> import numpy as np
    >>> from beamfield.maps.occupancy import OccupancyGrid
    >>> from beamfield.sensors import RangeFinder, Scan
    >>> wall = OccupancyGrid.from_ros([[0, 0, 0, 0, 100]], resolution=0.5)
    >>> model = Nav2Field(wall, Nav2Parameters(z_hit=0.5, z_rand=0.5, sigma_hit=0.2, max_beams=2))
    >>> scan = Scan([1.0, np.inf], RangeFinder.from_bearings([0.0, 0.1], max_range=5.0))
    >>> np.exp(model.log_likelihood(scan, [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])).round(4).tolist()
    [1.216, 1.001]
    """

    stack: ClassVar[str] = "nav2"


class Nav2FieldProb(AmclFieldProb[Nav2Parameters]):
    """nav2's likelihood_field_prob; see `AmclFieldProb`."""

    stack: ClassVar[str] = "nav2"


class Nav2Beam(AmclBeam[Nav2Parameters]):
    """nav2's beam model; see `AmclBeam`."""

    stack: ClassVar[str] = "nav2"
