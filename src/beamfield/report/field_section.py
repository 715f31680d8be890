"""What learning the likelihood field found: tables for the terminal and a section of the page."""

from __future__ import annotations

from dataclasses import asdict

from beamfield.calibration.field.learning import FieldLearning, FieldScore
from beamfield.report.escape import escaped
from beamfield.report.exponent_section import taken_sentence
from beamfield.report.page import fold, table
from beamfield.report.page_section import PageSection
from beamfield.report.text_table import aligned, interval_text, plus_minus

ANCHOR, TITLE = "field", "Likelihood field"
MEANINGS = {
    "z_hit": ("-", "share of readings that end near an obstacle on their beam's axis"),
    "z_rand": ("-", "share of readings that nothing explains, spread evenly over all ranges"),
    "sigma_hit": ("m", "deviation of a hit from its obstacle, with the error of the reference poses"),
    "exponent": ("-", "power of each beam's value in a filter, because beams and scans depend on each other"),
    "single_scan_exponent": ("-", "the same for one scan on its own"),
}
PARAMETER_HEADER = ("likelihood field", "value", "95% interval", "unit", "meaning")
SCORE_HEADER = ("held-out blocks", "nats per reading ± s.e.", "nats per posterior ± s.e.", "covered")


def field_tables(learned: FieldLearning, *, width: int | None = None) -> str:
    """Return the tables for the terminal: the parameters, and how they do on held-out blocks."""
    parts = [
        aligned(PARAMETER_HEADER, _parameter_rows(learned), right=(1,), width=width),
        aligned(SCORE_HEADER, [_score_row(score) for score in learned.scores], right=(1, 2, 3), width=width),
        f"The exponents are for {learned.n_beams} beams of each scan.",
    ]
    return "\n\n".join(parts)


def field_section(learned: FieldLearning, file_text: str) -> PageSection:
    """Return the section of the report, which holds the parameter file."""
    markup = (
        f"{table(PARAMETER_HEADER, _parameter_rows(learned), right=(1,), css='parameters')}"
        f"<p>For <code>LikelihoodFieldModel</code> with {learned.n_beams} beams of each scan. z_hit, z_rand and "
        "sigma_hit make the readings most likely along the axes of their beams; without the reference poses' error "
        f"sigma_hit is {learned.density_sigma:.4g} m. With the exponents, the 90% regions of posteriors around the "
        "reference poses hold the truth in 90% of the cases: of drives of some scans, and of single scans."
        f"{'' if learned.exponents is None else taken_sentence(learned.exponents)}</p>"
        f"{fold('How well it does on held-out blocks', _scores(learned))}"
        f"{fold('The file likelihood_field.yaml', f'<pre>{escaped(file_text)}</pre>')}"
    )
    return PageSection(ANCHOR, TITLE, markup)


def _scores(learned: FieldLearning) -> str:
    return (
        f"{table(SCORE_HEADER, [_score_row(score) for score in learned.scores], right=(1, 2, 3))}"
        "<p>Nats per reading: mean log density along the axis, given that the reading is a range. Nats per posterior: "
        "mean logarithm of the posterior's density at the reference over the prior's, of a few scans each; 0 for a "
        "field that says nothing, far below 0 for one that is certain and wrong. Covered: share of those posteriors "
        "whose 90% region holds the truth.</p>"
    )


def _parameter_rows(learned: FieldLearning) -> list[tuple[str, ...]]:
    values = {**asdict(learned.parameters), "exponent": learned.exponent}
    if learned.exponents is not None:
        values["single_scan_exponent"] = learned.exponents.single.value
    return [
        (name, f"{values[name]:.3g}", interval_text(*learned.intervals[name]), unit, meaning)
        for name, (unit, meaning) in MEANINGS.items()
        if name in values
    ]


def _score_row(score: FieldScore) -> tuple[str, ...]:
    density = plus_minus(score.log_density, score.log_density_se)
    if score.posterior is None or score.posterior_se is None:
        return (score.name, density, "", "")
    covered = "" if score.coverage is None else f"{score.coverage:.0%}"
    return (score.name, density, plus_minus(score.posterior, score.posterior_se), covered)
