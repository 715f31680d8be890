"""Parameters of nav2's AMCL that its measurement models use, with its names and defaults."""

from __future__ import annotations

from beamfield.stacks.amcl.parameters import AmclParameters


class Nav2Parameters(AmclParameters):
    """What stands under ``amcl: ros__parameters:`` about the laser; see `AmclParameters`."""
