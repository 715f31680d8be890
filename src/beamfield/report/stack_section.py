"""What calibrating for another program's model found: tables for the terminal, a section of the page, JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from beamfield.report.as_json import plain
from beamfield.report.colours import DATA, FIT, HELD_OUT, QUIET
from beamfield.report.drawing import NARROW, legend_above, new_axes
from beamfield.report.escape import escaped
from beamfield.report.page import figure, finding_list, fold, table
from beamfield.report.page_section import Level, PageSection
from beamfield.report.panel import Panel, ReportFigure, svg_panel
from beamfield.report.replay_choice import replay_as_dict, replay_markup, replay_tables, replay_verdict
from beamfield.report.stack_findings import stack_findings
from beamfield.report.stack_result import StackResult
from beamfield.report.text_table import aligned
from beamfield.stacks.fit.fit import StackFit, Trial, net_score
from beamfield.stacks.fit.particle_update import ParticleUpdate
from beamfield.stacks.registry import model_named

HOW = {
    "maximum likelihood": "Factors, sigma and rates are those of the book's beam model by maximum likelihood, "
    "translated; the number of beams is chosen on windows of the log.",
    "posterior": "Values were chosen for the best pose posterior on short windows of the log.",
}


def stack_tables(result: StackResult, *, width: int | None) -> str:
    """Return the tables for the terminal: parameters, start against calibrated for every model fitted, and replay."""
    fits, chosen = result.fits, result.chosen
    rows, scores = _parameter_rows(result), [row for fit in fits for row in _score_rows(fit, result.trial)]
    parts = [
        f"{chosen.model.stack}, {chosen.model.model}: {HOW[chosen.how]}",
        aligned(_VALUES_HEADER, rows, right=(1, 2)) if rows else _NO_CHANGE,
        aligned(_SCORE_HEADER, scores, right=(2, 3, 4, 5), width=width),
        f"Judged on {len(chosen.chosen.held_out.log_score)} held-out windows of {chosen.options.scans} scans.",
    ]
    parts.append(_not_replayed(result) if result.replay is None else replay_tables(result.replay, width=width))
    parts += [
        f"{'warning' if item.severity == 'warning' else 'note'} ({item.name}): {item.full_text}"
        for item in stack_findings(result)
    ]
    return "\n\n".join(parts)


def stack_section(result: StackResult, file_text: str) -> PageSection:
    """Return the section of the report, with the parameter file; it answers what was asked for and opens the page."""
    fits, chosen, replay = result.fits, result.chosen, result.replay
    stack, model = chosen.model.stack, chosen.model.model
    rows = [row for fit in fits for row in _score_rows(fit, result.trial)]
    chosen_rows = [number for number, row in enumerate(rows) if row[0]]
    scores = table(_SCORE_HEADER[1:], [row[1:] for row in rows], right=(1, 2, 3, 4), bold=chosen_rows)
    changed = _parameter_rows(result)
    values = table(_VALUES_HEADER, changed, right=(1, 2), css="stack") if changed else f"<p>{_NO_CHANGE}</p>"
    found = stack_findings(result)
    replayed = f"<p>{escaped(_not_replayed(result))}</p>" if replay is None else replay_markup(replay)
    options = chosen.options
    choice = ReportFigure(
        "stack-choice",
        "What windows propose, and what one scan does to particles",
        (_beams_panel(chosen), _error_panel(chosen)),
        "Left: the score of each setting on windows that its values were not fitted to, and the same minus a penalty "
        "for 95% regions that miss the reference; the circle is the setting that windows propose to the replay. Right: "
        "the mean distance of "
        "particles from the reference after one scan, over held-out scans; left of the dashed line the scan helped.",
    )
    windows = (
        f"{scores}<p>Score: on {len(chosen.chosen.held_out.log_score)} held-out windows of {options.scans} scans, the "
        "mean logarithm of the posterior's density at the reference over the prior's, in "
        "nats: 0 for weights that say nothing, far below 0 for weights that are certain and wrong. Coverage: share of "
        "those windows whose 95% region holds the reference, which itself may be "
        f"{options.reference_error * 100:g} cm off. Effective particles and error: {chosen.update.n_particles} "
        f"particles, {chosen.update.error_before[0] * 100:.0f} cm from the reference in the mean, weighed by one "
        f"scan.</p>\n<p>{escaped(HOW[chosen.how])} A scan multiplies a particle's weight by "
        f"{escaped(model_named(stack, model).formula)}.</p>\n{figure(choice)}"
    )
    markup = (
        f"{finding_list(found) if found else ''}{values}\n{replayed}\n"
        f"{fold('The parameter file', f'<pre>{escaped(file_text)}</pre>')}\n{fold('Scores on windows', windows)}"
    )
    is_better = replay is not None and replay.is_better
    doubtful = result.disagrees or result.is_from_few_places
    level: Level = "good" if result.covers and is_better and not doubtful else "care"
    return PageSection("stack", f"{stack}: {model}", markup, stack_verdict(result), level)


def stack_verdict(result: StackResult) -> str:
    """Return what the values to use do in the replayed filter, before and after, or why none may be used."""
    if result.doubt or result.replay is None:
        return result.doubt or result.unproven
    said = replay_verdict(result.replay)
    if result.disagrees:
        said += " Many scans disagree with the map: read the warning about it first."
    if result.leaves_out_jumps:
        said += (
            " The odometry's jumps were left out: the robot's filter takes them and may get lost there, whatever the "
            "values."
        )
    return said


def _not_replayed(result: StackResult) -> str:
    return f"Nothing was replayed: {result.why_not}. Values are those of the best score on windows."


def stack_as_dict(result: StackResult) -> dict[str, Any]:
    """Return everything as plain values for JSON."""
    fits, chosen, replay = result.fits, result.chosen, result.replay
    return {
        "stack": chosen.model.stack,
        "model": chosen.model.model,
        "parameters": asdict(result.parameters),
        "motion": result.motion,
        "recovery": result.recovery,
        "replay": {"missing": result.why_not} if replay is None else replay_as_dict(replay),
        "how": chosen.how,
        "covers": result.covers,
        "verdict": stack_verdict(result),
        "findings": plain(stack_findings(result)),
        "options": asdict(chosen.options),
        "models": [
            {
                "model": fit.model.model,
                "chosen": fit is chosen,
                "start": asdict(fit.start),
                "parameters": asdict(fit.parameters),
                "before": _scores_as_dict(fit.before, fit.update_before),
                "calibrated": _scores_as_dict(fit.chosen, fit.update),
                "trials": [
                    {
                        "setting": dict(trial.setting),
                        "parameters": asdict(trial.parameters),
                        "net_score": net_score(trial.crossed),
                        "score": trial.crossed.mean,
                        "coverage": trial.crossed.coverage,
                    }
                    for trial in fit.trials
                ],
            }
            for fit in fits
        ],
    }


_VALUES_HEADER, _NO_CHANGE = ("parameter", "before", "to use"), "All values stay as they are."
_SCORE_HEADER = ("", "model", "score [nats]", "coverage", "effective particles", "error after update [m]")


def _score_rows(fit: StackFit, used: Trial) -> list[tuple[str, ...]]:
    rows = (("before", fit.before, fit.update_before), ("calibrated", fit.chosen, fit.update))
    mark = next((name for name, trial, _ in rows if trial is used), "")
    return [
        (
            "*" if name == mark else "", f"{fit.model.model}, {name}", f"{trial.held_out.mean:.2f}",
            f"{trial.held_out.coverage:.0%}", f"{np.median(update.effective):.0f}",
            f"{update.error_after.mean():.3f}",
        )
        for name, trial, update in rows
    ]  # fmt: skip


def _parameter_rows(result: StackResult) -> list[tuple[str, ...]]:
    before, after = asdict(result.start), {**asdict(result.parameters), **result.motion, **result.recovery}
    if result.replay is not None:
        its = result.replay.before.filter
        before |= asdict(its.motion) | asdict(its.particles)
    return [(name, _value(before[name]), _value(value)) for name, value in after.items() if value != before[name]]


def _value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _scores_as_dict(trial: Trial, update: ParticleUpdate) -> dict[str, Any]:
    return {
        "score": trial.held_out.mean,
        "coverage": trial.held_out.coverage,
        "windows": len(trial.held_out.log_score),
        "effective_sample_size": float(np.median(update.effective)),
        "particles": update.n_particles,
        "error_before": float(update.error_before.mean()),
        "error_after": float(update.error_after.mean()),
    }


def _beams_panel(fit: StackFit) -> Panel:
    name = ", ".join(fit.trials[0].setting) or "setting"
    drawn, axes = new_axes(NARROW, 2.9, above=1, x=name, y="score [nats per window]")
    labels = [", ".join(str(value) for value in trial.setting.values()) for trial in fit.trials]
    net = [net_score(trial.crossed) for trial in fit.trials]
    places = np.arange(len(fit.trials))
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.plot(places, [trial.crossed.mean for trial in fit.trials], "o-", color=DATA, label="score")
    axes.plot(places, net, "o-", color=FIT, label="minus penalty")
    for place, trial in zip(places, fit.trials, strict=True):
        if dict(trial.setting) == dict(fit.chosen.setting):
            axes.plot(place, net[place], "o", ms=11, mfc="none", mec=HELD_OUT, label="proposed")
    axes.set_xticks(places, labels)
    legend_above(axes)
    said = "; ".join(f"{label} {value:.2f}" for label, value in zip(labels, net, strict=True))
    return svg_panel(drawn, "stack-settings", f"Score by {name}: {said}")


def _error_panel(fit: StackFit) -> Panel:
    x = "mean distance of particles from the reference [cm]"
    drawn, axes = new_axes(NARROW, 2.9, above=1, x=x, y="share of held-out scans")
    for update, colour, label in ((fit.update_before, DATA, "before"), (fit.update, FIT, "calibrated")):
        axes.ecdf(update.error_after * 100.0, color=colour, linewidth=1.8, label=label)
    start = float(fit.update.error_before.mean()) * 100.0
    axes.axvline(start, color=QUIET, linewidth=0.9, linestyle="--", label="without the scan")
    axes.set(xlim=(0.0, None), ylim=(0.0, 1.02))
    legend_above(axes)
    alt = (
        f"Share of scans by error after one update: before in the mean {fit.update_before.error_after.mean():.3f} m, "
        f"calibrated {fit.update.error_after.mean():.3f} m"
    )
    return svg_panel(drawn, "stack-update", alt)
