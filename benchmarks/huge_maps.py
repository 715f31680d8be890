"""Measure the memory that a map of 20,000 x 20,000 cells takes while it is read and used, in bytes per cell (Linux).

Run: python benchmarks/huge_maps.py [CELLS_A_SIDE]
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from beamfield.cli.main import main as command
from beamfield.io.read_map import read_map
from beamfield.maps.raycast import RayCaster
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan
from tables import print_table

PICTURES = (("L", "pgm"), ("L", "png"), ("LA", "png"), ("RGB", "png"))
STEPS = ("read", "inspect", "RayCaster", "likelihood field")


def main() -> None:
    side = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        small = write_map(Path(name), 50, "L", "pgm")
        for mode, suffix in PICTURES:
            path = write_map(Path(name), side, mode, suffix)
            for step in STEPS if suffix == "pgm" else ("read",):
                # Each in a process of its own: memory that one has freed must not serve the next.
                child = [sys.executable, __file__, "--child", step, path, small]
                out = subprocess.run(child, check=True, capture_output=True, text=True).stdout
                peak, kept = (float(word) / side**2 for word in out.split())
                picture = f"{'grey' if mode == 'L' else mode} {suffix.upper()}"
                rows.append({"step": step, "picture": picture, "peak": f"{peak:.2f}", "kept": f"{kept:.2f}"})
            path.with_suffix(f".{suffix}").unlink()
    print(f"Bytes per cell beyond what the process had before, {side} x {side} cells:\n")
    print_table(rows)


def write_map(folder: Path, side: int, mode: str, suffix: str) -> Path:
    """Write a map of rooms, 5 cm a cell, and return its YAML file."""
    grey = np.full((side, side), 254, np.uint8)
    grey[::200, :] = grey[:, ::160] = 0
    grey[100::200, 40::160] = 205
    picture = Image.fromarray(grey)
    path = folder / f"{mode}_{side}_{suffix}.yaml"
    (picture if mode == "L" else picture.convert(mode)).save(path.with_suffix(f".{suffix}"))
    path.write_text(
        f"image: {path.stem}.{suffix}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


def child(step: str, path: Path, small: Path) -> None:
    """Print by how many bytes a step raises the peak, and what it keeps."""
    run(step, small)  # what is loaded and compiled on first use is not the map's
    peak, kept = run(step, path)
    print(peak, kept)


def run(step: str, path: Path) -> tuple[int, int]:
    grid = read_map(path) if step in ("RayCaster", "likelihood field") else None
    gc.collect()
    before = memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    made: object = None
    if step == "read":
        made = read_map(path)
    elif step == "inspect":
        with Path(os.devnull).open("w") as nowhere, contextlib.redirect_stdout(nowhere):
            command(["inspect", str(path)])
    elif grid is not None and step == "RayCaster":
        made = RayCaster(grid)
    elif grid is not None:
        made = LikelihoodFieldModel(grid, LikelihoodFieldParameters(z_hit=0.9, z_rand=0.1, sigma_hit=0.1))
        made.log_likelihood(Scan([1.0], RangeFinder.from_bearings([0.0], max_range=10.0)), np.ones((100_000, 3)))
    gc.collect()
    result = memory("VmHWM") - before, memory("VmRSS") - before
    del made
    return result


def memory(line: str) -> int:
    text = Path("/proc/self/status").read_text()
    return int(text.split(line + ":")[1].split()[0]) * 1024


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2], Path(sys.argv[3]), Path(sys.argv[4]))
    else:
        main()
