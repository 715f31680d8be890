"""Which tests a fleet's runs allow: where one was not made, nothing was found because nobody looked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from beamfield.fleet.comparison import COMPARISON_TAKES, FEWEST_ROBOTS, Difference
from beamfield.fleet.daily import UNITS
from beamfield.fleet.drift import FEWEST_DAYS, Drift
from beamfield.fleet.stale_map import StaleMap

# A wall that is new takes two days to be told from a trolley that was parked for one.
FEWEST_MAP_DAYS = 2
FROM_ODOMETRY = ("turned-mount", "wheel-scale")
OVER_DAYS, AGAINST_OTHERS = "change over the days", "comparison with other robots"


@dataclass(frozen=True)
class MadeTest:
    """A test, and of how many robots or maps it could be made.

    Parameters
    ----------
    name
        What is tested.
    made, of
        How many were tested, and how many there are.
    what
        "robot" or "map".
    takes
        What the test needs.
    """

    name: str
    made: int
    of: int
    what: str
    takes: str

    @property
    def sentence(self) -> str:
        """Say how many were tested."""
        count = f"{self.made} of {self.of} {self.what}{'s' * (self.of != 1)}"
        return f"{self.name}: {count} tested; it takes {self.takes}"


def untested_of(drifts: Sequence[Drift]) -> tuple[str, ...]:
    """Return the tests that were not made of a robot, and the faults that none of those made looks for.

    The drifts are all of the robot, alarms or not.
    """
    tests = [
        name
        for name, over_days in ((OVER_DAYS, True), (AGAINST_OTHERS, False))
        if not any((drift.since is not None) == over_days for drift in drifts)
    ]
    seen = {drift.fault for drift in drifts}
    return (*tests, *(kind.replace("-", " ") for kind in UNITS if seen and kind not in seen))


def made_tests(
    robots: Sequence[tuple[str, str]],
    drifts: Sequence[Drift],
    differences: Sequence[Difference],
    maps: Sequence[StaleMap],
) -> tuple[MadeTest, ...]:
    """Return all tests of a fleet, from name and site of each robot and what was found, and not found."""

    def of_robots(name: str, found: Sequence[Drift | Difference], takes: str) -> MadeTest:
        return MadeTest(name, len({(one.robot, one.site) for one in found}), len(robots), "robot", takes)

    days_needed = f"{2 * FEWEST_DAYS} days of runs"
    # Where nothing was tested, each fault would say the same once more.
    faults = [
        of_robots(
            kind.replace("-", " "),
            [one for one in drifts if one.fault == kind],
            f"a test over days or against other robots{', and odometry that shows it' * (kind in FROM_ODOMETRY)}",
        )
        for kind in UNITS
        if drifts
    ]
    n_maps = sum(one.days >= FEWEST_MAP_DAYS for one in maps)
    return (
        of_robots(OVER_DAYS, [one for one in drifts if one.since is not None], days_needed),
        of_robots(AGAINST_OTHERS, [one for one in drifts if one.since is None], COMPARISON_TAKES),
        *faults,
        of_robots("parameters", differences, f"{FEWEST_ROBOTS} robots with range finders of the same limits"),
        MadeTest("maps", n_maps, len(maps), "map", f"{FEWEST_MAP_DAYS} days of runs"),
    )
