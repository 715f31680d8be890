"""Filters side by side: what `beamfield evaluate` prints and writes."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from beamfield.localization.replay import MEASURES
from beamfield.localization.replay_comparison import (
    COMPARED,
    FEWEST_SEEDS,
    ReplayComparison,
    ReplayTrials,
    ReplayVerdict,
    compare_trials,
    judge_change,
)
from beamfield.report.as_json import plain
from beamfield.report.text_table import aligned


@dataclass(frozen=True, eq=False)
class FindTrials:
    """How often a robot was found whose place the filter did not know.

    Parameters
    ----------
    task
        "global start" or "kidnapping".
    log
        Name of the log.
    seconds
        Of each run; None where the robot was not found.
    """

    task: str
    log: str
    seconds: tuple[float | None, ...]

    @property
    def found(self) -> list[float]:
        """The times of the runs that found the robot."""
        return [one for one in self.seconds if one is not None]

    @property
    def share(self) -> float:
        """The share of runs that found the robot."""
        return len(self.found) / len(self.seconds)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Filters on logs.

    Parameters
    ----------
    trials
        The runs on each log, by the filter's name; the first is what others are compared with.
    finds
        Global starts and kidnappings, by the filter's name.
    """

    trials: Mapping[str, Sequence[ReplayTrials]]
    finds: Mapping[str, Sequence[FindTrials]]

    @property
    def first(self) -> str:
        """The filter that others are compared with."""
        return next(iter(self.trials))

    @property
    def others(self) -> dict[str, Sequence[ReplayTrials]]:
        """The runs of the other filters."""
        return {name: trials for name, trials in self.trials.items() if name != self.first}

    @cached_property
    def comparisons(self) -> dict[str, list[ReplayComparison]]:
        """Each other filter's differences from the first over all logs, for each measure compared."""
        base = self.trials[self.first]
        return {
            name: [compare_trials(base, trials, measure) for measure in COMPARED]
            for name, trials in self.others.items()
        }

    @cached_property
    def verdicts(self) -> dict[str, ReplayVerdict]:
        """Whether each other filter is better than the first."""
        return {name: judge_change(self.trials[self.first], trials) for name, trials in self.others.items()}


def evaluation_tables(evaluation: Evaluation) -> str:
    """Return the tables for the terminal."""
    parts = [_error_table(evaluation)]
    if any(evaluation.finds.values()):
        parts.append(_find_table(evaluation))
    if len(evaluation.trials) > 1:
        parts.append(_difference_table(evaluation))
        parts += [f"{name} against {evaluation.first}:\n{one.summary()}" for name, one in evaluation.verdicts.items()]
    return "\n\n".join(parts)


def evaluation_line(evaluation: Evaluation) -> str:
    """Return the result in one line."""
    means = {name: float(np.mean([one.mean("mean") for one in trials])) for name, trials in evaluation.trials.items()}
    shown = ", ".join(f"{name} {mean:.3f} m" for name, mean in means.items())
    better = [name for name, verdict in evaluation.verdicts.items() if verdict.is_better]
    sure = f"; better than {evaluation.first} for sure: {', '.join(better) or 'none'}" if len(means) > 1 else ""
    return f"mean position error {shown}{sure}"


def evaluation_as_dict(evaluation: Evaluation) -> dict[str, Any]:
    """Return everything as values that strict JSON can hold."""
    return {
        "filters": {
            name: {
                "tracking": [_trials_as_dict(one) for one in trials],
                "finding": [
                    {"task": one.task, "log": one.log, "share": one.share, "seconds": list(one.seconds)}
                    for one in evaluation.finds.get(name, ())
                ],
            }
            for name, trials in evaluation.trials.items()
        },
        "compared_with": evaluation.first,
        "differences": {
            name: [_comparison_as_dict(one) for one in rows] for name, rows in evaluation.comparisons.items()
        },
        "verdicts": {name: _verdict_as_dict(verdict) for name, verdict in evaluation.verdicts.items()},
    }


