"""Feature-based maps: a list of landmarks with positions and signatures (6.6.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, keep, require
from beamfield.detections import finite_copy
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.maps.map_ids import MapWithIds, as_map_ids
from beamfield.short_repr import short_repr

SignatureKind = Literal["none", "number", "vector", "type"]


@dataclass(frozen=True, eq=False)
class LandmarkMap(MapWithIds):
    """m = {m_1, ..., m_N}: landmarks with a position in the map frame, an id and perhaps a signature.

    Parameters
    ----------
    positions
        (n, 2) metres; at least one landmark.
    ids
        (n,) whole numbers >= 0, each once; left out, they are 1 to n.
    signatures
        What a landmark looks like: (n,) numbers, (n, d) vectors, or (n,) types 0, 1, 2 ...; None if all look alike.
    kind
        "number", "vector", "type" or "none". Left out, the shape of the signatures tells; types must be said, because
        they look like numbers.

    Raises
    ------
    InvalidInputError
        If a position or signature is not finite, an id appears twice or is negative, a type is no whole number >= 0, or
        shapes do not fit.

    References
    ----------
    Probabilistic Robotics, section 6.6.2; a map as a list of features: (6.3).

    Examples
    --------
    >>> landmarks = LandmarkMap([[0.0, 1.0], [4.0, 2.0]], ids=[7, 9], signatures=[0, 1], kind="type")
    >>> landmarks.indices_of([9]).tolist()
    [1]
    """

    positions: FloatArray
    ids: NDArray[np.int64] = None  # type: ignore[assignment]  # always there once constructed
    signatures: FloatArray | None = None
    kind: SignatureKind = None  # type: ignore[assignment]  # the same

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            positions: ArrayLike,
            ids: ArrayLike | None = None,
            signatures: ArrayLike | None = None,
            kind: SignatureKind | None = None,
        ) -> None: ...

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        positions = finite_copy(self.positions, "positions")
        if positions.ndim != 2 or positions.shape[1] != 2 or not len(positions):
            raise InvalidInputError(f"positions: expected shape (n, 2) with n >= 1, got {positions.shape}")
        keep(self, positions=positions, ids=as_map_ids(self.ids, len(positions)))
        if self.signatures is not None:
            keep(self, signatures=finite_copy(self.signatures, "signatures"))
        keep(self, kind=self._checked_kind())

    def __len__(self) -> int:
        return len(self.positions)

    def _checked_kind(self) -> SignatureKind:
        if self.signatures is None:
            require(self.kind in (None, "none"), "kind", "'none' without signatures", self.kind)
            return "none"
        shape, n = self.signatures.shape, len(self)
        require(len(shape) in (1, 2) and shape[0] == n, "signatures", f"shape ({n},) or ({n}, d)", shape)
        possible = ("vector",) if len(shape) == 2 else ("number", "type")
        if self.kind is not None and self.kind not in possible:
            raise InvalidInputError(
                f"kind: expected one of {possible} for signatures of shape {shape}, got {self.kind!r}"
            )
        if self.kind == "type":
            wrong = (self.signatures < 0) | (self.signatures != np.floor(self.signatures))
            if wrong.any():
                raise InvalidInputError(f"signatures: expected types 0, 1, 2, ..., got {self.signatures[wrong][0]}")
        return self.kind or ("vector" if len(shape) == 2 else "number")
