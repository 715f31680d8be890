"""The page in a browser as narrow as a phone."""

from __future__ import annotations

import os
import shutil

import pytest
from matplotlib.figure import Figure

from beamfield.report.drawing import NARROW, WIDE
from beamfield.report.page import document, figure
from beamfield.report.panel import ReportFigure, png_panel, svg_panel

sync_api = pytest.importorskip("playwright.sync_api")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed, so the report is not tested in one"),
    # Its driver leaves sockets to the end of the process.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def test_pictures_are_seen_whole_and_a_tap_enlarges_them():
    panels = (
        svg_panel(Figure(figsize=(WIDE, 3.0)), "a", "wide"),
        png_panel(Figure(figsize=(WIDE, 3.0)), "wide"),
        png_panel(Figure(figsize=(NARROW, 3.0)), "narrow"),
    )
    text = document("Report", figure(ReportFigure("fit", "Fit", panels, "A caption.", "Section 6.3")), (), "")
    with sync_api.sync_playwright() as playwright:
        # Containers often run as root, where Chromium's own sandbox does not start.
        arguments = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
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
        browser.close()
