"""Align two scans of a log, and draw the likelihood field of the first with the second on it (Figure 6.11).

Run: python examples/align_two_scans.py [LOG FIRST SECOND [PICTURE.png]]

Without a log, two scans of a simulated drive are aligned.
"""

from __future__ import annotations

import sys

import matplotlib as mpl
import numpy as np

import beamfield as bf
from beamfield.maps.end_points import hit_points

mpl.use("Agg")
import matplotlib.pyplot as plt


def simulated_drive() -> bf.SensorLog:
    """Return a short drive through an office, with odometry that slips."""
    laser = bf.RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.0)), max_range=20.0)
    noise = bf.BeamParameters(z_hit=0.97, z_short=0.01, z_max=0.01, z_rand=0.01, sigma_hit=0.02, lambda_short=0.5)
    return bf.simulate_log(bf.draw_floor_plan(seed=1), laser, noise, duration=30.0, scan_rate=2.0, seed=3).only_sensor()


def main(path: str | None = None, first: int = 50, second: int = 52, picture: str = "alignment.png") -> None:
    """Print the result and write the picture."""
    log = simulated_drive() if path is None else next(iter(bf.read_log(path).sensors.values()))
    onto, scan = log.scan(first), log.scan(second)
    track = log.odometry if log.has_odometry else log.poses
    start = bf.geometry.between(track[first], track[second])

    field = bf.ScanField.from_scan(onto)
    result = bf.align(scan, field, start)
    deviation = np.sqrt(np.diag(result.covariance))
    print(f"start  x {start[0]:+.3f} m  y {start[1]:+.3f} m  theta {np.degrees(start[2]):+.2f} deg")
    print(f"found  x {result.pose[0]:+.3f} m  y {result.pose[1]:+.3f} m  theta {np.degrees(result.pose[2]):+.2f} deg")
    print(f"  +-     {deviation[0]:.3f} m     {deviation[1]:.3f} m         {np.degrees(deviation[2]):.2f} deg")
    print(f"overlap {result.overlap:.0%}, score {result.score:.0f} nats, problem: {result.problem or 'none'}")

    # The picture shows a wider field than the alignment uses, so that surfaces can be seen.
    shown = bf.ScanField.from_scan(onto, sigma_hit=0.1)
    left, bottom, right, top = shown.bounds
    x, y = np.arange(left - 1.0, right + 1.0, 0.04), np.arange(bottom - 1.0, top + 1.0, 0.04)
    values = shown.log_density(np.stack(np.meshgrid(x, y), axis=-1))
    figure, axes = plt.subplots(figsize=(9, 7))
    axes.imshow(
        values, origin="lower", extent=(x[0], x[-1], y[0], y[-1]), cmap="gray", vmax=1.0 - np.log(shown.max_range)
    )
    for pose, colour, name in ((start, "tab:orange", "start"), (result.pose, "tab:red", "aligned")):
        points = bf.geometry.transform_points(pose, hit_points(scan.ranges, scan.finder))
        axes.plot(points[:, 0], points[:, 1], ".", color=colour, markersize=3, label=name)
    axes.plot(0.0, 0.0, "o", color="tab:blue", label="robot")
    axes.set(xlabel="x in metres", ylabel="y in metres")
    axes.legend()
    figure.savefig(picture, dpi=110)
    print(f"picture: {picture}")


if __name__ == "__main__":
    words = sys.argv[1:]
    if len(words) in (1, 2):
        sys.exit(__doc__)
    main(*words[:1], *(int(word) for word in words[1:3]), *words[3:4])
