"""What a user's own good scans look like: what `scan_fit` compares a scan with."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, keep, restore
from beamfield.calibration.selection import SelectionOptions, select_scans
from beamfield.calibration.time_split import time_blocks
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray
from beamfield.scan_fit.conformal import conformal_p_values, cross_conformal_p_values
from beamfield.scan_fit.likelihood_ratio import LostEvidence, correlation_time, effective_number, learn_evidence
from beamfield.scan_fit.lost import (
    TEST_RATES,
    ReliabilityRow,
    kidnapped_series,
    lost_probability,
    reliability_table,
    tune_correlation,
)
from beamfield.scan_fit.statistics import FitModel, FitStatistics, Progress, fit_statistics, grid_of
from beamfield.scan_fit.wrong_poses import wrong_poses
from beamfield.sensors import SensorLog
from beamfield.short_repr import short_repr

SCHEMA = "beamfield-scan-fit/1"
# With fewer good scans no p-value would be below 5%.
FEWEST_SCANS = 20
# How often the log is scored at wrong poses.
N_LOST = 4


@dataclass(frozen=True, eq=False)
class ScanFitReference:
    """How a user's own good scans fit, and what tells them from scans at wrong poses.

    Parameters
    ----------
    model
        Name and parameters of the model, and the sensor's max_range: statistics of another model mean something else.
    stamps, surprise, misfit
        (n,) time and statistics of the good scans.
    evidence
        Likelihood ratio of "lost" as a function of `surprise`.
    correlation_s
        Seconds over which `misfit` depends on itself.
    gap_s
        Scans of the same log closer in time than this are not compared with each other.
    reliability
        Lost probability against truth, on simulated kidnappings in blocks of time that the evidence was not learned
        from.
    inputs
        Where it comes from: role -> name and hash.

    Raises
    ------
    InvalidInputError
        If a column has another length, or a number that is not finite.
    TooLittleDataError
        If there are fewer than 20 good scans.
    """

    model: Mapping[str, Any]
    stamps: FloatArray
    surprise: FloatArray
    misfit: FloatArray
    evidence: LostEvidence
    correlation_s: float
    gap_s: float
    reliability: tuple[ReliabilityRow, ...] = ()
    inputs: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("stamps", "surprise", "misfit"):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.ndim != 1 or len(array) != len(self.stamps) or not np.isfinite(array).all():
                raise InvalidInputError(f"{name}: expected {len(self.stamps)} finite numbers, got shape {array.shape}")
            keep(self, **{name: array})
        if len(self.stamps) < FEWEST_SCANS:
            raise TooLittleDataError(
                f"{len(self.stamps)} good scans, need {FEWEST_SCANS}: with fewer no p-value would be below 5%"
            )

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def n_effective(self) -> float:
        """How many independent scans the good ones are worth; p-values are uncertain by sqrt(p (1 - p) / this)."""
        return effective_number(self.stamps, self.correlation_s)

    @property
    def smallest_p_value(self) -> float:
        """No scan can get less: 1 / (n + 1)."""
        return 1.0 / (len(self) + 1.0)

    def p_values(self, misfit: ArrayLike) -> FloatArray:
        """Return conformal p-values (m,) in (0, 1] of scans of another log; NaN for NaN.

        The misfits are as in `FitStatistics`.
        """
        return conformal_p_values(misfit, self.misfit)

    def own_p_values(self, misfit: ArrayLike, stamps: ArrayLike) -> FloatArray:
        """Return p-values of scans of the same log, as `p_values` does: good scans near in time do not count."""
        return cross_conformal_p_values(misfit, stamps, self.misfit, self.stamps, self.gap_s)

    def require_model(self, model: FitModel, max_range: float) -> None:
        """Refuse a model that the reference was not made with.

        InvalidInputError names what differs: its name, a parameter, what it does in unknown space, or the sensor's
        limit.
        """
        mine, other = dict(self.model), _model_identity(model, max_range)
        different = sorted(name for name in {*mine, *other} if not _same(mine.get(name), other.get(name)))
        if different:
            name = different[0]
            raise InvalidInputError(
                f"reference: was made with another model: {name} was {mine.get(name)!r}, now it is {other.get(name)!r}"
            )

    def to_json(self) -> str:
        """Return everything as JSON text; `from_json` gives the same bits back.

        Returns
        -------
        A document that ends with a line end.

        Raises
        ------
        ValueError
            If a number is not finite: JSON has none for it.
        """
        document = {
            "schema": SCHEMA,
            "inputs": dict(self.inputs),
            "model": dict(self.model),
            "n_scans": len(self),
            "n_effective": self.n_effective,
            "correlation_s": self.correlation_s,
            "gap_s": self.gap_s,
            "evidence": {name: np.asarray(value).tolist() for name, value in vars(self.evidence).items()},
            "reliability": [asdict(row) for row in self.reliability],
            **{name: getattr(self, name).tolist() for name in ("stamps", "surprise", "misfit")},
        }
        return json.dumps(document, indent=1, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> ScanFitReference:
        """Read what `to_json` wrote.

        Parameters
        ----------
        text
            The document.

        Returns
        -------
        The reference.

        Raises
        ------
        InvalidInputError
            If the text is not such a document; the message says why.
        TooLittleDataError
            If the document has too few good scans.
        """
        try:
            document = json.loads(text)
            if not isinstance(document, dict) or document.get("schema") != SCHEMA:
                raise InvalidInputError(f"reference: expected a document with the schema {SCHEMA!r}")
            evidence = document["evidence"]
            return cls(
                model={str(name): value for name, value in document["model"].items()},
                evidence=LostEvidence(evidence["knots"], evidence["log_ratio"], float(evidence["correlation_s"])),
                correlation_s=float(document["correlation_s"]),
                gap_s=float(document["gap_s"]),
                reliability=tuple(ReliabilityRow(**row) for row in document["reliability"]),
                inputs=dict(document["inputs"]),
                **{name: np.asarray(document[name], dtype=np.float64) for name in ("stamps", "surprise", "misfit")},
            )
        except (InvalidInputError, TooLittleDataError):
            raise
        except KeyError as error:
            raise InvalidInputError(f"reference: the entry {error} is missing") from error
        except (ValueError, TypeError, AttributeError) as error:
            raise InvalidInputError(f"reference: {error}") from error


def _same(mine: object, other: object) -> bool:
    """Whether two entries of identities are one: numbers as far as a file of six digits tells."""
    if isinstance(mine, float) and isinstance(other, float):
        return math.isclose(mine, other, rel_tol=1e-5, abs_tol=1e-9)
    return mine == other


def _model_identity(model: FitModel, max_range: float) -> dict[str, Any]:
    """Return name, parameters and options that statistics depend on, as plain values."""
    return {
        "name": type(model).__name__,
        **asdict(model.parameters),
        "unknown": str(getattr(model, "unknown", "free")),
        "max_range": float(max_range),
    }


def calibrate_scan_fit(
    model: FitModel,
    log: SensorLog,
    *,
    selection: SelectionOptions | None = None,
    block_s: float | None = None,
    seed: int = 0,
    inputs: Mapping[str, Any] | None = None,
    statistics: FitStatistics | None = None,
    progress: Progress | None = None,
) -> ScanFitReference:
    """Learn from a log with good reference poses how good scans fit, and how scans at wrong poses do not.

    Parameters
    ----------
    model
        `BeamModel`, `SonarModel` (on a grid) or `LikelihoodFieldModel`, with calibrated parameters.
    log
        Scans with reference poses in the map frame.
    selection
        Which scans count as good; see `select_scans`.
    block_s
        Length of the time blocks, seconds; None: 20 s or less.
    seed
        For the wrong poses.
    inputs
        Where log and map come from (role -> name and hash), kept in the result.
    statistics
        Statistics of all scans of the log at their poses, if they are known already.
    progress
        Called with (done, total) rounds.

    Returns
    -------
    The reference, to be kept with the model.

    Raises
    ------
    InvalidInputError
        If the log has no reference poses, lies off the map, or the model has no grid.
    TooLittleDataError
        If fewer than 20 good scans remain.
    """
    grid = grid_of(model)
    if grid is None:
        raise InvalidInputError("model: expected a model on an occupancy grid, to draw wrong poses from")
    used = select_scans(log, grid, selection or SelectionOptions(min_scans=FEWEST_SCANS)).used
    known = statistics if statistics is not None else fit_statistics(model, log.ranges, log.finder, log.poses)
    good = used & (known.n_beams > 0)
    if good.sum() < FEWEST_SCANS:
        raise TooLittleDataError(f"{int(good.sum())} informative good scans, need {FEWEST_SCANS}")
    mine, known = log.select(good), known.select(good)
    rng = np.random.default_rng(seed)
    blocks = time_blocks(mine.stamps, block_s)
    wrong = []
    for number in range(N_LOST):
        # Half of a block: a block begins and ends with other poses, and more of them are drawn.
        poses = wrong_poses(mine.poses, time_blocks(mine.stamps, _half(mine.stamps, blocks)), grid, rng)
        wrong.append(fit_statistics(model, mine.ranges, mine.finder, poses).surprise)
        if progress is not None:
            progress(number + 1, N_LOST)
    evidence, reliability = _learn(mine.stamps, known.surprise, wrong, blocks, rng)
    identity, time = _model_identity(model, mine.finder.max_range), correlation_time(mine.stamps, known.misfit)
    gap_s, inputs = _length(mine.stamps, blocks), dict(inputs or {})
    return ScanFitReference(
        identity, mine.stamps, known.surprise, known.misfit, evidence, time, gap_s, reliability, inputs
    )


def _length(stamps: FloatArray, blocks: NDArray[np.int64]) -> float:
    return float(np.ptp(stamps) / (blocks.max() + 1))


def _half(stamps: FloatArray, blocks: NDArray[np.int64]) -> float | None:
    length = _length(stamps, blocks)
    return 0.5 * length if length > 0.0 else None


def _learn(
    stamps: FloatArray, good: FloatArray, wrong: list[FloatArray], blocks: NDArray[np.int64], rng: np.random.Generator
) -> tuple[LostEvidence, tuple[ReliabilityRow, ...]]:
    """Learn the evidence from all blocks; its dependence and its reliability are judged across halves of blocks."""
    time = correlation_time(stamps, good)
    halves = blocks % 2 == 1
    if not (halves.any() and (~halves).any()):
        return _evidence(stamps, good, wrong, time), ()
    series, predictors = [], []
    for half in (halves, ~halves):
        other = ~half
        predictors.append(_evidence(stamps[other], good[other], [w[other] for w in wrong], time))
        drawn = [kidnapped_series(good[half], w[half], stamps[half], rng) for w in wrong for _ in range(2)]
        series.append([(values, stamps[half], lost) for values, lost in drawn])
    # The correlation time that scores best across the halves, of those near the measured one.
    tuned = [tune_correlation(predictor, part) for predictor, part in zip(predictors, series, strict=True)]
    time = float(np.exp(np.mean([np.log(max(t.correlation_s, 1e-6)) for t in tuned])))
    p, lost = [], []
    for predictor, part in zip(predictors, series, strict=True):
        judge = replace(predictor, correlation_s=time)
        p += [lost_probability(values, when, judge, TEST_RATES) for values, when, _ in part]
        lost += [truth for _, _, truth in part]
    return _evidence(stamps, good, wrong, time), reliability_table(np.concatenate(p), np.concatenate(lost))


def _evidence(stamps: FloatArray, good: FloatArray, wrong: list[FloatArray], time: float) -> LostEvidence:
    worth = max(effective_number(stamps, time), 2.0)
    # Each round of wrong poses is another draw, but of the same scans: it counts as one more in square root.
    n_lost = worth * float(np.sqrt(len(wrong)))
    return learn_evidence(good, np.concatenate(wrong), n_good=worth, n_lost=n_lost, correlation_s=time)
