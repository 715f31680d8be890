"""Files as the programs ship them pass: there is advice, but nothing that goes wrong."""

from __future__ import annotations

import re
from dataclasses import asdict

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.io.logs.carmen import write_carmen
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, ScanLog, SensorLog
from beamfield.stacks.files.new_file import new_file_text
from beamfield.stacks.registry import STACKS, parameter_class

# Parameters of the rest of the node, as in default files; the doctor has nothing to say about them.
NAV2_REST = """\
    alpha1: 0.2
    alpha5: 0.2
    base_frame_id: "base_footprint"
    global_frame_id: "map"
    max_particles: 2000
    min_particles: 500
    odom_frame_id: "odom"
    pf_err: 0.05
    pf_z: 0.99
    recovery_alpha_fast: 0.0
    resample_interval: 1
    robot_model_type: "nav2_amcl::DifferentialMotionModel"
    save_pose_rate: 0.5
    tf_broadcast: true
    transform_tolerance: 1.0
    update_min_a: 0.2
    scan_topic: scan
"""
STOCK = [(stack, model) for stack, described in STACKS.items() for model in described.models]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A map of 5 cm with unmapped space behind a door, and 40 scans of 360 beams up to 12 m, 1% NaN and no returns."""
    folder = tmp_path_factory.mktemp("world")
    cells = np.full((160, 220), -1)
    cells[10:150, 10:210] = 0
    cells[[10, 149], 10:210] = cells[10:150, [10, 209]] = 100  # type: ignore[assignment]
    cells[60:100, 100] = 100
    cells[70:80, 209] = 0
    grid = OccupancyGrid.from_ros(cells, resolution=0.05)
    write_map(grid, folder / "map.yaml")
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 360, endpoint=False), 12.0, min_range=0.1)
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.uniform(1.5, 4.0, 40), rng.uniform(1.5, 6.0, 40), rng.uniform(-3.0, 3.0, 40)])
    ranges = RayCaster(grid).expected_ranges(poses, finder) + rng.normal(0.0, 0.02, (40, 360))
    ranges[rng.random(ranges.shape) < 0.01] = np.inf
    ranges = np.where(ranges < 12.0, ranges, np.inf)
    log = SensorLog(finder, np.arange(40.0), ranges, poses, poses)
    write_carmen(folder / "run.log", ScanLog({"FLASER": log}))
    return folder


def stock_file(folder, stack, model):
    kind = parameter_class(stack, model)
    chosen = {"laser_model_type": model} if "laser_model_type" in kind.__dataclass_fields__ else {}
    text = new_file_text(stack, asdict(kind(**chosen))) + (NAV2_REST if stack in ("nav2", "beluga") else "")
    path = folder / ("stock.ini" if stack == "mrpt" else "stock.yaml")
    path.write_text(text)
    return path


@pytest.mark.parametrize(("stack", "model"), STOCK)
def test_stock_files_pass_alone_and_with_a_map_and_a_log(tmp_path, world, capsys, stack, model):
    path = stock_file(tmp_path, stack, model)
    for more in ((), ("--map", str(world / "map.yaml"), "--log", str(world / "run.log"), "--max-range", "12")):
        code = main(["doctor", str(path), "--stack", stack, *more])
        out = capsys.readouterr().out
        found = re.findall("^(?:error|warning): (\\S+)", out, re.MULTILINE)
        # By default ROS 1 draws poses at random, which goes wrong with its product alone.
        assert found == (["recovery-in-product"] if (stack, model) == ("ros1", "likelihood_field_prob") else []), out
        assert code == len(found)


def test_a_map_that_beamfield_saved_loses_no_cells(tmp_path, world, capsys):
    """Its unknown grey lies midway between the thresholds."""
    main(["doctor", str(stock_file(tmp_path, "nav2", "likelihood_field")), "--map", str(world / "map.yaml")])
    assert "thresholds-lose-cells" not in capsys.readouterr().out
    assert b"\x8c" in (world / "map.pgm").read_bytes()
