"""Learn the noise of real landmark sensors, print what was found: ``python benchmarks/landmark_learning.py [FOLDER]``.

FOLDER holds the logs (default: ../shared/data beside the checkout). They are other people's data and not part of this
repository.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.detection_log import DetectionLog
from beamfield.landmark_noise.learning import LandmarkLearningResult, learn_landmark_parameters
from beamfield.maps.landmarks import LandmarkMap
from landmark_sets import read_mrclam, read_plaza, read_roh
from tables import print_table

Reader = Callable[[Path], tuple[LandmarkMap, DetectionLog]]
MRCLAM: dict[str, Any] = {"max_range": 10.0}
SETS: tuple[tuple[str, str, Reader, dict[str, Any]], ...] = (
    *((f"MRCLAM {i}, camera", f"mrclam_instant/mrclam{i}.mat", read_mrclam, MRCLAM) for i in (1, 2, 3, 4, 5, 6, 9)),
    ("Roh, infrared", "roh_bearing", read_roh, {}),
    ("Plaza 1, UWB, bias alone", "plaza_range_only/Plaza1_.mat", read_plaza, {"fit_scale": False}),
    ("Plaza 1, UWB", "plaza_range_only/Plaza1_.mat", read_plaza, {}),
    ("Plaza 2, UWB, bias alone", "plaza_range_only/Plaza2_.mat", read_plaza, {"fit_scale": False}),
    ("Plaza 2, UWB", "plaza_range_only/Plaza2_.mat", read_plaza, {}),
)
PARAMETERS = (
    ("sigma_range", "sigma_r (m)", 1.0),
    ("range_bias", "range bias (m)", 1.0),
    ("range_scale", "range scale", 1.0),
    ("sigma_bearing", "sigma_phi (deg)", float(np.degrees(1.0))),
    ("bearing_bias", "bearing bias (deg)", float(np.degrees(1.0))),
    ("spurious_rate", "spurious (%)", 100.0),
)


def run(folder: Path) -> list[dict[str, Any]]:
    """Return one row per set: parameters with 95% intervals, seconds, findings."""
    return [row(name, *read(folder / path), options) for name, path, read, options in SETS]


def row(name: str, landmarks: LandmarkMap, log: DetectionLog, options: dict[str, Any]) -> dict[str, Any]:
    start = time.perf_counter()
    result = learn_landmark_parameters(landmarks, log, **options)
    seconds = time.perf_counter() - start
    return {
        "set": name,
        "sightings": result.n_sightings,
        "blocks": result.n_blocks,
        **{heading: cell(result, parameter, factor) for parameter, heading, factor in PARAMETERS},
        "s": round(seconds, 1),
        "findings": ", ".join(finding.name for finding in result.findings),
    }


def cell(result: LandmarkLearningResult, parameter: str, factor: float) -> str:
    if parameter not in result.intervals:
        return ""
    value, (low, high) = getattr(result.parameters, parameter), result.intervals[parameter]
    digits = max(0, 1 - int(np.floor(np.log10(max(factor * (high - low) / 2.0, 1e-12)))))
    return f"{factor * value:.{digits}f} [{factor * low:.{digits}f}, {factor * high:.{digits}f}]"


def main(folder: Path) -> None:
    """Print the rows as a Markdown table, and the findings below."""
    rows = run(folder)
    shown = [name for name in rows[0] if name != "findings"]
    print_table(rows, columns=shown)
    print()
    for values in rows:
        print(f"- {values['set']}: {values['findings']}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[2] / "shared" / "data")
