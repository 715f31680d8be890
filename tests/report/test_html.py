"""The page: complete, self-contained, safe."""

from __future__ import annotations

import concurrent.futures
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.figure import Figure

from beamfield.calibration.calibrate import CalibrationOptions
from beamfield.finding import Finding
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report import panel
from beamfield.report.html import render_report
from beamfield.report.map_figures import cause_map, fit_map
from beamfield.report.mixture_figure import mixture
from beamfield.report.page import document, finding_list
from beamfield.report.page_section import PageSection
from beamfield.report.parameter_rows import parameter_rows
from beamfield.report.pit_figure import pit_histogram
from beamfield.report.text_table import plus_minus
from beamfield.scan_fit.calibration_fit import fit_of_calibration
from beamfield.sensors import NoReturnPolicy

FIGURES = {
    "histograms",
    "readings",
    "mixture",
    "pit",
    "cause-map",
    "fit-map",
    "scan-fit",
    "noise",
    "bearings",
    "opposite",
    "refinement",
}
VOID = {"meta", "img", "br", "hr", "input", "link"}


class Page(HTMLParser):
    """What a browser would see: balance of tags, ids, figures, text alternatives."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        values = dict(attrs)
        self.tags.append((tag, values))
        if "id" in values:
            self.ids.append(values["id"])
        self.links += [values[name] for name in ("href", "src") if name in values]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join("".join(self.words).split())

    @property
    def figures(self) -> set[str]:
        return {values["id"] for tag, values in self.tags if tag == "figure"}


def render(case, **changes) -> str:
    calibration = replace(case.calibration, **changes)
    scan_fit = fit_of_calibration(calibration, case.grid, case.log)
    return render_report(calibration, case.grid, case.log, case.provenance, scan_fit=scan_fit)


@pytest.fixture
def no_figures(monkeypatch):
    """Leave the figures out where only words are tested: they take seconds."""
    monkeypatch.setattr("beamfield.report.html.report_figures", lambda *_: [])
    monkeypatch.setattr(f"{__name__}.fit_of_calibration", lambda *_: None)


@pytest.fixture(scope="module")
def drawn(case) -> tuple[str, list[Figure]]:
    """The page, and the figures that its pictures show."""
    figures = []
    with pytest.MonkeyPatch.context() as patched:
        for canvas in (panel.FigureCanvasSVG, panel.FigureCanvasAgg):
            patched.setattr(panel, canvas.__name__, lambda figure, of=canvas: figures.append(figure) or of(figure))
        return render(case), figures


@pytest.fixture(scope="module")
def text(drawn) -> str:
    return drawn[0]


@pytest.fixture(scope="module")
def page(text) -> Page:
    return Page(text)


def test_every_figure_is_there_with_caption_and_text_alternative(page):
    assert page.figures == FIGURES
    assert sum(tag == "figcaption" for tag, _ in page.tags) == len(FIGURES)
    pictures = [values for tag, values in page.tags if tag == "img" or values.get("class") == "plot"]
    assert len(pictures) >= len(FIGURES)
    assert sum(values.get("type") == "checkbox" for _, values in page.tags) == len(pictures)  # a click enlarges it
    assert all(len(values.get("alt") or values.get("aria-label") or "") > 20 for values in pictures)


def test_no_text_leaves_its_picture(drawn):
    assert len(drawn[1]) > len(FIGURES)
    for figure in drawn[1]:
        low, high = figure.get_tightbbox().get_points()
        assert (low > -0.02).all(), figure.axes[0].get_title()
        assert (high < figure.get_size_inches() + 0.02).all(), figure.axes[0].get_xlabel()


def test_no_text_leaves_the_picture_of_a_tall_map(case, monkeypatch):
    figures = []
    canvas = panel.FigureCanvasAgg
    monkeypatch.setattr(panel, "FigureCanvasAgg", lambda figure: figures.append(figure) or canvas(figure))
    monkeypatch.setattr("beamfield.report.map_figures._limits", lambda *_: (3.0, 9.0, -9.0, 15.0))
    cause_map(case.calibration, case.grid, case.log)
    low, high = figures[0].get_tightbbox().get_points()
    assert (low > -0.02).all()
    assert (high < figures[0].get_size_inches() + 0.02).all()


def test_nothing_is_fetched_and_nothing_runs(text, page):
    assert "http" not in text
    assert "<script" not in text
    assert "@import" not in text
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in page.links)
    assert not any(name.startswith("on") for _, values in page.tags for name in values)


def test_ids_are_unique_and_every_link_inside_the_page_has_its_target(text, page):
    assert len(set(page.ids)) == len(page.ids)
    targets = {link[1:] for link in page.links if link.startswith("#")} | set(re.findall(r"url\(#([^)]+)\)", text))
    assert targets <= set(page.ids)


def test_numbers_in_the_tables_are_the_calibrations(case, text):
    for row in parameter_rows(case.calibration):
        assert f'<th scope="row">{row.name}</th><td class="n">{row.value}</td>' in text
        assert row.interval in text
    for score in case.calibration.scores:
        assert plus_minus(score.log_likelihood, score.standard_error) in text
    snippet = text[text.index("<pre>") : text.index("</pre>")]
    assert "sigma_hit: 0.05\n" in snippet
    assert "max_range: 10" in snippet


def test_head_names_inputs_date_and_program(page):
    assert "log drive.log · map room.yaml · recorded 2023-11-14 22:13 UTC · beamfield 0.0.test" in page.text
    assert "ab" * 32 in page.text


def test_verdict_tells_the_gain_over_the_defaults(case, page):
    nav2, ros1 = case.calibration.scores[1:3]
    assert f"beats nav2's defaults by {nav2.behind_fit:.2f} and ROS 1's by {ros1.behind_fit:.2f} nats" in page.text
    assert "sigma_hit is 0.0500 m [0.0480, 0.0525]." in page.text
    assert "Read the warning before you trust it." in page.text


@pytest.mark.usefixtures("no_figures")
def test_verdict_admits_a_fit_that_is_not_better(case):
    scores = list(case.calibration.scores)
    scores[2] = replace(scores[2], behind_fit=-0.01)
    learning = replace(case.calibration.learning, converged=False)
    text = Page(render(case, scores=tuple(scores), learning=learning)).text
    assert "does not beat ROS 1's on held-out beams" in text
    assert "did not converge" in text
    assert "verdict bad" in render(case, scores=tuple(scores), learning=learning)
    assert "verdict care" in render(case, scores=tuple(scores))


def test_warnings_come_before_the_parameters_and_the_rest_is_folded(text):
    warning, folded = text.index("The map is poor."), text.index("The poses are good.")
    assert text.index('id="warnings"') < warning < text.index('id="parameters"')
    assert text.rindex("<details ", 0, folded) > warning


def test_one_picture_opens_the_page_and_evidence_is_folded(text):
    places = ["verdict care", '<figure id="cause-map">', 'id="warnings"', 'id="parameters"', '<figure id="scan-fit">']
    assert [text.index(place) for place in places] == sorted(text.index(place) for place in places)
    folded = set(re.findall(r'<details class="fold"><summary>.*</summary>\n<(?:figure|div) id="(.*?)"', text))
    assert folded == FIGURES - {"cause-map", "scan-fit"} | {"data", "origin"}


def test_a_finding_says_what_was_seen_why_it_matters_and_what_to_do(page):
    assert "Warning The map is poor. poor-map It matters. What to do: Draw a better one." in page.text
    assert "What to do" not in Page(document("", finding_list([Finding("n", "info", "x")]), [], "")).text


@pytest.mark.usefixtures("no_figures")
def test_the_part_that_was_asked_for_opens_the_page_and_warns_where_nothing_can_be_trusted(case):
    asked = PageSection("stack", "nav2: beam", "<p>Values.</p>", "It is better.", "good")
    other = PageSection("field", "Likelihood field", "<p>Field.</p>")

    def with_findings(*findings: Finding) -> str:
        calibration = replace(case.calibration, findings=findings)
        return render_report(calibration, case.grid, case.log, sections=[other, asked])

    text = with_findings()
    assert "<title>nav2: beam for /scan</title>" in text
    places = ["<h1>", "verdict good", "It is better.", "Values.", 'id="beam-model"', "beats nav2", "Field."]
    assert [text.index(place) for place in places] == sorted(text.index(place) for place in places)
    first = re.search(r'<p class="verdict bad">.*', with_findings(Finding("map-scale", "warning", "")))
    assert "Do not use these values yet: the scale of the map is wrong.</p>" in first[0]


@pytest.mark.usefixtures("no_figures")
def test_a_folded_section_stands_at_the_end_and_keeps_its_anchor(case):
    part = PageSection("fitted-poses", "Poses fitted", "<p>Evidence.</p>", folded=True)
    text = render_report(case.calibration, case.grid, case.log, sections=[part])
    assert text.index('id="figures"') < text.index('<summary><h3>Poses fitted</h3></summary>\n<div id="fitted-poses">')


def test_the_page_can_be_read_without_seeing_it(text, page):
    assert [tag for tag, _ in page.tags].count("main") == 1
    assert page.links[0] == "#main"
    heads = [values for tag, values in page.tags if tag == "th"]
    assert heads
    assert all(values.get("scope") in ("col", "row") for values in heads)
    assert "Use with care" in page.text  # not by its colour alone
    assert "prefers-color-scheme: dark" in text


def test_what_was_not_given_is_named_in_one_line(page):
    assert "Not given: options.block." in page.text
    assert "not given" not in page.text.replace("Not given", "")


def test_dropped_scans_and_beams_are_counted(page):
    assert "scans in the log120100.0% used11797.5% dropped: standing still32.5%" in page.text
    assert "left out: no measurement (NaN)50.1% left out: nearer than min_range = 0 m00.0%" in page.text


@pytest.mark.usefixtures("no_figures")
def test_text_from_files_is_escaped(case):
    evil = '<script>alert("x")</script>&\'\x1b[2J\x07\x85\x9b\u202e'
    log = replace(
        case.log,
        finder=replace(case.log.finder, name=evil),
        no_return=NoReturnPolicy((), 0.0, "given", evil),
    )
    provenance = {"inputs": {"log": {"name": evil, "sha256": evil}, evil: evil}, evil: [evil], "program": evil}
    findings = (Finding("n", "warning", evil), Finding(evil, "info", evil))
    text = render_report(replace(case.calibration, findings=findings), case.grid, log, provenance)
    assert "<script" not in text
    assert "&lt;script&gt;" in text
    assert "alert(" in Page(text).text
    assert text.replace("\n", "").isprintable()


@pytest.mark.usefixtures("no_figures")
def test_a_line_break_in_a_name_cannot_add_a_line_to_the_snippet(case):
    log = replace(case.log, finder=replace(case.log.finder, name="/scan\nz_hit: 1"))
    text = render_report(case.calibration, case.grid, log)
    assert not re.search(r"^z_hit: 1$", text, flags=re.MULTILINE)


def test_the_page_is_small(text):
    assert len(text) < 3_000_000


def test_the_same_calibration_gives_the_same_pictures_also_from_threads(case, text):
    def draw(_: int) -> list[str]:
        calibration = case.calibration
        figures = (mixture(calibration), pit_histogram(calibration), fit_map(calibration, case.grid, case.log))
        return [panel.markup for figure in figures for panel in figure.panels]

    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        first, second = pool.map(draw, range(2))
    assert first == second
    assert len(first) == 3
    assert all(picture in text for picture in first)


@pytest.mark.usefixtures("no_figures")
def test_how_the_log_was_read_and_what_stands_in_for_map_and_poses_is_said(case):
    origin = {"inputs": {"log": "a.log"}, "options": {"odometry": True}, "notes": ["stamps <lost>"]}
    text = render_report(replace(case.calibration, map_from_log=True), case.grid, case.log, origin)
    page = Page(text)
    assert "map drawn from the log" in page.text
    assert "poses odometry of the log" in page.text
    assert "How the log was read: stamps <lost>" in page.text
    assert page.text.count("stamps <lost>") == 1
    plain = Page(render(case)).text
    assert "drawn from the log" not in plain
    assert "odometry" not in plain


@pytest.mark.usefixtures("no_figures")
def test_a_noise_that_the_log_hardly_determines_is_called_so(case):
    def verdict_with(interval: tuple[float, float]) -> str:
        intervals = replace(case.calibration.intervals, intervals={"sigma_hit": interval})
        return Page(render(case, intervals=intervals)).text

    assert "[0.050, 0.510], hardly determined by this log." in verdict_with((0.05, 0.51))
    assert "hardly determined" not in verdict_with((0.05, 0.49))


@pytest.mark.usefixtures("no_figures")
def test_the_chapters_form_can_be_copied_where_another_was_chosen(case):
    first, second = case.calibration.candidates
    wide = replace(first.result, parameters=replace(first.result.parameters, sigma_hit=0.0777))
    chosen = (replace(first, result=wide, chosen=False), replace(second, gain=0.25, chosen=True))
    parameters = replace(case.calibration.parameters, range_offset=0.03)
    text = render(case, candidates=chosen, parameters=parameters)
    assert "range_offset: 0.03" in text
    assert "sigma_hit: 0.0777" in text
    assert "0.2500 nats less per held-out beam" in text


HALF_CIRCLE = np.radians(np.arange(-80, 81, 4.0))
ONE_BEAM = np.zeros(1)
DEGENERATE = {
    "hits only whose noise grows, half a circle, one held-out block, long limit, no refinement, no date": (
        {
            "truth": BeamParameters(1.0, 0.0, 0.0, 0.0, 0.03, 0.0, 0.1, 0.02),
            "bearings": HALF_CIRCLE,
            "options": CalibrationOptions(block_s=50.0),
            "max_range": 80.0,
            "with_refinement": False,
            "start": 0.0,
        },
        {"opposite", "refinement"},
    ),
    "no hit": ({"truth": BeamParameters(0.0, 0.5, 0.2, 0.3, 0.05, 0.0)}, {"noise", "opposite"}),
    "one beam and one expected range": (
        {"bearings": ONE_BEAM, "n_scans": 600, "same_place": True},
        {"opposite"},
    ),
}


@pytest.mark.parametrize(("changes", "missing"), DEGENERATE.values(), ids=DEGENERATE.keys())
def test_degenerate_calibrations_have_a_page(make_case, changes, missing):
    page = Page(render(make_case(**changes)))
    assert page.figures == FIGURES - missing
    # One beam has no group of neighbours and few scans that count: the figure gives its place to the reason.
    assert ("Not drawn: " in page.text) is (len(changes.get("bearings", HALF_CIRCLE)) == 1)
    assert "nan" not in page.text.lower().replace("no measurement (nan", "")


@pytest.mark.usefixtures("no_figures")
def test_unknown_standard_errors_do_not_reach_the_page(case):
    scores = tuple(replace(s, standard_error=float("nan"), behind_fit_se=float("nan")) for s in case.calibration.scores)
    candidates = tuple(replace(c, gain_se=float("nan")) for c in case.calibration.candidates)
    intervals = replace(case.calibration.intervals, intervals={}, standard_errors={}, n_blocks=1)
    page = Page(render(case, scores=scores, candidates=candidates, intervals=intervals))
    assert "not determined" in page.text
    assert "There are no intervals" in page.text
    assert "nan" not in page.text.lower().replace("no measurement (nan", "")


@pytest.mark.usefixtures("no_figures")
def test_forms_are_compared_where_more_than_one_was_allowed(case):
    first, second = case.calibration.candidates
    page = Page(render(case, candidates=(first, replace(second, gain=0.25, gain_se=0.01))))
    assert f"plain Gaussian {second.name}+0.2500 ± 0.0100" in page.text
    assert "form of a hit" not in Page(render(case, candidates=(first,))).text
