"""Corners: where two neighbouring walls meet (6.6.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamfield.arguments import checked, require
from beamfield.features.feature import Feature, polar_jacobian
from beamfield.features.straight_line import Line, axes
from beamfield.geometry import FloatArray, wrap_angle

# How many lines ahead the other wall of a corner is looked for.
NEXT_LINES = 3


@dataclass(frozen=True, eq=False)
class Corner(Feature):
    """The point where two walls meet.

    The measurement is (range, bearing, opening angle): the angle in radians, in (0, 2 pi), that the walls leave open
    towards the sensor. The corner of a room has pi / 2, the edge of a pillar 3 pi / 2.
    """


@checked
def find_corners(
    lines: Sequence[Line], *, max_distance: float = 0.3, min_turn: float = np.deg2rad(20.0)
) -> list[Corner]:
    """Return the corners between neighbouring lines of one scan.

    Parameters
    ----------
    lines
        As `find_lines` returns them: neighbours in the list are neighbours in the scan.
    max_distance
        How far the end of the one and the start of the other may be from where they meet, metres, beyond twice the
        spacing of the end points there. A wall that only passes behind the end of another has no corner with it.
    min_turn
        Least change of direction, radians: flatter corners have no sure place.

    Raises
    ------
    InvalidInputError
        If a limit makes no sense.
    """
    require(max_distance > 0.0, "max_distance", "a positive number of metres", max_distance)
    require(0.0 < min_turn < np.pi / 2, "min_turn", "(0, pi/2) radians", min_turn)
    corners = []
    for number in sorted({line.sweep for line in lines}):
        of_sweep = [line for line in lines if line.sweep == number]
        corners += [
            corner
            for place, one in enumerate(of_sweep)
            if (corner := first_meeting(one, of_sweep[place + 1 :] + of_sweep[:place], max_distance, min_turn))
        ]
    return corners


def first_meeting(one: Line, others: Sequence[Line], max_distance: float, min_turn: float) -> Corner | None:
    """Return the corner with the next wall: small objects in front may come between, and a full turn has no end."""
    corners = (meet(one, two, max_distance, min_turn) for two in others[:NEXT_LINES])
    return next((corner for corner in corners if corner is not None), None)


def meet(one: Line, two: Line, max_distance: float, min_turn: float) -> Corner | None:
    """Return the corner of two lines, or None if they do not meet in one."""
    turn = float(wrap_angle(two.heading - one.heading))
    if min(abs(turn), np.pi - abs(turn)) < min_turn:
        return None
    (normal_1, tangent_1), (normal_2, tangent_2) = axes(one.alpha), axes(two.alpha)
    normals = np.vstack([normal_1, normal_2])
    position: FloatArray = np.asarray(np.linalg.solve(normals, [one.rho, two.rho]), dtype=np.float64)
    missing = np.hypot(*np.transpose([position - one.end, position - two.start]))
    # At grazing incidence the end points lie far apart, and the last ones may have gone to the other wall.
    if np.any(missing > max_distance + 2.0 * np.array([one.spacing[1], two.spacing[0]])):
        return None
    # n . p = rho along each line, hence n . dp = d rho - (t . p) d alpha.
    by_line = np.zeros((2, 4))
    by_line[0, :2] = 1.0, -tangent_1 @ position
    by_line[1, 2:] = 1.0, -tangent_2 @ position
    jacobian = np.zeros((3, 4))
    jacobian[:2] = polar_jacobian(position) @ np.linalg.solve(normals, by_line)
    jacobian[2] = 0.0, 1.0, 0.0, -1.0
    distance, bearing = np.hypot(*position), np.arctan2(position[1], position[0])
    return Corner(
        measurement=np.array([distance, bearing, np.pi - turn]),
        covariance=jacobian @ both_covariances(one, two) @ jacobian.T,
        beams=np.concatenate([one.beams, two.beams]),
    )


def both_covariances(one: Line, two: Line) -> FloatArray:
    """Return the (4, 4) covariance of (rho_1, alpha_1, rho_2, alpha_2): different beams, hence no correlation."""
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = one.covariance[:2, :2]
    covariance[2:, 2:] = two.covariance[:2, :2]
    return covariance
