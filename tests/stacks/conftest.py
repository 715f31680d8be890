"""What other programs returned, and the inputs they had."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pytest

from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.nav2.parameters import Nav2Parameters
from tests.oracle_case import OracleCase

# Where the oracle's "offset sensor" sits; not part of its inputs, but its answers agree with no other place.
OFFSET_MOUNT = (0.1, -0.05, 0.3)


class StackCase(OracleCase):
    """What the stacks' programs returned, and their parameters."""

    @cached_property
    def nav2(self) -> dict:
        return self.answers("nav2")

    @cached_property
    def beluga(self) -> dict:
        return self.answers("beluga")

    @cached_property
    def mrpt(self) -> dict:
        return self.answers("mrpt")

    @cached_property
    def rangelibc(self) -> dict:
        return self.answers("rangelibc")

    @property
    def nav2_parameters(self) -> Nav2Parameters:
        return Nav2Parameters(**self._common())

    @property
    def beluga_parameters(self) -> BelugaParameters:
        """With the sensor's longest range, as the oracle had it, and the options of the map switched off."""
        return BelugaParameters(
            **self._common(), laser_max_range=self.values["max_range"], only_obstacle_boundaries=False
        )

    def _common(self) -> dict:
        v = self.values
        names = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
        numbers = {name: v[name] for name in names}
        return numbers | {"laser_likelihood_max_dist": v["max_occ_dist"], "max_beams": len(self.bearings)}

    def scan(self, kind: str = "") -> Scan:
        """The scan of the oracle's arrays that begin with `kind`."""
        mount = OFFSET_MOUNT if kind == "offset_sensor_" else (0.0, 0.0, 0.0)
        finder = RangeFinder.from_bearings(self.bearings, self.values["max_range"], mount=mount)
        if kind.startswith("special_"):
            # The oracle called libraries, past the nodes that treat 0 as too short: a range just above 0 gets through.
            return Scan(np.where(self.ranges_special == 0.0, 1e-12, self.ranges_special), finder)
        return Scan(self.ranges, finder)


@pytest.fixture
def past_the_message(monkeypatch):
    """Resolutions as they are: whoever compiled the programs gave them the map past the message's single precision."""
    for module in ("emulation.stack_map", "f1tenth.table"):
        monkeypatch.setattr(f"beamfield.stacks.{module}.message_resolution", float)


@pytest.fixture(scope="session")
def case(oracle_case) -> StackCase:
    return StackCase(**vars(oracle_case))
