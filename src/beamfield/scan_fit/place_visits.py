"""In which visits places differed, and how likely it is that they differ for good: two kinds of places."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_fields
from beamfield.geometry import FloatArray
from beamfield.short_repr import short_repr

# A place was visited if so many beams had the chance to tell, and differed if at least two did.
FEWEST_BEAMS = 10
FEWEST_READINGS = 2
# What differs for good does so in most visits; what passes is there in few.
LEAST_LASTING, MOST_PASSING = 0.5, 0.2
# What is assumed before any place is seen, and how many places and visits that weighs: one place in a hundred differs
# for good, in nine of ten visits; another one in a hundred visits.
PRIOR_SHARE, PRIOR_LASTING, PRIOR_PASSING, PRIOR_STANDING = 0.01, 0.9, 0.01, 0.5
PRIOR_PLACES, PRIOR_VISITS = 100.0, 10.0
MOST_STEPS, SETTLED = 200, 1e-5


class Tally(NamedTuple):
    """Beams per place and visit, as columns; only where beams had the chance to tell.

    Visits of one place are in the order of time; `readings` are those of its `beams` that differ from the map.
    """

    place: NDArray[np.int64]
    visit: NDArray[np.int64]
    beams: NDArray[np.int64]
    readings: NDArray[np.int64]

    def visits(self, least_share: float) -> Visits:
        """Return the visits with beams enough; a place differed if two beams and this share of them did."""
        seen = self.beams >= FEWEST_BEAMS
        enough = np.maximum(FEWEST_READINGS, least_share * self.beams[seen])
        return Visits(self.place[seen], self.visit[seen], self.readings[seen] >= enough)


@dataclass(frozen=True, eq=False)
class Visits:
    """Visits to places, as columns.

    Parameters
    ----------
    place, visit
        Numbers of both; in any order.
    differs
        Whether the place differed from the map.
    """

    place: NDArray[np.int64]
    visit: NDArray[np.int64]
    differs: NDArray[np.bool_]

    __repr__ = short_repr

    @cached_property
    def gaps(self) -> FloatArray:
        """How many blocks before the same place differed, if it did at its visit before this one; else inf."""
        order = np.lexsort((self.visit, self.place))
        place, visit, differs = self.place[order], self.visit[order], self.differs[order]
        follows = np.zeros(len(order), bool)
        follows[1:] = (place[1:] == place[:-1]) & differs[:-1]
        gaps = np.full(len(order), np.inf)
        gaps[order[follows]] = np.diff(visit, prepend=0)[follows]
        return gaps

    def select(self, rows: NDArray[np.bool_]) -> Visits:
        """Return some of the visits."""
        return Visits(self.place[rows], self.visit[rows], self.differs[rows])

    def counts(self, n_places: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return (n_places,) in how many visits each place differed, and how many there were."""
        return (np.bincount(self.place[self.differs], minlength=n_places), np.bincount(self.place, minlength=n_places))

    def in_windows(self, cols: int) -> Visits:
        """Return the visits to windows of 2 x 2 squares, each numbered as its lowest, of a lattice with `cols` columns.

        The windows overlap: what lies on the edge of two squares is in one window.
        """
        parts = []
        for row, col in ((0, 0), (0, 1), (1, 0), (1, 1)):
            there = (self.place // cols >= row) & (self.place % cols >= col)
            parts.append((self.place[there] - row * cols - col, self.visit[there], self.differs[there]))
        place, visit, differs = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return Visits(place, visit, differs).joined(np.arange(int(place.max(initial=-1)) + 1))

    def joined(self, whole: NDArray[np.int64]) -> Visits:
        """Return the visits to larger places; one differs in a visit if a part of it does.

        `whole` is the place that each place is part of; negative for none.
        """
        place = whole[self.place]
        pairs, index = np.unique(
            np.column_stack([place, self.visit])[place >= 0], axis=0, return_inverse=True
        )  # fmt: skip
        differs = np.bincount(index.reshape(-1), weights=self.differs[place >= 0], minlength=len(pairs)) > 0
        return Visits(pairs[:, 0], pairs[:, 1], differs)


@dataclass(frozen=True)
class TwoKinds:
    """A mixture of two kinds of places: what differs for good, and what is as mapped but for what comes and goes.

    Parameters
    ----------
    share
        Share of places that differ for good.
    lasting, passing
        In which share of visits a place of either kind differs, if nothing is known of the visit before.
    standing
        Share of what comes that stands still, in place of walking on.
    stay
        Probability that who stands still does so one block of time later.

    Notes
    -----
    Of a place that differs for good, visits are independent. Of another, one that differed g blocks before differs
    with the probability passing + (1 - passing) standing stay^g: somebody who stands still is seen in several visits.

    References
    ----------
    Dempster, Laird and Rubin, "Maximum likelihood from incomplete data via the EM algorithm", Journal of the Royal
    Statistical Society B 39, 1977; Efron, "Large-scale inference", 2010, for the posterior as a local false discovery
    rate.
    """

    share: float
    lasting: float
    passing: float
    standing: float
    stay: float

    def __post_init__(self) -> None:
        check_fields(self)

    @classmethod
    def learn(cls, visits: Visits, stay: float) -> TwoKinds:
        """Learn the mixture from all places that were visited, with weak prior counts; see the class.

        `lasting` is at least 0.5 and `passing` at most 0.2, which EM learns from visits that follow none in which the
        place differed.
        """
        visits = replace(visits, place=np.unique(visits.place, return_inverse=True)[1].reshape(-1))
        n = int(visits.place.max(initial=-1)) + 1
        (k, v), fresh = visits.counts(n), visits.gaps == np.inf
        k_fresh, v_fresh = visits.select(fresh).counts(n)
        stayed = stay**visits.gaps
        kinds = cls(PRIOR_SHARE, PRIOR_LASTING, PRIOR_PASSING, PRIOR_STANDING, stay)
        for _ in range(MOST_STEPS):
            lasting = kinds.probability(visits, n)
            other = 1.0 - lasting
            stood, could = kinds._stood(visits, stayed)
            step = cls(
                float((lasting.sum() + PRIOR_SHARE * PRIOR_PLACES) / (n + PRIOR_PLACES)),
                max(_ratio(lasting, k, v, PRIOR_LASTING), LEAST_LASTING),
                min(_ratio(other, k_fresh, v_fresh, PRIOR_PASSING), MOST_PASSING),
                min(_ratio(other[visits.place] * ~fresh, stood, could, PRIOR_STANDING), PRIOR_STANDING),
                stay,
            )
            moved = abs(np.array(astuple(step)) - astuple(kinds))
            kinds = step
            if moved.max() < SETTLED:
                break
        return kinds

    def _stood(self, visits: Visits, stayed: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how likely it is that who was there before stood still, and that nobody else has come, by visit."""
        still = (1.0 - self.passing) * self.standing
        there = self.passing + still * stayed
        stood = still * np.where(visits.differs, stayed / there, (1.0 - stayed) / (1.0 - there))
        return stood, np.where(visits.differs, 1.0 - self.passing / there, 1.0)

    def probability(self, visits: Visits, n_places: int) -> FloatArray:
        """Return the probability (n_places,) that each place differs for good, given its visits; `share` without any.

        Examples
        --------
        Different in one visit, or in two that follow each other, it may be somebody; a quarter of an hour apart it
        hardly is:

        >>> visits = Visits(np.array([0, 1, 1, 2, 2]), np.array([7, 7, 8, 7, 52]), np.ones(5, bool))
        >>> TwoKinds(0.01, 0.9, 0.01, 0.8, stay=0.5).probability(visits, 3).round(2).tolist()
        [0.48, 0.67, 0.99]
        """
        passing = self.passing + (1.0 - self.passing) * self.standing * self.stay**visits.gaps
        lasting = np.where(visits.differs, self.lasting, 1.0 - self.lasting)
        passing = np.where(visits.differs, passing, 1.0 - passing)
        log_odds = np.bincount(visits.place, weights=np.log(lasting / passing), minlength=n_places)
        return np.asarray(1.0 / (1.0 + np.exp(-log_odds) * (1.0 - self.share) / self.share))


def _ratio(weights: FloatArray, seen: NDArray[Any], expected: NDArray[Any], prior: float) -> float:
    """Return what was seen over what there was, both weighted, with the prior's visits."""
    # Products with @ would wait for the threads of the linear algebra library, which such short ones never need.
    return float(((weights * seen).sum() + prior * PRIOR_VISITS) / ((weights * expected).sum() + PRIOR_VISITS))