def evaluation_csv(evaluation: Evaluation) -> str:
    """Return one line per run."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("filter", "log", "seed", *MEASURES))
    for name, trials in evaluation.trials.items():
        for one in trials:
            for seed, errors in zip(one.seeds, one.errors, strict=True):
                row = (getattr(errors, measure) for measure in MEASURES)
                writer.writerow((name, one.log, seed, *("" if value is None else _short(value) for value in row)))
    return text.getvalue()


def _error_table(evaluation: Evaluation) -> str:
    header = (
        "log", "filter", "position m: mean", "median", "95%", "heading deg: mean", "median", "95%", "inside", "NEES",
        "lost", "particles", "ms",
    )  # fmt: skip
    rows = [
        (
            one.log, name,
            *(f"{one.mean(measure):.3f}" for measure in ("mean", "median", "p95")),
            *(f"{one.mean(measure):.2f}" for measure in ("yaw_mean_deg", "yaw_median_deg", "yaw_p95_deg")),
            f"{one.mean('inside'):.0%}", f"{one.mean('nees_median'):.2f}", f"{one.n_lost} of {len(one)}",
            f"{one.mean('particles'):.0f}", _milliseconds(one),
        )
        for trials in zip(*evaluation.trials.values(), strict=True)
        for name, one in zip(evaluation.trials, trials, strict=True)
    ]  # fmt: skip
    note = (
        "Means over runs of each run's own figures. inside: reference in the particles' 95% ellipse (right: 95%); "
        "NEES: median (right: 2.37); lost: off by more than 2 m at the end or in over 10% of scans; ms: processor "
        "time of an update here, not on the robot."
    )
    return f"{aligned(header, rows, right=tuple(range(2, len(header))))}\n{note}"


def _milliseconds(trials: ReplayTrials) -> str:
    taken = trials.mean("update_ms")
    return "-" if math.isnan(taken) else f"{taken:.1f}"


def _find_table(evaluation: Evaluation) -> str:
    rows = [
        (one.task, one.log, name, f"{len(one.found)} of {len(one.seconds)}",
         f"{np.median(one.found):.0f}" if one.found else "-")
        for finds in zip(*evaluation.finds.values(), strict=True)
        for name, one in zip(evaluation.finds, finds, strict=True)
    ]  # fmt: skip
    table = aligned(("task", "log", "filter", "found", "after s (median)"), rows, right=(3, 4))
    return f"{table}\nfound: within 0.5 m in 95% of the scans from then on, and that for a fifth of them at least."


def _difference_table(evaluation: Evaluation) -> str:
    rows = []
    for name, comparisons in evaluation.comparisons.items():
        for one in comparisons:
            label, unit = COMPARED[one.measure]
            sure = "lower" if one.is_lower else "higher" if one.is_higher else "not sure"
            interval = f"{one.low:+.3f} to {one.high:+.3f}" if math.isfinite(one.low) else "unknown"
            rows.append((name, label, unit or "-", f"{one.difference:+.3f}", interval, sure))
    header = ("filter", f"against {evaluation.first}", "unit", "difference", "95% interval", "for sure")
    few = min(len(one) for one in evaluation.trials[evaluation.first])
    note = f"\nFewer than {FEWEST_SEEDS} seeds: nothing is sure." if few < FEWEST_SEEDS else ""
    return f"{aligned(header, rows, right=(3,))}\nOver all logs, run for run; intervals by paired bootstrap.{note}"


def _trials_as_dict(trials: ReplayTrials) -> dict[str, Any]:
    rows = [{**asdict(errors), "seed": seed} for seed, errors in zip(trials.seeds, trials.errors, strict=True)]
    means = {name: plain(trials.mean(name)) for name in MEASURES}
    return {"log": trials.log, "means": means, "lost_runs": trials.n_lost, "runs": rows}


def _comparison_as_dict(comparison: ReplayComparison) -> dict[str, Any]:
    sure = "lower" if comparison.is_lower else "higher" if comparison.is_higher else None
    return {**plain(comparison), "difference": comparison.difference, "for_sure": sure}


def _verdict_as_dict(verdict: ReplayVerdict) -> dict[str, Any]:
    return {
        "is_better": verdict.is_better,
        "lost_runs": [verdict.lost_before, verdict.lost_after],
        "by_log": {log: _comparison_as_dict(one) for log, one in verdict.by_log.items()},
    }


def _short(value: float) -> str:
    return str(int(value)) if isinstance(value, bool | int) else f"{value:.6g}"
