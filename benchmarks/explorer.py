"""How long the explorer's answers take: ``python benchmarks/explorer.py``.

Processor time of one thread, the median of several calls, on a simulated office and, where the shared data lie beside
the checkout, on Wean Hall. Poses differ from call to call, as while the robot is dragged. Where Playwright and Chromium
are installed, the robot is dragged in the page, too: wall time from a movement of the pointer to the new scores, while
heat maps are computed.
"""

from __future__ import annotations

import importlib.util
import shutil
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn

import beamfield as bf
from beamfield.explorer.parameter_set import typical_sets
from beamfield.explorer.server import explorer_app, listening_socket, new_token, page_address
from beamfield.explorer.session import Session
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.kernels.threads import set_threads

ROUNDS = 7
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
WEAN = Path(__file__).parents[2] / "shared" / "data" / "wean_hall"


def office() -> Session:
    grid = bf.draw_floor_plan(seed=1)
    laser = bf.RangeFinder.from_bearings(np.linspace(-2.36, 2.36, 181), max_range=12.0)
    truth = bf.BeamParameters(z_hit=0.85, z_short=0.08, z_max=0.03, z_rand=0.04, sigma_hit=0.05, lambda_short=0.5)
    log = bf.simulate_log(grid, laser, truth, duration=30.0, seed=1).only_sensor()
    return Session(log, grid, typical_sets(grid, laser))


def wean() -> Session:
    grid = bf.read_map(WEAN / "derived_wean.yaml")
    poses = read_trajectory(WEAN / "reference_robotdata1.csv.gz")
    log = attach_poses(bf.read_log(WEAN / "robotdata1.log.gz"), poses).only_sensor()
    return Session(log, grid, typical_sets(grid, log.finder))


def measure(name: str, session: Session) -> None:
    """Print a table's rows for one log."""
    i = int(np.flatnonzero(np.isfinite(session.log.poses).all(axis=1))[len(session.log) // 2])
    rng = np.random.default_rng(0)

    def milliseconds(message: dict[str, Any], rounds: int = ROUNDS) -> float:
        times = []
        for _ in range(rounds + 1):  # the first one compiles, and makes tables
            pose = (session.log.poses[i] + 0.02 * rng.standard_normal(3)).tolist()
            start = time.thread_time()
            session.answer({"i": i, "pose": pose, **message})
            times.append(1e3 * (time.thread_time() - start))
        return float(np.median(times[1:]))

    print(f"\n{name}: {session.log.finder.n_beams} beams, map {session.grid.shape[0]} x {session.grid.shape[1]}\n")
    print(f"scores of {len(session.sets)} models, causes and expected ranges while the robot is dragged: "
          f"{milliseconds({'name': 'scan', 'set': 0, 'shown': [0, 1]}):.1f} ms\n")  # fmt: skip
    print("| model | heat map, dragged | at rest | building | which explains a scan better |")
    print("|---|---|---|---|---|")
    for number, one in enumerate(session.sets):
        heat = {"name": "heat", "set": number, "width_m": 4.0}
        cells = (
            milliseconds({**heat, "dragged": True}),
            milliseconds({**heat, "dragged": False}),
            milliseconds({"name": "building", "set": number}, rounds=1),
            milliseconds({"name": "scores", "sets": [number], "scans": [i]}),
        )
        print(f"| {one.label} | {' | '.join(f'{cell:.1f} ms' for cell in cells)} |")


# Notes when the pointer moved, and when the first score was written next.
WATCH = """() => {
  window.waits = [];
  let moved = null;
  document.addEventListener("pointermove", () => { moved ??= performance.now(); }, true);
  new MutationObserver(() => { if (moved !== null) window.waits.push(performance.now() - moved); moved = null; })
    .observe(document.querySelector("tbody td"), { childList: true, characterData: true, subtree: true });
}"""


def drag(name: str, session: Session, *, heat: bool) -> None:
    """Print how long scores take to follow the pointer."""
    from playwright.sync_api import sync_playwright

    token = new_token()
    with listening_socket(0) as listening, sync_playwright() as playwright:
        port = listening.getsockname()[1]
        app = explorer_app(session, token, port)
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning", lifespan="off", ws="none"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
        thread.start()
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1300, "height": 850})
        page.goto(page_address(port, token))
        page.wait_for_timeout(4000)
        if not heat:
            page.get_by_role("button", name="Heat map").click()
        canvas = page.locator(".map canvas").first
        box = canvas.bounding_box() or {"x": 0.0, "y": 0.0}
        x, y = map(float, (canvas.get_attribute("data-robot") or "0 0").split())
        page.evaluate(WATCH)
        page.mouse.move(box["x"] + x, box["y"] + y)
        page.mouse.down()
        for k in range(120):
            page.mouse.move(box["x"] + x + k % 40, box["y"] + y + k % 30)
            page.wait_for_timeout(30)
        waits = np.array(page.evaluate("window.waits"))
        browser.close()
        server.should_exit = True
        thread.join(timeout=20)
    after, within = np.median(waits), np.percentile(waits, 95)
    print(f"{name}, dragged in the page {'with' if heat else 'without'} heat maps: scores after {after:.0f} ms, "
          f"95% within {within:.0f} ms ({len(waits)} movements)")  # fmt: skip


def main() -> int:
    set_threads(1)
    sessions = {"Office, simulated": office()}
    if WEAN.is_dir():
        sessions["Wean Hall"] = wean()
    for name, session in sessions.items():
        measure(name, session)
    if CHROMIUM is not None and importlib.util.find_spec("playwright") is not None:
        print()
        for name, session in sessions.items():
            drag(name, session, heat=False)
            drag(name, session, heat=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
