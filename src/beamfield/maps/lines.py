"""Maps of straight lines: walls as landmarks (6.6.2, Crowley 1989)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, checked, keep, require
from beamfield.detections import finite_copy
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.maps.map_ids import MapWithIds, as_map_ids
from beamfield.short_repr import short_repr

# Given lines and end points may miss each other by this much, metres: files have a few digits.
TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class LineMap(MapWithIds):
    """m = {m_1, ..., m_N}: straight lines x cos(alpha) + y sin(alpha) = rho of the map frame, perhaps with end points.

    (rho, alpha) and (-rho, alpha + pi) are the same line; the map keeps the pair with rho >= 0.

    Parameters
    ----------
    lines
        (n, 2) rho in metres and alpha in radians; at least one line. rho may be given with either sign.
    ids
        (n,) whole numbers >= 0, each once; left out, they are 1 to n.
    segments
        (n, 4) end points x1, y1, x2, y2 on the lines, metres, in any order; None if the lines have no ends.

    Raises
    ------
    InvalidInputError
        If a value is not finite, an id appears twice or is negative, an end point is more than a millimetre off its
        line, both ends of a segment are one point, or shapes do not fit.

    References
    ----------
    J. L. Crowley, "World modeling and position estimation for a mobile robot using ultrasonic ranging", IEEE
    International Conference on Robotics and Automation, 1989. Probabilistic Robotics, section 6.6.2.

    Examples
    --------
    >>> walls = LineMap([[2.0, 0.0], [-3.0, -np.pi / 2]])
    >>> walls.lines.round(3).tolist()
    [[2.0, 0.0], [3.0, 1.571]]
    """

    lines: FloatArray
    ids: NDArray[np.int64] = None  # type: ignore[assignment]  # always there once constructed
    segments: FloatArray | None = None

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self, lines: ArrayLike, ids: ArrayLike | None = None, segments: ArrayLike | None = None
        ) -> None: ...

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        given = finite_copy(self.lines, "lines")
        if given.ndim != 2 or given.shape[1] != 2 or not len(given):
            ends = given.ndim == 2 and given.shape[1] == 4
            hint = "; LineMap.from_segments(segments) takes end points" if ends else ""
            raise InvalidInputError(f"lines: expected shape (n, 2) with n >= 1, got {given.shape}{hint}")
        lines = normal_form(given)
        keep(self, lines=lines, ids=as_map_ids(self.ids, len(lines)))
        if self.segments is not None:
            segments = _checked_segments(self.segments)
            require(len(segments) == len(lines), "segments", f"shape ({len(lines)}, 4)", segments.shape)
            off = np.abs(_across(lines, segments.reshape(-1, 2, 2)) - lines[:, :1]).max(axis=1)
            if (off > TOLERANCE).any():
                i = int(off.argmax())
                raise InvalidInputError(f"segments: expected end points on their line, got {off[i]:.3g} m at index {i}")
            keep(self, segments=segments)

    @classmethod
    @checked
    def from_segments(cls, segments: ArrayLike, ids: ArrayLike | None = None) -> LineMap:
        """Build a map from end points; which end comes first makes no difference to a line.

        Parameters
        ----------
        segments
            (n, 4) x1, y1, x2, y2, metres.
        ids
            (n,) as for the class.

        Returns
        -------
        A map of n lines with end points.

        Raises
        ------
        InvalidInputError
            As for the class.

        Examples
        --------
        >>> LineMap.from_segments([[2.0, -1.0, 2.0, 3.0]]).lines.tolist()
        [[2.0, 0.0]]
        """
        ends = _checked_segments(segments)
        along = ends[:, 2:] - ends[:, :2]
        alpha = np.arctan2(-along[:, 0], along[:, 1])
        # The middle is nearer to the line than an end where rounding turns a short segment.
        middle = 0.5 * (ends[:, :2] + ends[:, 2:])
        rho = np.cos(alpha) * middle[:, 0] + np.sin(alpha) * middle[:, 1]
        return cls(np.column_stack([rho, alpha]), ids, ends)

    def __len__(self) -> int:
        return len(self.lines)

    def extents(self) -> FloatArray:
        """Return from where to where each segment goes along its line.

        Places along a line are measured from its point nearest to the origin, towards alpha + pi / 2.

        Returns
        -------
        (n, 2) metres, the lower first; -inf and inf without end points.
        """
        if self.segments is None:
            return np.tile([-np.inf, np.inf], (len(self), 1))
        cos, sin = np.cos(self.lines[:, 1:]), np.sin(self.lines[:, 1:])
        places = cos * self.segments[:, 1::2] - sin * self.segments[:, ::2]
        return np.sort(places, axis=1)


def normal_form(lines: FloatArray) -> FloatArray:
    """Return lines (..., 2) with rho >= 0 and alpha in (-pi, pi]; a line through the origin keeps its direction."""
    rho, alpha = lines[..., 0], lines[..., 1]
    # abs also turns -0 into 0.
    return np.stack([np.abs(rho), wrap_angle(np.where(rho < 0.0, alpha + np.pi, alpha))], axis=-1)


def _across(lines: FloatArray, points: FloatArray) -> FloatArray:
    """Return x cos(alpha) + y sin(alpha) of points (n, m, 2), (n, m)."""
    cos, sin = np.cos(lines[:, 1:]), np.sin(lines[:, 1:])
    return np.asarray(cos * points[..., 0] + sin * points[..., 1])


def _checked_segments(values: ArrayLike) -> FloatArray:
    segments = finite_copy(values, "segments")
    if segments.ndim != 2 or segments.shape[1] != 4 or not len(segments):
        raise InvalidInputError(f"segments: expected shape (n, 4) with n >= 1, got {segments.shape}")
    points = (segments[:, :2] == segments[:, 2:]).all(axis=1)
    if points.any():
        i = int(points.argmax())
        raise InvalidInputError(f"segments: expected two different ends, got {segments[i].tolist()} at index {i}")
    return segments
