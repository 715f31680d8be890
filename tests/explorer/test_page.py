"""The explorer's page in a real browser; skipped where there is none."""

import io
import threading
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from beamfield.explorer.parameter_set import read_set, typical_sets
from beamfield.explorer.server import explorer_app, listening_socket, new_token, page_address
from beamfield.explorer.session import Session
from beamfield.explorer.shown_run import ShownRun
from beamfield.explorer.widget import RENDER, answered, component
from beamfield.sensors import SensorLog

uvicorn = pytest.importorskip("uvicorn")
sync_api = pytest.importorskip("playwright.sync_api")
axe = pytest.importorskip("axe_playwright_python.sync_playwright")

SERIOUS = ("serious", "critical")
# The browser's driver leaves sockets to the end of the process.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@contextmanager
def served(session):
    """Serve a session from a thread; the address of its page."""
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


@pytest.fixture
def serve():
    """Return a function that serves a session until the test's pages are closed."""
    with ExitStack() as stack:
        yield lambda session: stack.enter_context(served(session))


@pytest.fixture(scope="module")
def address(session):
    with served(session) as place:
        yield place


@pytest.fixture(scope="module")
def tab(browser):
    """A tab of the browser, and what it complains about."""
    page, complaints = browser.new_page(), []
    page.on("console", lambda said: complaints.append(said.text) if said.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    return page, complaints


@pytest.fixture
def opened(tab, address, serve):  # noqa: ARG001 (servers end after their pages)
    """Return a function that opens the page and waits for its scores; at the end there must be no complaint.

    All tests share a tab, which takes half the time of one each; the page keeps nothing in it.
    """
    page, complaints = tab

    def open_page(words="", *, width=1300, height=850, scheme="light", place=address):
        page.goto("about:blank")  # another place in the page would not load it anew
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=scheme)
        page.goto(f"{place}{words}")
        sync_api.expect(page.locator("tbody td").first).not_to_have_text("")
        return page

    yield open_page
    page.goto("about:blank")
    said = complaints.copy()
    complaints.clear()
    assert said == []


def scores(page):
    return page.locator("tbody tr td:nth-child(2)").all_text_contents()


def pose(page):
    words = page.locator(".head .pose").text_content().replace(",", " ").replace("\N{MINUS SIGN}", "-").split()
    return float(words[1]), float(words[4]), float(words[7].rstrip("°"))


def place(page, which, number=0):
    """Return where the robot or the tip of its arrow is on the screen, on one of the maps."""
    page.wait_for_timeout(60)  # a frame
    canvas = page.locator(".map canvas").nth(number)
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
    canvas = page.locator(".map canvas").first
    _, y, heading = pose(page)
    canvas.press("ArrowUp")
    assert pose(page)[1] == pytest.approx(y + 0.1, abs=0.011)
    canvas.press("[")
    assert pose(page)[2] == pytest.approx(heading + np.degrees(0.05), abs=0.11)
    canvas.press(".")
    assert "scan 2 of 12" in page.locator(".time").text_content()
    canvas.press("r")
    assert pose(page)[0] == pytest.approx(5.0 / 11.0, abs=0.01)
    canvas.press("b")
    sync_api.expect(page.locator(".reading .note")).to_contain_text("Reading 40:")
    canvas.press("n")
    sync_api.expect(page.locator(".reading .note")).to_contain_text("Reading 0:")
    page.locator(".worst button").first.click()
    assert "scan 11 of 12" in page.locator(".time").text_content()


def test_a_slider_changes_the_scores_the_judgement_and_the_file(opened):
    page = opened()
    judged = page.locator(".judged")
    sync_api.expect(judged).to_contain_text("over 11 scans: pose score")
    before = scores(page)
    page.get_by_label("sigma_hit").fill("400")
    sync_api.expect(judged).to_contain_text("by your change")
    sync_api.expect(page.locator("tbody td").first).not_to_have_text(before[0])
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Download file").click()
    assert waiting.value.suggested_filename == "beam_model.yaml"
    page.get_by_role("button", name="Reset").click()
    sync_api.expect(page.locator("tbody td").first).to_have_text(before[0])


def test_values_are_set_to_those_of_another_set_and_written_into_the_users_file(opened, serve, grid, log, tmp_path):
    mine = tmp_path / "nav2.yaml"
    text = 'amcl:\n  ros__parameters:\n    laser_model_type: "likelihood_field"\n    sigma_hit: 3.0  # mine\n'
    mine.write_text(text)
    sets = [read_set(mine, grid, log.finder)]
    sets += typical_sets(grid, log.finder, sets)
    page = opened(place=serve(Session(log, grid, sets)))
    sigma = page.get_by_label("sigma_hit")
    assert sigma.get_attribute("aria-valuetext") == "3 m"
    page.locator(".parameters select").select_option(label="nav2's default likelihood_field")
    sync_api.expect(sigma).to_have_attribute("aria-valuetext", "0.2 m")
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Download file").click()
    assert waiting.value.suggested_filename == "nav2.yaml"
    assert "sigma_hit: 0.2  # mine" in Path(waiting.value.path()).read_text()
    assert mine.read_text() == text


