"""The page in a browser: as narrow as a phone, and where a link leads into a fold."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from matplotlib.figure import Figure

from beamfield.finding import Finding
from beamfield.fleet.report_page import _lights
from beamfield.fleet.robot_state import RobotState
from beamfield.report.drawing import NARROW, WIDE
from beamfield.report.page import document, figure, fold
from beamfield.report.panel import ReportFigure, png_panel, svg_panel

# The browser's driver leaves sockets to the end of the process.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def test_pictures_are_seen_whole_and_a_tap_enlarges_them(browser):
    panels = (
        svg_panel(Figure(figsize=(WIDE, 3.0)), "a", "wide"),
        png_panel(Figure(figsize=(WIDE, 3.0)), "wide"),
        png_panel(Figure(figsize=(NARROW, 3.0)), "narrow"),
    )
    text = document("Report", figure(ReportFigure("fit", "Fit", panels, "A caption.", "Section 6.3")), (), "")
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.set_content(text)
    pictures = page.locator("svg.plot, img")
    assert pictures.count() == 3
    for k in range(3):
        box = pictures.nth(k).bounding_box()
        assert box["x"] >= 0.0
        assert 300.0 < box["x"] + box["width"] <= 390.0
    pictures.first.click()
    assert pictures.first.bounding_box()["width"] == 1000.0


def test_a_link_unfolds_what_it_leads_to_and_what_is_folded_is_not_printed(browser):
    main = fold("Data used", "<p>Counts.</p>", "data") + fold("Origin", "<p>Names.</p>", "origin")
    page = browser.new_page()
    page.set_content(document("Report", main, [("data", "Data")], ""))
    data, folds = page.get_by_text("Counts."), page.locator("details")
    assert not data.is_visible()
    page.get_by_role("link", name="Data").click()
    assert data.is_visible()
    page.emulate_media(media="print")
    assert [folds.nth(k).is_visible() for k in range(2)] == [True, False]


def test_what_to_do_about_a_robot_is_seen_on_a_phone(browser):
    finding = Finding("dirty-lens", "warning", "Readings have no return. " * 9, do="Wipe it.")
    state = RobotState("robot-7", "hall", "red", (finding,), urgency=1.0, runs=6, left_out=0)
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.set_content(document("Fleet", _lights(SimpleNamespace(states=[state], differences=())), (), ""))
    box = page.get_by_text("Wipe it.").bounding_box()
    assert box["x"] >= 0.0
    assert box["x"] + box["width"] <= 390.0
