"""Text logs of scans, and trajectories."""

from __future__ import annotations

import gzip

import numpy as np

from tests.fuzz.case import Case, one_file


def carmen_logs() -> list[Case]:
    """CARMEN with each of its messages, a ring of sonars, lost stamps, and a compressed one."""
    two_poses = [f"FLASER 4 1.5 2 {i} 81.91 {i} 0.5 0.1 {0.9 * i} 0.4 0.1 {i} host {i}" for i in range(4)]
    odometry = [f"ODOM {i} 0 0.1 0.2 0 0 {i}.5 host {i}.5" for i in range(4)]
    robot = [
        f"ROBOTLASER1 0 -1.5 3.0 1.0 20 0.01 0 4 1 2 3 20 2 7 8 {i}.2 0 0 {i} 0 0 0 0 0 0 0 {i} host {i}"
        for i in range(4)
    ]
    raw = [f"RAWLASER1 0 -1.5 3.0 1.0 20 0.01 0 4 1 2 3 4 0 {i} host {i}" for i in range(4)]
    truth = [f"TRUEPOS {i} 0 0.1 {i} 0 0 {i} host {i}" for i in range(4)]
    declared = ["PARAM robot_frontlaser_offset 0.3", "PARAM robot_front_laser_max 20.0",
                "PARAM laser_front_laser_start_angle -1.0", "PARAM laser_front_laser_resolution 30"]  # fmt: skip
    ring = ["PARAM beamfield_ring_radius 0.25", "PARAM beamfield_opening_angle 0.3"]
    wide = [
        f"FLASER 181 {' '.join(str(1 + (i + j) % 7) for j in range(181))} {i} 0 0 {i} 0 0 {i} h {i}" for i in range(3)
    ]
    lost = [line.rsplit(" ", 3)[0] + " 0 h 0" for line in two_poses]
    groups = (two_poses, two_poses + odometry, robot, [*raw, *odometry], [*raw, *truth], [*declared, *two_poses],
              [*declared, *ring, *two_poses], wide, lost,
              [line.replace("FLASER", "RLASER") for line in two_poses])  # fmt: skip
    texts = ["# a log\n" + "\n".join(lines) + "\n" for lines in groups]
    return [*(one_file("c.log", text) for text in texts), one_file("c.log.gz", _packed(texts[0]))]


def wean_logs() -> list[Case]:
    ranges = " ".join(str(100 + j) for j in range(180))
    lines = [f"L {100 + i} 50 0 {125 + i} 50 0 {ranges} {i}.5\nO {100 + i} 50 0 {i}.6" for i in range(3)]
    text = "\n".join(lines) + "\n"
    return [one_file("w.log", text), one_file("w.log.gz", _packed(text))]


def gfs_logs() -> list[Case]:
    def reading(i: int) -> str:
        return f"LASER_READING 180 {' '.join(str(1 + (i + j) % 9) for j in range(180))} {i} 0.5 0.1 {100 + i}"

    lines = ["PARAM maxrange 80", "ODO_UPDATE 2 0 0 0 0 0 0 0 0", "ODOM 0 0.5 0.1 99"]
    for i in range(3):
        lines += [reading(i), f"SM_UPDATE 2 {i} 0 0.1 -{5 + i} 1{i} 0 0 -{9 - i}", "RESAMPLE 2 1 0", "NEFF 1.5"]
    return [one_file("g.gfs", "\n".join(lines) + "\n"), one_file("g.gfs", "\n".join(map(reading, range(3))))]


def g2o_logs() -> list[Case]:
    lines = []
    for i in range(3):
        lines.append(f"VERTEX_SE2 {i} {2 * i} 1 0.5")
        lines.append(f"ROBOTLASER1 0 -1.0 2.0 1.0 50 0.1 0 3 {i} 2 4 0 {i}.1 0 0 {i} 0 0 0 0 0 0 0 {10 + i} h {i}")
    return [one_file("g.g2o", "\n".join([*lines, "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1"]) + "\n")]


def coreslam_logs() -> list[Case]:
    def line(i: int, more: str = "") -> str:
        ranges = " ".join(str((37 * j + i) % 4000) for j in range(682))
        return f"{1_000_000 * i} 0 {10 * i} {12 * i} {'0 ' * 20}{ranges}{more}"

    return [one_file("c.dat", "\n".join(map(line, range(3)))), one_file("c.dat", line(1, " 7") + "\n")]


def sonar_logs() -> list[Case]:
    """Two files in a folder."""
    sonar = "".join(f"{100 * i} 1000 1200 1500 {2000 + i} 2100 1500 1200 2550\n" for i in range(4))
    poses = "".join(f"{100 * i} {50 * i} 10 {90 * i}\n" for i in range(4))
    return [Case({"measurement.txt": sonar.encode(), "poses.txt": poses.encode()}, ".")]


def trajectories() -> list[Case]:
    """TUM, CSV with a heading, a quaternion, an index, and a log."""
    tum = "# timestamp tx ty tz qx qy qz qw\n" + "".join(f"{i}.5 {i} 0.5 0 0 0 0.0 1.0\n" for i in range(4))
    rows = "".join(f"{i}.5,{i},0.5,0.1\n" for i in range(4))
    indexed = "".join(f"{2 * i},{i}.5,{i},0.5,0.1,1\n" for i in range(4))
    turned = "".join(f"{i}.5,{i},0.5,0,0,{np.sin(0.1)},{np.cos(0.1)}\n" for i in range(4))
    texts = (tum, "t,x,y,theta\n" + rows, "# time, map_x, map_y, map_theta\n" + rows,
             "stamp;x;y;yaw\n" + rows.replace(",", ";"),
             "scan_index,stamp,x,y,theta,good\n" + indexed, "timestamp,tx,ty,qx,qy,qz,qw\n" + turned)  # fmt: skip
    suffixes = ("tum", "csv", "csv", "csv", "csv", "csv")
    cases = [one_file(f"t.{suffix}", text) for suffix, text in zip(suffixes, texts, strict=True)]
    return [*cases, one_file("t.tum", _packed(tum)), carmen_logs()[0]]


def filter_runs() -> list[Case]:
    """A folder with a trajectory and particles, one without them, and a trajectory alone."""
    tum = "".join(f"{i}.5 {i} 0.5 0 0 0 0.0 1.0\n" for i in range(4)).encode()
    particles = _packed("t,x,y,theta\n" + "".join(f"{i // 2}.5,{i},0.5,0.1\n" for i in range(6)))
    return [Case({"trajectory.tum": tum, "particles.csv.gz": particles}, "."), Case({"trajectory.tum": tum}, "."),
            one_file("t.tum", tum)]  # fmt: skip


def _packed(text: str) -> bytes:
    return gzip.compress(text.encode(), 1, mtime=0)