def test_two_models_are_compared_at_the_same_moment_and_along_the_log(opened):
    page = opened("#i=3")
    one, other = page.locator("figure").nth(0), page.locator("figure").nth(1)
    sync_api.expect(other).to_be_hidden()
    whole = one.bounding_box()["width"]
    page.get_by_label("Beside it").select_option(label="typical likelihood field")
    sync_api.expect(other).to_be_visible()
    assert one.bounding_box()["width"] == pytest.approx(whole / 2, abs=3)
    assert one.locator("figcaption").text_content() == "A: typical beam model"
    assert other.locator("figcaption").text_content() == "B: typical likelihood field"
    verdict = page.locator(".verdict")
    sync_api.expect(verdict).to_contain_text("This scan: pose score")
    sync_api.expect(verdict).to_contain_text("Over 11 scans of the log: A better in")
    assert page.get_by_label("Curve of the timeline").input_value() == "A \N{MINUS SIGN} B: pose score [nats]"
    sync_api.expect(page.locator(".worst")).to_contain_text("better:")
    page.wait_for_url("**other=1*")
    # Both maps show one robot: dragged on one, it moves on the other.
    page.mouse.move(*place(page, "robot", 1))
    drag(page, place(page, "robot", 1), 30, -30)
    assert place(page, "robot", 0)[1] == pytest.approx(place(page, "robot", 1)[1])
    # What is beside changes places with what is chosen; by keys, too, which keep the focus.
    page.get_by_role("radio", name="typical beam model").press("ArrowDown")
    assert other.locator("figcaption").text_content() == "B: typical beam model"
    page.keyboard.press("ArrowDown")
    assert one.locator("figcaption").text_content().startswith("A: nav2's default")
    page.get_by_label("Beside it").select_option(label="nothing")
    sync_api.expect(other).to_be_hidden()


def particles_drawn(page):
    """Return how many pixels of the map have the colour of particles."""
    page.wait_for_timeout(100)
    with Image.open(io.BytesIO(page.locator(".map canvas").first.screenshot())) as picture:
        return int((np.asarray(picture.convert("RGB")) == [0x7A, 0x4F, 0x00]).all(axis=-1).sum())


def test_a_run_that_was_given_is_shown_with_its_particles(opened, serve, grid, log):
    way = log.odometry + np.array([0.0, 0.3, 0.0])
    run = ShownRun(way, {2: way[2] + np.zeros((50, 3))}, {"filter: position error [m]": np.full(len(log), 0.3)})
    page = opened("#i=2", place=serve(Session(log, grid, typical_sets(grid, log.finder), run=run)))
    # The robot stands where the filter took it to be, the reference beside it.
    assert pose(page)[1] == pytest.approx(0.6)
    page.get_by_role("button", name="Heat map").click()
    assert particles_drawn(page) > 50
    page.get_by_role("button", name="Recorded run").click()
    assert particles_drawn(page) == 0
    assert "filter: position error [m]" in page.get_by_label("Curve of the timeline").text_content()
    page.get_by_role("button", name="Reference").click()
    assert pose(page)[1] == pytest.approx(0.3)


def test_a_reading_shows_its_density_and_a_filter_its_way(opened):
    page = opened()
    x, y = place(page, "robot")
    text = page.locator(".reading .note")
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


def test_a_filter_that_is_lost_says_so_while_it_is_shown(opened):
    page = opened("#i=2&x=3.41&y=3.5&heading=1.37&set=1")
    said = page.locator(".lost").first
    sync_api.expect(said).to_have_text("")
    page.get_by_role("button", name="Run filter").click()
    sync_api.expect(said).to_contain_text("of a scan's readings agree with the map")
    page.get_by_role("button", name="Hide filter").click()
    sync_api.expect(said).to_have_text("")


def test_a_link_leads_to_the_same_moment_and_pose(opened):
    page = opened("#i=7&x=2.5&y=0.75&heading=0.5&set=1")
    assert pose(page) == (2.5, 0.75, 28.6)
    assert "scan 8 of 12" in page.locator(".time").text_content()
    assert page.get_by_label("typical likelihood field").is_checked()
    page.locator(".map canvas").first.press("ArrowRight")
    page.wait_for_url("**x=2.6000*")
    assert pose(opened("#i=99&x=nonsense&set=-1"))[0] == 0.0


