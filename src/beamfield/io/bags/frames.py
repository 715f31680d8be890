"""Coordinate frames as robots publish them on /tf: chains of rigid motions in space, interpolated in time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray, yaw_from_quaternion

QUATERNION_TOLERANCE = 0.01  # tf2 refuses quaternions whose length is further than this from 1
# Static transforms that differ by more, metres in one axis and 1 - cos of half an angle (2 degrees), contradict each
# other.
SAME_PLACE, SAME_HEADING = 0.005, 1.5e-4
FARTHEST = 1e9  # metres; what lies further away is a damaged number, and overflows when transforms are multiplied


@dataclass(frozen=True, eq=False)
class Transforms:
    """Rigid motions in space, a_from_b, one per row.

    Parameters
    ----------
    translation
        (n, 3) position of b in a, metres.
    rotation
        (n, 4) unit quaternions x, y, z, w: the orientation of b in a.
    """

    translation: FloatArray
    rotation: FloatArray

    @classmethod
    def identity(cls, n: int) -> Transforms:
        """Return n motions that move nothing."""
        return cls(np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)))

    def __matmul__(self, b_from_c: Transforms) -> Transforms:
        return Transforms(
            self.translation + rotate(self.rotation, b_from_c.translation), _multiply(self.rotation, b_from_c.rotation)
        )

    def inverse(self) -> Transforms:
        """Return b_from_a."""
        back = self.rotation * [-1.0, -1.0, -1.0, 1.0]
        return Transforms(-rotate(back, self.translation), back)

    def planar(self) -> FloatArray:
        """Return (n, 3) poses x, y, heading: the position without its height, and where the x axis points."""
        return np.column_stack([self.translation[:, :2], yaw_from_quaternion(*self.rotation.T)])


class TransformBuffer:
    """All transforms of a log, and the frames that they connect; the path is for errors.

    A leading slash of a frame's name, as ROS 1 has it, is dropped. Where a frame has several parents the shortest chain
    is taken. Interpolation is linear for positions and spherical for orientations, between the two neighbours in time,
    and never beyond the first or last of them, as tf2 does it.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = path
        self._edges: dict[tuple[str, str], _Edge] = {}
        self._neighbours: dict[str, list[str]] = {}

    def add(self, parent: str, child: str, stamp: float, translation: Sequence[float], rotation: Sequence[float],
            *, static: bool = False, place: str = "", depth: int = 0) -> None:  # fmt: skip
        """Add one transform, the pose of `child` in `parent`, with a quaternion x, y, z, w; `place` is for errors.

        Of transforms between the same two frames, those from the topic deepest in namespaces count: the robot's own.

        Names that are empty, and a frame in itself, say nothing and are skipped. A static one holds at all times,
        whatever its stamp; the last one given counts.
        """
        parent, child = strip_slash(parent), strip_slash(child)
        if not parent or not child or parent == child:
            return
        edge = self._edges.get((parent, child))
        if edge is None:
            edge = self._edges[(parent, child)] = _Edge()
            self._neighbours.setdefault(parent, []).append(child)
            self._neighbours.setdefault(child, []).append(parent)
        # Numbers here and now: a bag may define the fields as it likes, and this is where errors name the message.
        edge.add(float(stamp), tuple(map(float, (*translation, *rotation))), static, place, depth)

    def __len__(self) -> int:
        return len(self._edges)

    def __contains__(self, frame: object) -> bool:
        return frame in self._neighbours

    @property
    def frames(self) -> list[str]:
        """Names of all frames, in the order of appearance."""
        return list(self._neighbours)

    @property
    def has_static(self) -> bool:
        """Whether any transform holds at all times."""
        return any(edge.static for edge in self._edges.values())

    def all_if_whole(self) -> tuple[str, ...]:
        """Return the names of all frames; none if transforms at all times, or others, were not recorded."""
        kinds = {bool(edge.static) for edge in self._edges.values()}
        return tuple(self._neighbours) if len(kinds) == 2 else ()

    def connected(self, target: str, source: str) -> bool:
        """Whether a chain of transforms leads from one frame to the other."""
        return self._chain(target, source) is not None

    def nearest_first(self, frame: str, others: Iterable[str]) -> list[str]:
        """Return other frames by the number of transforms that lead to them, those not connected last."""
        chains = {other: self._chain(frame, other) for other in others}
        return sorted(chains, key=lambda other: len(chains[other] or self._neighbours))

    def describe(self) -> str:
        """Return the trees of frames in words, for messages."""
        trees = self._trees()
        return "; ".join(f"{{{_shortened(tree)}}}" for tree in trees) if trees else "no frames at all"

    def look_up(self, target: str, source: str, stamps: ArrayLike, *, max_gap: float = np.inf,
                hold: bool = False) -> Transforms:  # fmt: skip
        """Return target_from_source at each stamp (n,), NaN where a link of the chain is not known at that time.

        The longest time between two transforms that is interpolated is max_gap seconds. With `hold`, the first and the
        last also hold before and after: for parts that do not move. FormatError if the frames are not connected (the
        text names both, and the trees that are known), or a transform on the chain is not finite or not a rotation.
        """
        chain = self._chain(target, source)
        if chain is None:
            raise FormatError(
                self._path,
                f"no chain of transforms connects the frames {target!r} and {source!r}; the log has {self.describe()}",
            )
        when = np.atleast_1d(np.asarray(stamps, dtype=np.float64))
        result = Transforms.identity(len(when))
        for a, b in pairwise(chain):
            forward = (a, b) in self._edges
            step = self._edge((a, b) if forward else (b, a)).at(when, max_gap, hold)
            result = result @ (step if forward else step.inverse())
        return result

    def stamps_between(self, target: str, source: str) -> FloatArray:
        """Return the stamps of the most frequent transform on the chain; empty if all are static or none connects."""
        chain = self._chain(target, source) or []
        links = [self._edge((a, b) if (a, b) in self._edges else (b, a)) for a, b in pairwise(chain)]
        moving = [link.stamps for link in links if not link.static]
        return max(moving, key=len, default=np.empty(0))

    def first_stamps(self, target: str, source: str) -> FloatArray:
        """Return the stamps of the first transform on the chain from target to source, as `stamps_between` does."""
        chain = self._chain(target, source) or []
        return self.stamps_between(*chain[:2]) if len(chain) > 1 else np.empty(0)

    def contradictions(self, target: str, source: str) -> list[str]:
        """Return in words which transforms on the chain hold at all times, but were published with several values."""
        links = [(a, b) if (a, b) in self._edges else (b, a) for a, b in pairwise(self._chain(target, source) or [])]
        return [f"{a!r} to {b!r}" for a, b in links if self._edge((a, b)).contradicts_itself]

    def _edge(self, key: tuple[str, str]) -> _Edge:
        edge = self._edges[key]
        edge.settle()
        if edge.fault:
            raise FormatError(self._path, f"transform from {key[0]!r} to {key[1]!r}: {edge.fault}", field=edge.place)
        return edge

    def _chain(self, target: str, source: str) -> list[str] | None:
        """Return the frames from target to source, by breadth-first search."""
        if target not in self or source not in self:
            return [target] if target == source else None
        came_from: dict[str, str | None] = {source: None}
        frontier = [source]
        while frontier and target not in came_from:
            reached = [(n, f) for f in frontier for n in self._neighbours[f]]
            frontier = []
            for frame, previous in reached:
                if frame not in came_from:
                    came_from[frame] = previous
                    frontier.append(frame)
        if target not in came_from:
            return None
        chain: list[str] = []
        step: str | None = target
        while step is not None:
            chain.append(step)
            step = came_from[step]
        return chain

    def _trees(self) -> list[list[str]]:
        trees: list[list[str]] = []
        seen: set[str] = set()
        for frame in self._neighbours:
            if frame in seen:
                continue
            tree = [frame]
            seen.add(frame)
            for member in tree:  # grows while it is walked
                new = [n for n in self._neighbours[member] if n not in seen]
                seen.update(new)
                tree += dict.fromkeys(new)
            trees.append(tree)
        return trees


