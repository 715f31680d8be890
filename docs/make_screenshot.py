"""Take the picture of the explorer on a simulated drive: ``python docs/make_screenshot.py``. Needs Chromium."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import numpy as np
import uvicorn
from playwright.sync_api import sync_playwright

import beamfield as bf
from beamfield.explorer.open_session import open_session
from beamfield.explorer.server import explorer_app, listening_socket, new_token, page_address

PICTURE = Path(__file__).parent / "images" / "explorer.png"
TRUTH = bf.BeamParameters(z_hit=0.85, z_short=0.08, z_max=0.03, z_rand=0.04, sigma_hit=0.05, lambda_short=0.5)


def main() -> None:
    """Two models beside each other, with the density of a reading."""
    grid = bf.draw_floor_plan(seed=1)
    laser = bf.RangeFinder.from_bearings(np.linspace(-2.36, 2.36, 181), max_range=12.0)
    log = bf.simulate_log(grid, laser, TRUTH, duration=60.0, seed=1).only_sensor()
    session, _ = open_session(log, grid)
    token = new_token()
    with listening_socket(0) as listening, sync_playwright() as playwright:
        port = listening.getsockname()[1]
        server = uvicorn.Server(
            uvicorn.Config(explorer_app(session, token, port), log_level="warning", lifespan="off", ws="none")
        )
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
        thread.start()
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1240, "height": 800})
        page.goto(f"{page_address(port, token)}#i=120&set=0&other=1")
        page.locator(".worst button").first.wait_for()
        canvas = page.locator(".map canvas").first
        for _ in range(60):
            canvas.press("n")
        page.wait_for_timeout(10_000)
        page.screenshot(path=PICTURE)
        browser.close()
        server.should_exit = True
        thread.join()


if __name__ == "__main__":
    main()