@pytest.mark.parametrize(("width", "height", "scheme"), [(1300, 850, "dark"), (390, 800, "light")])
def test_it_fits_the_screen_and_axe_finds_nothing_serious(opened, width, height, scheme):
    page = opened("#i=3&other=2", width=width, height=height, scheme=scheme)
    sync_api.expect(page.locator(".verdict")).to_contain_text("of the log")
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    found = axe.Axe().run(page).response
    serious = [(one["id"], one["nodes"][0]["html"]) for one in found["violations"] if one["impact"] in SERIOUS]
    assert serious == []
    assert {"color-contrast", "document-title", "html-has-lang", "meta-viewport"} <= {
        one["id"] for one in found["passes"]
    }
    for k in range(2):
        assert len(page.locator(".map canvas").nth(k).screenshot()) > 5000  # not blank


def test_axe_would_find_a_text_that_cannot_be_read(opened):
    page = opened()
    page.evaluate("() => document.querySelector('h2').style.color = '#ccd'")
    found = axe.Axe().run(page).response["violations"]
    assert [one["id"] for one in found if one["impact"] in SERIOUS] == ["color-contrast"]


def test_the_page_is_light_loads_nothing_from_elsewhere_and_is_walked_through_in_order(opened):
    page = opened()
    loaded = page.evaluate(
        "() => performance.getEntriesByType('resource').filter((e) => !e.name.startsWith('data:'))"
        ".map((e) => [e.name, e.decodedBodySize])"
    )
    assert all(name.startswith(page.evaluate("location.origin")) for name, _ in loaded)
    assert sum(size for name, size in loaded if not name.endswith("ask")) < 80_000
    walked = []
    for _ in range(14):
        page.keyboard.press("Tab")
        walked.append(page.evaluate("() => document.activeElement.closest('section, header')?.className"))
    order = list(dict.fromkeys(walked))
    assert order[:4] == ["head", "map", "time", "models"]
    assert page.evaluate("() => getComputedStyle(document.activeElement).outlineStyle") == "solid"


def test_the_widget_asks_by_messages_in_the_browser(browser, session):
    """What a notebook does with the widget's module: render it, and carry its messages to Python and back."""
    context = browser.new_context()
    page = context.new_page()
    page.expose_function("carried", lambda content: answered(session, content))
    page.evaluate(
        """async (source) => {
          const widget = (await import(URL.createObjectURL(new Blob([source], { type: "text/javascript" })))).default;
          let use;
          const model = { on: (_, f) => { use = f; }, send: (content) => window.carried(content).then((a) => use(a)) };
          await widget.render({ model, el: document.body });
        }""",
        component() + RENDER,
    )
    sync_api.expect(page.locator("tbody td").first).not_to_have_text("")
    before = scores(page)
    page.locator(".map canvas").first.press("ArrowUp")
    sync_api.expect(page.locator("tbody td").first).not_to_have_text(before[0])
    context.close()


def test_a_timeline_without_a_curve_says_why(opened, serve, grid, log):
    page = opened(place=serve(Session(log, grid, typical_sets(grid, log.finder))))
    sync_api.expect(page.locator(".worst")).to_contain_text("no scan was judged. That takes reference poses")
    assert not page.locator("canvas.line").is_visible()
    page.get_by_label("Beside it").select_option(label="typical likelihood field")
    sync_api.expect(page.locator("canvas.line")).to_be_visible()


def test_an_error_stays_while_other_answers_come(browser, serve, grid, log):
    still = SensorLog(log.finder, log.stamps, log.ranges, log.poses, np.full_like(log.poses, np.nan))
    context = browser.new_context()
    page = context.new_page()
    page.goto(serve(Session(still, grid, typical_sets(grid, log.finder))))
    page.get_by_role("button", name="Run filter").click()
    trouble = page.locator(".trouble")
    sync_api.expect(trouble).to_contain_text("no odometry")
    page.locator(".map canvas").first.press("ArrowUp")
    sync_api.expect(page.locator("tbody td:nth-child(3)").first).not_to_have_text("0.0")
    assert "no odometry" in trouble.text_content()
    sync_api.expect(page.get_by_role("button", name="Run filter")).to_be_enabled()
    context.close()


def test_a_button_works_from_the_moment_that_it_is_shown(browser, address):
    """The page clicks it itself, as soon as it is there: no pointer is as fast."""
    context = browser.new_context()
    page = context.new_page()
    page.add_init_script(
        """new MutationObserver((_, observer) => {
          const heat = [...document.querySelectorAll("button")].find((one) => one.textContent === "Heat map");
          if (heat) { observer.disconnect(); heat.click(); }
        }).observe(document, { childList: true, subtree: true });"""
    )
    page.goto(address)
    sync_api.expect(page.get_by_role("button", name="Heat map")).to_have_attribute("aria-pressed", "false")
    context.close()


def test_without_the_token_it_says_what_to_do(browser, address):
    context = browser.new_context()
    page = context.new_page()
    page.goto(address.split("?")[0])
    assert "open the address" in page.locator("body").text_content()
    context.close()
