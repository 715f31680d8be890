"""Straight lines of one observation, as a line extractor finds them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, keep, require, restore
from beamfield.detections import UNKNOWN, as_ids, finite_copy
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.indices import subset_of
from beamfield.maps.lines import normal_form
from beamfield.short_repr import short_repr


class MeasuredLine(Protocol):
    """What `LineDetections.from_lines` needs; `beamfield.features.straight_line.Line` has it."""

    @property
    def measurement(self) -> FloatArray:
        """(2,) or more: rho, alpha, and perhaps others."""
        ...

    @property
    def covariance(self) -> FloatArray:
        """(2, 2) or more, of the measurement."""
        ...

    @property
    def start(self) -> FloatArray:
        """(2,) one end point."""
        ...

    @property
    def end(self) -> FloatArray:
        """(2,) the other."""
        ...


@dataclass(frozen=True, eq=False)
class LineDetections:
    """Lines x cos(alpha) + y sin(alpha) = rho in the sensor's frame.

    (rho, alpha) and (-rho, alpha + pi) are the same line; the pair with rho >= 0 is kept, and with it the sign of the
    covariance between them.

    Parameters
    ----------
    lines
        (k, 2) rho in metres and alpha in radians; rho may be given with either sign, alpha with any number of turns.
    covariances
        (k, 2, 2) of each line's (rho, alpha), or (2, 2) of every line's; None if the detector gives none.
    segments
        (k, 4) end points x1, y1, x2, y2 in the sensor's frame, metres, in any order; None if there are none.
    ids
        (k,) id of each line in the map, `SPURIOUS` or `UNKNOWN`; None if none is known.

    Raises
    ------
    InvalidInputError
        If shapes differ, a value is not finite, a covariance is not symmetric and positive definite, or an id is below
        `UNKNOWN`.

    Examples
    --------
    The same wall, given with either sign of rho:

    >>> LineDetections([[2.0, 0.0], [-2.0, np.pi]]).lines.round(12).tolist()
    [[2.0, 0.0], [2.0, 0.0]]
    """

    lines: FloatArray
    covariances: FloatArray | None = None
    segments: FloatArray | None = None
    ids: NDArray[np.int64] | None = None

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            lines: ArrayLike,
            covariances: ArrayLike | None = None,
            segments: ArrayLike | None = None,
            ids: ArrayLike | None = None,
        ) -> None: ...

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        given = finite_copy(self.lines, "lines")
        if given.size == 0:
            given = given.reshape(0, 2)
        require(given.ndim == 2 and given.shape[1] == 2, "lines", "shape (k, 2)", given.shape)
        k = len(given)
        keep(self, lines=normal_form(given))
        if self.covariances is not None:
            covariances = _checked_covariances(self.covariances, k)
            turned = given[:, 0] < 0.0
            covariances[turned, 0, 1] *= -1.0
            covariances[turned, 1, 0] *= -1.0
            keep(self, covariances=covariances)
        if self.segments is not None:
            segments = finite_copy(self.segments, "segments")
            if segments.size == 0:
                segments = segments.reshape(0, 4)
            require(segments.shape == (k, 4), "segments", f"shape ({k}, 4)", segments.shape)
            keep(self, segments=segments)
        if self.ids is not None:
            keep(self, ids=as_ids(self.ids, k, UNKNOWN))

    @classmethod
    def from_lines(cls, lines: Iterable[MeasuredLine]) -> LineDetections:
        """Take the lines of a scan as `beamfield.features.lines.find_lines` returns them.

        Those are in the robot's frame, so that the model needs no mount.

        Parameters
        ----------
        lines
            Lines of one scan, perhaps none.

        Returns
        -------
        Detections with covariances and segments.

        Raises
        ------
        InvalidInputError
            As for the class.
        """
        found = list(lines)
        return cls(
            np.array([line.measurement[:2] for line in found]),
            np.array([line.covariance[:2, :2] for line in found]).reshape(-1, 2, 2),
            np.array([[*line.start, *line.end] for line in found]),
        )

    def __len__(self) -> int:
        return len(self.lines)

    def subset(self, features: ArrayLike) -> LineDetections:
        """Return only the given lines, in the given order.

        Parameters
        ----------
        features
            Indices, or a mask (k,).

        Returns
        -------
        The detections chosen.

        Raises
        ------
        InvalidInputError
            If the choice is neither indices that are there nor a mask of the right length.
        """
        return subset_of(self, features, len(self), "features", ("lines", "covariances", "segments", "ids"))

    def without_ids(self) -> LineDetections:
        """Return the same lines with all correspondences unknown.

        Returns
        -------
        The detections with `ids` None.
        """
        return replace(self, ids=None)


def _checked_covariances(values: ArrayLike, k: int) -> FloatArray:
    given = finite_copy(values, "covariances")
    require(given.shape in ((2, 2), (k, 2, 2)), "covariances", f"shape ({k}, 2, 2) or (2, 2)", given.shape)
    covariances: FloatArray = np.array(np.broadcast_to(given, (k, 2, 2)))
    for i, each in enumerate(covariances):
        scale = float(np.sqrt(max(each[0, 0], 0.0) * max(each[1, 1], 0.0)))
        # Judged on the correlation: rho and alpha have different units.
        if not (
            scale > 0.0 and abs(each[0, 1] - each[1, 0]) <= 1e-9 * scale and abs(each[0, 1]) < (1.0 - 1e-12) * scale
        ):
            raise InvalidInputError(
                f"covariances: expected symmetric, positive definite matrices, got {each.tolist()} at index {i}"
            )
    return covariances
