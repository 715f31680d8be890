"""How much of a scan its features keep (6.6.5): ``python benchmarks/feature_information.py``.

Rooms: simulated scans whose beams are independent, so that the beam model with exponent 1 is the truth; the prior is
uniform over a box around the true pose. Over whole maps, see `feature_study`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from beamfield.detections import Detections
from beamfield.features.corners import find_corners
from beamfield.features.feature import stack_features
from beamfield.features.lines import find_lines
from beamfield.features.sweep import RangeNoise
from beamfield.localization.information import FeatureInformation, information_of_features
from beamfield.localization.pose_posterior import PoseLattice
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.sensors import RangeFinder

if __package__:
    from benchmarks.rooms import drawn_room
    from benchmarks.tables import print_table
else:
    from rooms import drawn_room
    from tables import print_table

SIGMA = 0.05
FINDER = RangeFinder.from_bearings(np.radians(np.arange(-180.0, 180.0, 3.0)), 8.0)
BEAMS = BeamParameters(z_hit=0.97, z_short=0.0, z_max=0.01, z_rand=0.02, sigma_hit=SIGMA, lambda_short=1.0)
BOX = {"reach": 0.2, "resolution": 0.01, "heading_reach": 0.06, "heading_step": 0.004}
SOUTH = [(0, 0), (2, 0), (2, 0.3), (2.3, 0.3), (2.3, 0), (4, 0), (4, 0.3), (4.3, 0.3), (4.3, 0), (6, 0)]
PILASTERS = [*SOUTH, *((6 - x, 4 - y) for x, y in SOUTH)]
ROOMS = {
    "rectangle": ([(0, 0), (6, 0), (6, 4), (0, 4)], [0.8, 0.8], [5.2, 3.2]),
    "with a niche": ([(0, 0), (6, 0), (6, 4), (4, 4), (4, 5), (3, 5), (3, 4), (0, 4)], [0.8, 0.8], [5.2, 3.2]),
    "with pilasters": (PILASTERS, [0.8, 0.8], [5.2, 3.2]),
    "corridor, ends out of reach": ([(0, 0), (30, 0), (30, 2), (0, 2)], [13.0, 0.6], [17.0, 1.4]),
}
POSES_PER_ROOM = 20


def room_rows(name: str) -> Iterator[dict[str, Any]]:
    """Return what lines and what corners keep of scans of a room."""
    outline, low, high = ROOMS[name]
    rng = np.random.default_rng(5)
    grid, walls, corners = drawn_room(outline)
    model = BeamModel(grid, BEAMS)
    of_lines = LineModel(walls, LineParameters(0.0, 0.0, 0.01, 8.0), correspondence="sum", min_overlap=0.3)
    noise = LandmarkParameters(0.03, 0.01, sigma_signature=0.1, spurious_rate=0.02, max_range=8.0)
    of_corners = LandmarkModel(corners, noise, correspondence="sum")
    results: dict[str, list[tuple[int, FeatureInformation]]] = {"lines": [], "corners": []}
    for _ in range(POSES_PER_ROOM):
        pose = np.array([*rng.uniform(low, high), rng.uniform(-np.pi, np.pi)])
        [scan] = model.sample(pose[None], FINDER, rng)
        lattice = PoseLattice.around(pose, **BOX)
        lines = find_lines(scan, RangeNoise(SIGMA))
        measured, _ = stack_features(find_corners(lines))
        for kind, count, of_kind, seen in (
            ("lines", len(lines), of_lines, LineDetections.from_lines(lines)),
            ("corners", len(measured), of_corners, Detections(*measured.T)),
        ):
            results[kind].append((count, information_of_features(model, scan, of_kind, seen, lattice)))
    for kind, found in results.items():
        lost = np.array([both.lost for _, both in found])
        yield {
            "room": name,
            "features": f"{np.mean([count for count, _ in found]):.1f} {kind}",
            "scan tells (nats)": f"{np.mean([both.scan.information for _, both in found]):.2f}",
            "features tell": f"{np.mean([both.features.information for _, both in found]):.2f}",
            "lost": f"{lost.mean():.2f} +- {lost.std() / np.sqrt(len(lost)):.2f}",
            "divergence": f"{np.mean([both.divergence for _, both in found]):.2f}",
        }


def main() -> None:
    """Print the table as Markdown."""
    print_table([row for name in ROOMS for row in room_rows(name)])


if __name__ == "__main__":
    main()
