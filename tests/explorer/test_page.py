"""The explorer's page in a real browser; skipped where there is none."""

import os
import shutil
import threading

import numpy as np
import pytest

from beamfield.explorer.server import explorer_app, listening_socket, new_token, page_address

uvicorn = pytest.importorskip("uvicorn")
sync_api = pytest.importorskip("playwright.sync_api")
axe = pytest.importorskip("axe_playwright_python.sync_playwright")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed, so the explorer's page is not tested"),
    # Its driver leaves sockets to the end of the process.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def address(session):
    """Serve the session from a thread."""
    token = new_token()
    with listening_socket(0) as listening:
        port = listening.getsockname()[1]
        server = uvicorn.Server(
            uvicorn.Config(explorer_app(session, token, port), log_level="warning", lifespan="off", ws="none")
        )
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
        thread.start()
        yield page_address(port, token)
        server.should_exit = True
        thread.join(timeout=20)


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        # Containers often run as root, where Chromium's own sandbox does not start.
        arguments = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield started
        started.close()


@pytest.fixture
def opened(browser, address):
    """Return a function that opens the page and waits for its scores; at the end there must be no complaint."""
    complaints, contexts = [], []

    def open_page(words="", *, width=1300, height=850, scheme="light"):
        contexts.append(browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme))
        page = contexts[-1].new_page()
        page.on("console", lambda said: complaints.append(said.text) if said.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(f"{address}{words}")
        sync_api.expect(page.locator("tbody td").first).not_to_have_text("")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []


def scores(page):
    return page.locator("tbody tr td:nth-child(2)").all_text_contents()


def pose(page):
    words = page.locator(".head .pose").text_content().replace(",", " ").split()
    return float(words[1]), float(words[4]), float(words[7].rstrip("°"))


def place(page, which):
    """Return where the robot or the tip of its arrow is on the screen."""
    page.wait_for_timeout(60)  # a frame
    canvas = page.locator(".map canvas")
    x, y = map(float, canvas.get_attribute(f"data-{which}").split())
    box = canvas.bounding_box()
    return box["x"] + x, box["y"] + y


def drag(page, start, x, y):
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(start[0] + x, start[1] + y, steps=5)
    page.mouse.up()


def test_the_robot_is_dragged_and_turned_and_the_scores_follow(opened):
    page = opened()
    x, y, heading = pose(page)
    before = scores(page)
    drag(page, place(page, "robot"), 60, -40)
    moved = pose(page)
    assert moved[0] > x + 0.2
    assert moved[1] > y + 0.2
    assert moved[2] == heading
    for row, text in enumerate(before):
        sync_api.expect(page.locator("tbody tr").nth(row).locator("td").first).not_to_have_text(text)
    drag(page, place(page, "tip"), 0, -80)
    assert pose(page)[:2] == moved[:2]
    assert 20.0 < pose(page)[2] < 120.0
    page.get_by_role("button", name="Reference").click()
    assert pose(page) == (x, y, heading)
    sync_api.expect(page.locator("tbody td").first).to_have_text(before[0])


def test_keys_move_the_robot_and_go_through_the_log(opened):
    page = opened()
    canvas = page.locator(".map canvas")
    _, y, heading = pose(page)
    canvas.press("ArrowUp")
    assert pose(page)[1] == pytest.approx(y + 0.1, abs=0.011)
    canvas.press("[")
    assert pose(page)[2] == pytest.approx(heading + np.degrees(0.05), abs=0.11)
    canvas.press(".")
    assert "scan 2 of 12" in page.locator(".time").text_content()
    canvas.press("r")
    assert pose(page)[0] == pytest.approx(5.0 / 11.0, abs=0.01)
    page.locator(".worst button").first.click()
    assert "scan 11 of 12" in page.locator(".time").text_content()


def test_a_slider_changes_the_scores_the_judgement_and_the_file(opened):
    page = opened()
    judged = page.locator("section[aria-label=Parameters] .note")
    sync_api.expect(judged).to_contain_text("over 11 scans")
    before = scores(page)
    page.get_by_label("sigma_hit").fill("400")
    sync_api.expect(judged).to_contain_text("by your change")
    sync_api.expect(page.locator("tbody td").first).not_to_have_text(before[0])
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Download file").click()
    assert waiting.value.suggested_filename == "beam_model.yaml"
    page.get_by_role("button", name="Reset").click()
    sync_api.expect(page.locator("tbody td").first).to_have_text(before[0])


def test_a_reading_shows_its_density_and_a_filter_its_way(opened):
    page = opened()
    x, y = place(page, "robot")
    text = page.locator("section[aria-label='One reading'] .note")
    # Somewhere ahead of the robot a reading ends within reach of the pointer.
    for ahead in range(30, 900, 15):
        page.mouse.move(x + ahead, y)
        if "Reading" in (text.text_content() or ""):
            break
    sync_api.expect(text).to_contain_text("expected")
    sync_api.expect(text).to_contain_text("Causes: hit")
    page.get_by_role("button", name="Run filter").click()
    sync_api.expect(page.get_by_role("button", name="Hide filter")).to_be_visible()
    page.get_by_role("button", name="Whole building").click()
    page.get_by_role("button", name="Heat map").click()


def test_a_link_leads_to_the_same_moment_and_pose(opened):
    page = opened("#i=7&x=2.5&y=0.75&heading=0.5&set=1")
    assert pose(page) == (2.5, 0.75, 28.6)
    assert "scan 8 of 12" in page.locator(".time").text_content()
    assert page.get_by_label("typical likelihood field").is_checked()
    page.locator(".map canvas").press("ArrowRight")
    assert "x=2.6000" in page.url
    assert pose(opened("#i=99&x=nonsense&set=-1"))[0] == 0.0


@pytest.mark.parametrize(
    ("width", "height", "scheme"), [(1300, 850, "light"), (1300, 850, "dark"), (390, 800, "light")]
)
def test_it_fits_the_screen_and_axe_finds_nothing_serious(opened, width, height, scheme):
    page = opened(width=width, height=height, scheme=scheme)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    found = axe.Axe().run(page).response["violations"]
    serious = [(one["id"], one["nodes"][0]["html"]) for one in found if one["impact"] in ("serious", "critical")]
    assert serious == []
    canvas = np.frombuffer(page.locator(".map canvas").screenshot(), np.uint8)
    assert len(canvas) > 5000  # not blank


def test_without_the_token_it_says_what_to_do(browser, address):
    context = browser.new_context()
    page = context.new_page()
    page.goto(address.split("?")[0])
    assert "open the address" in page.locator("body").text_content()
    context.close()
