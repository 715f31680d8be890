"""Find a robot by the walls in its scan: extract lines, and weigh poses by a map of walls.

Run: python examples/lines_as_landmarks.py
"""

from __future__ import annotations

import numpy as np

import beamfield as bf

SIGMA = 0.02
N_PARTICLES = 50_000


def main() -> None:
    """Take a scan of a room, and find the pose from its walls alone."""
    rng = np.random.default_rng(0)
    walls = bf.LineMap.from_segments(
        [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 4, 4], [4, 4, 4, 5], [4, 5, 0, 5], [0, 5, 0, 0]]
    )
    finder = bf.RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 360, endpoint=False), 12.0)
    truth = np.array([1.7, 1.4, 0.6])
    ranges = distances(walls, truth, finder) + rng.normal(0.0, SIGMA, finder.n_beams)

    lines = bf.find_lines(bf.Scan(ranges, finder), bf.RangeNoise(SIGMA))
    for line in lines:
        print(f"wall at rho {line.rho:.3f} m, alpha {line.alpha:+.3f} rad, {line.length:.2f} m of it seen")
    seen = bf.LineDetections.from_lines(lines)

    # Nothing is known of the pose. A little noise for errors of the map, and lines that are none of it.
    noise = bf.LineParameters(sigma_rho=0.01, sigma_alpha=0.005, spurious_rate=0.05, max_range=12.0)
    model = bf.LineModel(walls, noise, correspondence="nearest", min_overlap=0.5)
    poses = rng.uniform([0, 0, -np.pi], [6, 5, np.pi], (N_PARTICLES, 3))
    for spread in (0.3, 0.1, 0.03):
        best = poses[np.argsort(-model.log_likelihood(seen, poses))[:500]]
        poses = np.repeat(best, 40, axis=0) + rng.normal(0.0, spread, (20_000, 3)) * [0.3, 0.3, 0.15]
    values = model.log_likelihood(seen, poses)
    weights = np.exp(values - values.max())
    x, y, theta = weights @ poses / weights.sum()
    print(f"by its walls: x {x:.3f} m  y {y:.3f} m  theta {theta:+.3f} rad")
    print(f"truth:        x {truth[0]:.3f} m  y {truth[1]:.3f} m  theta {truth[2]:+.3f} rad")
    print(f"the walls are those with id {', '.join(map(str, model.correspondences(seen, [x, y, theta])))}")


def distances(walls: bf.LineMap, pose: np.ndarray, finder: bf.RangeFinder) -> np.ndarray:
    """Return where each beam meets the first wall, metres."""
    angles = pose[2] + finder.bearings
    beams = np.column_stack([np.cos(angles), np.sin(angles)])[:, None]
    start, along = walls.segments[:, :2], walls.segments[:, 2:] - walls.segments[:, :2]
    away = start - pose[:2]
    cross = beams[..., 0] * along[:, 1] - beams[..., 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (away[:, 0] * along[:, 1] - away[:, 1] * along[:, 0]) / cross
        place = (away[:, 0] * beams[..., 1] - away[:, 1] * beams[..., 0]) / cross
    return np.where((distance > 0.0) & (place >= 0.0) & (place <= 1.0), distance, np.inf).min(axis=1)


if __name__ == "__main__":
    main()
