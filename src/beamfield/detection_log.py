"""Logs of what a landmark sensor saw, with the pose of each observation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, keep, require, restore
from beamfield.detections import Detections, as_ids
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.indices import as_indices
from beamfield.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class DetectionLog:
    """Observations with the pose that each was made at: what a landmark sensor's noise is learned from.

    Parameters
    ----------
    poses
        (t, 3) true robot poses, metres and radians; a row of NaN where the pose is not known.
    detections
        The t observations; their stamps do not fall.
    places
        (t,) number of the stretch that each observation belongs to, where the errors of one stretch hang together
        more than time tells: the places of a robot that stands still, several runs. None if there are none.
    notes
        What a reader had to decide, for people.

    Raises
    ------
    InvalidInputError
        If numbers of rows differ, a pose is partly NaN or infinite, or a stamp falls or is not finite.

    Examples
    --------
    >>> seen = Detections([2.1], [0.3], ids=[7])
    >>> log = DetectionLog([[0.0, 0.0, 0.0]], (seen,))
    >>> len(log), len(log.detections[0])
    (1, 1)
    """

    poses: FloatArray
    detections: tuple[Detections, ...]
    places: NDArray[np.int64] | None = None
    notes: tuple[str, ...] = ()

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        keep(self, detections=tuple(self.detections))
        poses = np.array(self.poses, dtype=np.float64)
        require(poses.shape == (len(self), 3), "poses", f"shape ({len(self)}, 3)", poses.shape)
        if np.isinf(poses).any():
            raise InvalidInputError(f"poses: expected finite numbers or NaN, got {poses[np.isinf(poses)][0]}")
        missing = np.isnan(poses)
        partly = missing.any(axis=1) & ~missing.all(axis=1)
        if partly.any():
            i = int(partly.argmax())
            raise InvalidInputError(f"poses: expected numbers or a row of NaN, got {poses[i].tolist()} at index {i}")
        keep(self, poses=poses)
        stamps = self.stamps
        if not np.isfinite(stamps).all():
            raise InvalidInputError(f"stamps: expected finite numbers, got {stamps[~np.isfinite(stamps)][0]}")
        if (np.diff(stamps) < 0.0).any():
            i = int((np.diff(stamps) < 0.0).argmax())
            raise InvalidInputError(
                f"stamps: expected numbers that do not decrease, got {stamps[i + 1]} after {stamps[i]}"
            )
        if self.places is not None:
            keep(self, places=as_ids(self.places, len(self), 0))

    def __len__(self) -> int:
        return len(self.detections)

    @property
    def stamps(self) -> FloatArray:
        """(t,) seconds."""
        return np.array([seen.stamp for seen in self.detections], dtype=np.float64)

    def subset(self, observations: ArrayLike) -> DetectionLog:
        """Return only the given observations, indices or a mask (t,), in the log's order, with the same notes."""
        chosen = np.sort(as_indices(observations, len(self), "observations"))
        detections, places = tuple(self.detections[i] for i in chosen), self.places
        places = None if places is None else places[chosen]
        return replace(self, poses=self.poses[chosen], detections=detections, places=places)


def group_detections(
    observation: ArrayLike, stamps: ArrayLike, ranges: ArrayLike, bearings: ArrayLike, ids: ArrayLike
) -> tuple[Detections, ...]:
    """Return one `Detections` per observation from columns (n,) with one row per feature.

    `observation` is the index that each feature belongs to, in any order; features keep theirs. Stamps are (t,), one
    per observation; those without a feature get an empty one. InvalidInputError if an index is not in [0, t), or a
    value is not what `Detections` takes.
    """
    index, times = np.asarray(observation, dtype=np.int64), np.asarray(stamps, dtype=np.float64)
    if index.size and not 0 <= index.min() <= index.max() < len(times):
        raise InvalidInputError(
            f"observation: expected indices 0 to {len(times) - 1}, got {index.min()} to {index.max()}"
        )
    order = np.argsort(index, kind="stable")
    columns = [np.asarray(column)[order] for column in (ranges, bearings, ids)]
    ends = np.searchsorted(index[order], np.arange(len(times)), side="right")
    starts = np.concatenate([[0], ends[:-1]])
    return tuple(
        Detections(columns[0][a:b], columns[1][a:b], ids=columns[2][a:b], stamp=float(stamp))
        for a, b, stamp in zip(starts, ends, times, strict=True)
    )
