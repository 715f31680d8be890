"""What replaying a stack's filter decided: tables for the terminal and the page, a verdict, JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from beamfield.localization.replay_comparison import ReplayComparison, ReplayTrials
from beamfield.report.escape import escaped
from beamfield.report.page import table
from beamfield.report.text_table import aligned
from beamfield.stacks.fit.motion_candidates import BEFORE
from beamfield.stacks.fit.replay_choice import ReplayChoice
from beamfield.stacks.fit.replay_runs import ReplaySetting

_HEADER = ("", "error [m]", "difference, 95% interval", "lost runs", "inside 95%")
_PARTS = {
    "sensor": "sensor as before",
    "motion": "noise as before",
    "origin": "origin as before",
    "solids": "black as before",
    "recovery": "recovery as before",
}


def replay_tables(choice: ReplayChoice, *, width: int | None = None) -> str:
    """Return what was replayed, the table of errors, and what the best setting is."""
    parts = [_what(choice), aligned(_HEADER, _rows(choice), right=(1, 2, 3, 4), width=width)]
    return "\n\n".join(parts if choice.finalist is choice.before else [*parts, _finalist(choice)])


def replay_markup(choice: ReplayChoice) -> str:
    """Return the same for the page."""
    finalist = "" if choice.finalist is choice.before else f"\n<p>{escaped(_finalist(choice))}</p>"
    return (
        f"<h3>Replay</h3>\n<p>{escaped(_what(choice))}</p>\n"
        f"{table(_HEADER, _rows(choice), right=(1, 2, 3, 4), css='stack')}{finalist}"
    )


def replay_verdict(choice: ReplayChoice) -> str:
    """Return the decision with its reasons."""
    before, after = choice.trials_before, choice.trials_finalist
    where = (
        f"replayed in {choice.before.filter.stack}'s own filter, emulated, on {len(before)} "
        f"{'stretches' if len(before) > 1 else 'stretch'} of this log, {choice.n_runs} runs"
    )
    inside = f"truth in the particles' 95% ellipse {_inside(before):.0%} -> {_inside(after):.0%}"
    lost = f"lost runs {_lost(before)} -> {_lost(after)}"
    own = f"{choice.before.filter.stack}'s defaults" if choice.before.filter.path is None else "the values you have"
    if choice.is_better:
        chosen = choice.chosen.key
        only_map = chosen.sensor == chosen.motion == chosen.recovery == BEFORE
        use = f"Use the corrected map with {own}" if only_map else "Use the new values"
        return (
            f"{use}: {where}, the position error is {choice.error.before:.3f} m before and "
            f"{choice.error.after:.3f} m after ({_told(choice.error)}), {lost}, {inside}."
        )
    if choice.finalist is choice.before:
        return f"Keep {own}: {where}, none of {choice.n_settings} settings did better."
    return (
        f"Keep {own}: {where}, the best of {choice.n_settings} settings ({describe(choice.finalist)}) is not better "
        f"for sure: position error {choice.error.before:.3f} -> {choice.error.after:.3f} m ({_told(choice.error)}), "
        f"{lost}, {inside}."
    )


def despite_error(choice: ReplayChoice, part: str) -> str:
    """Return a clause on why a part of the finalist is right that does not lower the error; "" where it does."""
    error = choice.parts.get(part)
    if error is None or error.after < error.before:
        return ""
    without, inside = _inside(choice.trials_without[part]), _inside(choice.trials_finalist)
    if inside > without:
        return f", but the truth was in the particles' 95% ellipse in {inside:.0%} of the updates, not in {without:.0%}"
    return "" if error.is_higher else ", which may be chance"


def describe(setting: ReplaySetting) -> str:
    """Return where the values of a setting come from."""
    key = setting.key
    if key.sensor == key.motion == key.recovery == BEFORE and not setting.changes_map:
        return "the values before"
    parts = [f"sensor {key.sensor}", f"motion noise {key.motion}"]
    parts += [f"map's origin {key.origin:+g} m"] if key.origin else []
    parts += ["map's black areas unknown"] if key.solids != BEFORE else []
    return ", ".join([*parts, *([f"recovery {key.recovery}"] if key.recovery != BEFORE else [])])


def replay_as_dict(choice: ReplayChoice) -> dict[str, Any]:
    """Return everything as plain values."""
    return {
        "is_better": choice.is_better,
        "verdict": replay_verdict(choice),
        "chosen": _setting_as_dict(choice.chosen),
        "finalist": _setting_as_dict(choice.finalist),
        "settings": choice.n_settings,
        "stretches": len(choice.trials_before),
        "runs": choice.n_runs,
        "error": _comparison_as_dict(choice.error),
        "cost": _comparison_as_dict(choice.cost),
        "lost": [_lost(choice.trials_before), _lost(choice.trials_finalist)],
        "inside": [_inside(choice.trials_before), _inside(choice.trials_finalist)],
        "without": {name: _comparison_as_dict(one) for name, one in choice.parts.items()},
    }


def _what(choice: ReplayChoice) -> str:
    before = choice.before.filter
    *parts, last = (
        "sensor",
        "motion noise",
        *(["map origin"] if choice.moves_origin else []),
        *(["black areas of the map"] if choice.hollows_solids else []),
        *(["recovery"] if any(before.recovery_rates) else []),
    )
    return (
        f"{choice.n_settings} settings of {', '.join(parts)} and {last} were replayed in the emulated filter of "
        f"{before.stack}; on each stretch of the log the best on all others is judged, over "
        f"{choice.n_runs} runs. Each starts up to two stretches earlier from a belief 0.25 m and 6 "
        "degrees wide, and counts as 1 m off at most."
    )


def _rows(choice: ReplayChoice) -> list[tuple[str, ...]]:
    """Return a row for the values before, for the best setting, and for it without each part."""
    rows: list[tuple[str, ...]] = [("before", f"{choice.error.before:.3f}", "", *_counts(choice.trials_before))]
    if choice.finalist is not choice.before:
        error = choice.error
        rows.append((_place(choice), f"{error.after:.3f}", _interval(error), *_counts(choice.trials_finalist)))
    if len(choice.parts) > 1:
        rows += [
            (_PARTS[name], f"{one.before:.3f}", _interval(one, -1.0), *_counts(choice.trials_without[name]))
            for name, one in choice.parts.items()
        ]
    return rows


def _place(choice: ReplayChoice) -> str:
    return "chosen" if choice.is_better else "best tried"


def _finalist(choice: ReplayChoice) -> str:
    return f"{_place(choice)}: {describe(choice.finalist)}"


def _counts(trials: Sequence[ReplayTrials]) -> tuple[str, str]:
    return f"{_lost(trials)} of {sum(map(len, trials))}", f"{_inside(trials):.0%}"


def _interval(comparison: ReplayComparison, sign: float = 1.0) -> str:
    low, high = sorted((sign * comparison.low, sign * comparison.high))
    return f"{low:+.3f} to {high:+.3f}"


def _told(comparison: ReplayComparison) -> str:
    return f"difference {_interval(comparison)} m, 95% interval"


def _lost(trials: Sequence[ReplayTrials]) -> int:
    return sum(one.n_lost for one in trials)


def _inside(trials: Sequence[ReplayTrials]) -> float:
    return float(np.mean([one.mean("inside_noisy") for one in trials]))


def _setting_as_dict(setting: ReplaySetting) -> dict[str, Any]:
    key = setting.key
    return {
        "sensor": key.sensor,
        "motion": key.motion,
        "origin_shift": key.origin,
        "black_areas_unknown": key.solids != BEFORE,
        "recovery": key.recovery,
        "parameters": {**asdict(setting.filter.sensor), **asdict(setting.filter.motion)},
    }


def _comparison_as_dict(comparison: ReplayComparison) -> dict[str, float]:
    names = ("before", "after", "low", "high")
    return {name: getattr(comparison, name) for name in names}