def strip_slash(frame: str) -> str:
    """Return a frame's name without the leading slash of ROS 1."""
    return frame.lstrip("/")


def rotate(rotation: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return vectors (n, 3) turned by unit quaternions (n, 4), x, y, z, w."""
    axis, w = rotation[..., :3], rotation[..., 3:]
    cross = np.cross(axis, vectors)
    return vectors + 2.0 * (w * cross + np.cross(axis, cross))


def _multiply(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the Hamilton product of quaternions (n, 4), x, y, z, w."""
    vector = p[:, 3:] * q[:, :3] + q[:, 3:] * p[:, :3] + np.cross(p[:, :3], q[:, :3])
    scalar = p[:, 3] * q[:, 3] - np.sum(p[:, :3] * q[:, :3], axis=1)
    return np.column_stack([vector, scalar])


def _shortened(names: Iterable[str]) -> str:
    listed, limit = [repr(name) for name in names], 12
    return ", ".join(listed[:limit]) + (f" and {len(listed) - limit} more" if len(listed) > limit else "")


@dataclass(eq=False)
class _Edge:
    """The transforms from one frame to another over time."""

    static: bool = False
    fault: str = ""
    place: str = ""
    depth: int = 0
    contradicts_itself: bool = False
    stamps: FloatArray = field(default_factory=lambda: np.empty(0))
    _samples: list[tuple[float, ...]] = field(default_factory=list)
    _places: list[str] = field(default_factory=list)
    _values: FloatArray = field(default_factory=lambda: np.empty((0, 7)))

    def add(self, stamp: float, values: tuple[float, ...], static: bool, place: str, depth: int) -> None:
        if depth < self.depth:
            return
        if depth > self.depth:
            self.depth, self.static, self._samples, self._places = depth, False, [], []
        if static:
            self.static = True
        self._samples.append((stamp, *values))
        self._places.append(place)
        self.stamps = np.empty(0)

    def settle(self) -> None:
        """Sort by time; where stamps are equal the last one counts. Finds what is not a transform."""
        if len(self.stamps):
            return
        table = np.array(self._samples, dtype=np.float64)
        bad = find_fault(table[:, 1:])
        if bad is not None:
            row, self.fault = bad
            self.place = self._places[row]
            return
        table[:, 4:] /= np.linalg.norm(table[:, 4:], axis=1, keepdims=True)
        if self.static:
            apart = np.abs(table[:, 1:4] - table[-1, 1:4]).max()
            turned = 1.0 - np.abs(table[:, 4:] @ table[-1, 4:]).min()
            self.contradicts_itself = bool(apart > SAME_PLACE or turned > SAME_HEADING)
            table = table[-1:]
        order = np.argsort(table[:, 0], kind="stable")
        table = table[order]
        last = np.append(np.diff(table[:, 0]) > 0, True)
        self.stamps, self._values = table[last, 0], table[last, 1:]

    def at(self, when: FloatArray, max_gap: float, hold: bool) -> Transforms:
        times, values = self.stamps, self._values
        if self.static:
            rows = np.repeat(values, len(when), axis=0)
            return Transforms(rows[:, :3], rows[:, 3:])
        asked = np.clip(when, times[0], times[-1]) if hold else when
        after = np.minimum(np.searchsorted(times, asked, side="left"), len(times) - 1)
        before = np.where(times[after] <= asked, after, np.maximum(after - 1, 0))
        gap = times[after] - times[before]
        fraction = np.divide(asked - times[before], gap, out=np.zeros_like(asked), where=gap > 0)[:, None]
        a, b = values[before], values[after]
        translation = a[:, :3] + fraction * (b[:, :3] - a[:, :3])
        rotation = _slerp(a[:, 3:], b[:, 3:], fraction)
        unknown = (asked < times[0]) | (asked > times[-1]) | (gap > max_gap)
        translation[unknown] = np.nan
        rotation[unknown] = np.nan
        return Transforms(translation, rotation)


def find_fault(values: FloatArray) -> tuple[int, str] | None:
    """Return the first row (x, y, z, qx, qy, qz, qw) that is not a transform, and why."""
    with np.errstate(invalid="ignore"):
        finite = np.asarray((np.abs(values) < FARTHEST).all(axis=1))
    length = np.linalg.norm(np.where(finite[:, None], values, 0.0)[:, 3:], axis=1)
    bad = np.flatnonzero(~finite | (np.abs(length - 1.0) > QUATERNION_TOLERANCE))
    if len(bad) == 0:
        return None
    row = int(bad[0])
    if not finite[row]:
        return row, f"expected finite numbers below {FARTHEST:g}, got {values[row].tolist()}"
    return row, f"expected a quaternion of length 1, got {values[row, 3:].tolist()}"


def _slerp(a: FloatArray, b: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the unit quaternions between a and b (n, 4), the short way round, at fractions (n, 1)."""
    cosine = np.sum(a * b, axis=1, keepdims=True)
    b = np.where(cosine < 0, -b, b)
    # The angle from the chord stays exact for small turns, where arccos of the product loses half its digits.
    angle = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(b - a, axis=1, keepdims=True), 0.0, 1.0))
    sine = np.sin(angle)
    near = sine < 1e-9
    safe = np.where(near, 1.0, sine)
    weight_a = np.where(near, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / safe)
    weight_b = np.where(near, fraction, np.sin(fraction * angle) / safe)
    mixed = weight_a * a + weight_b * b
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))
