"""Bags of a few messages: ROS 1, SQLite and MCAP; with scans, maps, rangers, a camera and its markers."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from backports import zstd
from PIL import Image

from tests.fuzz.case import Case, one_file
from tests.fuzz.mutate.mcap import mcap_bytes, mcap_records
from tests.io.mini_bag import MiniBag, quaternion
from tests.io.test_fiducial_detections import SQUARE, CameraBag

SUFFIX = {"ros1": ".bag", "sqlite3": ".db3", "mcap": ".mcap"}


def scan_bags(storage: str) -> list[Case]:
    """Scans with frames and reference poses; with odometry and a topic of poses; a drone's four rangers."""
    return [one_file(f"b{SUFFIX[storage]}", content) for made in (_with_frames, _with_poses, _with_rangers)
            for content in _contents(made(storage))]  # fmt: skip


def map_bags(storage: str) -> list[Case]:
    bag = MiniBag(storage).grid(1.0, 3, 2, [0, 100, -1, 50, 0, 100], q=quaternion(yaw=0.3))
    return [one_file(f"m{SUFFIX[storage]}", content) for content in _contents(bag)]


def camera_bags(storage: str) -> list[Case]:
    """A calibration, pictures (PNG and JPEG) and markers, as corners or as poses."""
    grey = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(6, 8))
    bag = CameraBag(storage).camera(1.0)
    for kind in ("PNG", "JPEG"):
        stream = io.BytesIO()
        grey.save(stream, kind)
        bag.image(1.2, stream.getvalue())
    corners = CameraBag(storage).corners(1.5, (7, SQUARE), (9, tuple(2 * v for v in SQUARE))).corners(2.5)
    poses = CameraBag(storage).poses(1.5, (7, (0.1, 0.2, 1.5), (0.0, 0.0, 0.0, 1.0)))
    return [one_file(f"c{SUFFIX[storage]}", content) for one in (bag, corners, poses) for content in _contents(one)]


def folder_bags() -> list[Case]:
    """ROS 2 folders with their metadata.yaml, plain and compressed; the bag inside stays as it is."""
    cases = []
    for storage in ("sqlite3", "mcap"):
        folder = _written(MiniBag(storage).scan(1.0).scan(2.0).tf("base_link", "laser", 1.0, static=True))
        name = next(name for name in folder if name != "metadata.yaml")
        cases.append(Case(folder, ".", frozenset([name])))
        if storage == "sqlite3":
            metadata = folder["metadata.yaml"].replace(b"compression_format: ''", b"compression_format: zstd")
            metadata = metadata.replace(b"compression_mode: ''", b"compression_mode: FILE")
            assert b"FILE" in metadata
            packed = metadata.replace(name.encode(), name.encode() + b".zstd")
            cases.append(Case({"metadata.yaml": packed, f"{name}.zstd": zstd.compress(folder[name])}, "."))
    return cases


def _with_frames(storage: str) -> MiniBag:
    bag = MiniBag(storage).tf("base_link", "laser", 1.0, (0.2, 0.0, 0.3), static=True)
    for i in range(3):
        bag.tf("map", "odom", 1.0 + i, (0.1, 0.0, 0.0)).tf("odom", "base_link", 1.0 + i, (0.1 * i, 0.0, 0.0))
        bag.scan(1.0 + i, (1.0, 2.0, np.inf, 0.05, 9.0))
    return bag


def _with_poses(storage: str) -> MiniBag:
    bag = MiniBag(storage).tf("base_link", "laser", 1.0, static=True)
    for i in range(3):
        bag.odometry(1.0 + i, (0.1 * i, 0.0), 0.1).pose(
            1.0 + i, (0.1 * i, 1.0), 0.2, topic="/ground_truth", covariance=i > 3
        )
        bag.scan(1.0 + i, (1.0, 2.0, 3.0)).scan(1.5 + i, (1.0, 2.0), topic="/rear", frame="laser")
    return bag


def _with_rangers(storage: str) -> MiniBag:
    bag = MiniBag(storage)
    for i in range(3):
        bag.raw(1.0 + i, [1.0 + i, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0], "/cf/state_xyzv")
        bag.raw(1.05 + i, [0.5, 1.0, 1.5, 4.5, 2.4, *quaternion(yaw=0.1)], "/cf/state_ranger_qxyzw")
    return bag


def _contents(bag: MiniBag) -> list[bytes]:
    """Return the bag's file; in MCAP also without the summary that a killed recorder leaves out."""
    files = _written(bag)
    content = next(files[name] for name in files if name != "metadata.yaml")
    if bag.storage != "mcap":
        return [content]
    records = [(op, bytes(20) if op == 2 else data) for op, data in mcap_records(content[8:-8])]
    return [content, mcap_bytes(records, offsets=False)]


def _written(bag: MiniBag) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        path = bag.write(Path(folder))
        files = [path] if path.is_file() else sorted(path.iterdir())
        return {file.name: file.read_bytes() for file in files}


def of(make: Callable[[str], list[Case]], storage: str) -> Callable[[], list[Case]]:
    """Return what makes the bags of one storage."""
    return lambda: make(storage)
