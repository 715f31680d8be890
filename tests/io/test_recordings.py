"""What viewers are given, read back with their own readers."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from beamfield.errors import InvalidInputError
from beamfield.io.recordings.mcap_file import write_mcap
from beamfield.io.recordings.recording import COLOURS, Recording
from beamfield.io.recordings.rerun_file import write_rerun
from beamfield.maps.end_points import end_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, SensorLog

rerun_chunk = pytest.importorskip("rerun.chunk")
highlevel = pytest.importorskip("rosbags.highlevel")


@pytest.fixture(scope="module")
def recording():
    """Four scans of three beams; at the second nothing is known but the scan."""
    grid = OccupancyGrid([[0.0, 0.0, 1.0], [np.nan, 0.0, 1.0]], resolution=0.5, origin=(-1.0, 2.0, 0.3))
    finder = RangeFinder.from_bearings([-0.5, 0.0, 0.5], max_range=8.0)
    stamps = 100.0 + np.arange(4.0)
    poses = np.array([[0.1, 0.2, 0.0], [np.nan] * 3, [0.3, 0.1, 1.0], [0.4, 0.1, 1.5]])
    ranges = np.array([[1.0, 2.0, 8.0], [1.0, 1.0, 1.0], [np.nan, 3.0, 1.5], [2.0, 2.5, 0.5]])
    log = SensorLog(finder, stamps, ranges, odometry=poses, poses=poses)
    covariances = np.full((4, 3, 3), np.nan)
    covariances[2] = np.diag([0.04, 0.01, 0.0025])
    return Recording(
        grid,
        log,
        {"estimate": poses, "the reference": poses + np.array([0.0, 0.1, 0.0])},
        covariances,
        particles=[(2, np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 3.0]]))],
        numbers={"position error [m]": np.array([0.5, np.nan, 0.25, 0.125])},
        causes=np.array([[0, 1, 2], [-1, -1, -1], [-1, 3, 0], [0, 0, 0]], np.int8),
    )


@pytest.fixture(scope="module")
def rerun(recording, tmp_path_factory):
    """Return a function that gives the rows of a component at an entity: times and values."""
    path = tmp_path_factory.mktemp("rerun") / "drive.rrd"
    write_rerun(path, recording)
    chunks = list(rerun_chunk.RrdReader(path).store().stream())

    def rows(entity: str, component: str) -> list[tuple[float, list]]:
        found = []
        for chunk in chunks:
            batch = chunk.to_record_batch()
            if chunk.entity_path != entity or component not in batch.schema.names:
                continue
            times = batch["time"].cast("int64").to_pylist() if "time" in batch.schema.names else [0] * batch.num_rows
            found += list(zip((time / 1e9 for time in times), batch[component].to_pylist(), strict=True))
        return sorted(found, key=lambda row: row[0])

    return rows


def test_rerun_has_the_scans_where_the_first_path_puts_them(recording, rerun):
    rows = rerun("/scan", "Points3D:positions")
    assert [time for time, _ in rows] == [0.0, 1.0, 2.0, 3.0]
    for i, (_, points) in enumerate(rows):
        expected = end_points(recording.log.ranges[i], recording.log.finder, recording.log.poses[i])
        expected = expected[np.isfinite(expected).all(axis=1)]
        assert_allclose(np.reshape(points, (-1, 3))[:, :2], expected, atol=1e-6)
    assert len(rows[0][1]) == 2  # one reading is max_range
    assert rows[1][1] == []
    colours = rerun("/scan", "Points3D:colors")[2][1]
    assert [(code >> 24, code >> 16 & 255, code >> 8 & 255) for code in colours] == [COLOURS[3], COLOURS[0]]


def test_rerun_has_the_map_paths_particles_and_numbers(rerun):
    ((_, (pixels,)),) = rerun("/map", "GridMap:data")
    assert np.reshape(pixels, (2, 3)).tolist() == [[205, 254, 0], [254, 254, 0]]  # the upper row first
    assert rerun("/map", "GridMap:translation")[0][1] == [[-1.0, 2.0, 0.0]]
    ((_, (strip,)),) = rerun("/paths/the_reference", "LineStrips3D:strips")  # one pose before the gap is no line
    assert_allclose(np.array(strip)[:, :2], [[0.3, 0.2], [0.4, 0.2]], atol=1e-6)
    ((time, cloud),) = rerun("/particles", "Points3D:positions")
    assert time == 2.0
    assert_allclose(np.array(cloud)[:, :2], [[0.0, 0.0], [0.5, 0.5]])
    numbers = rerun("/numbers/position_error_m", "Scalars:scalars")
    assert numbers == [(0.0, [0.5]), (2.0, [0.25]), (3.0, [0.125])]
    ((time, (ring,)),) = rerun("/robot/region_95", "LineStrips3D:strips")
    assert time == 2.0
    off = (np.array(ring)[:, :2] - [0.3, 0.1]) / [0.2, 0.1]
    assert_allclose((off**2).sum(axis=1), 5.991, rtol=1e-3)


def test_mcap_has_standard_messages(recording, tmp_path):
    path = tmp_path / "drive.mcap"
    write_mcap(path, recording)
    messages = _read_mcap(path)
    assert {topic: (kind, len(found)) for topic, (kind, found) in messages.items()} == {
        "/map": ("nav_msgs/msg/OccupancyGrid", 1),
        "/tf_static": ("tf2_msgs/msg/TFMessage", 1),
        "/tf": ("tf2_msgs/msg/TFMessage", 3),
        "/scan": ("sensor_msgs/msg/LaserScan", 4),
        "/estimate": ("geometry_msgs/msg/PoseWithCovarianceStamped", 3),
        "/estimate/path": ("nav_msgs/msg/Path", 1),
        "/the_reference": ("geometry_msgs/msg/PoseWithCovarianceStamped", 3),
        "/the_reference/path": ("nav_msgs/msg/Path", 1),
        "/particles": ("geometry_msgs/msg/PoseArray", 1),
        "/causes": ("visualization_msgs/msg/MarkerArray", 4),
        "/position_error_m": ("std_msgs/msg/Float64", 3),
    }
    ((_, grid),) = messages["/map"][1]
    assert grid.data.tolist() == [0, 0, 100, -1, 0, 100]
    assert (grid.info.width, grid.info.height, grid.info.origin.position.y) == (3, 2, 2.0)
    stamp, pose = messages["/estimate"][1][1]
    assert stamp == 102_000_000_000
    assert_allclose(pose.pose.covariance[[0, 7, 35]], [0.04, 0.01, 0.0025])
    assert pose.pose.pose.position.x == 0.3
    assert_allclose(messages["/scan"][1][2][1].ranges, [np.nan, 3.0, 1.5])
    marker = messages["/causes"][1][2][1].markers[0]
    assert [round(colour.r * 255) for colour in marker.colors] == [COLOURS[3][0], COLOURS[0][0]]
    assert [file.name for file in tmp_path.iterdir()] == ["drive.mcap"]
    with highlevel.AnyReader([path]) as reader:
        latched = {c.topic for c in reader.connections if c.ext.offered_qos_profiles}
    assert latched == {"/map", "/tf_static", "/estimate/path", "/the_reference/path"}


def _read_mcap(path):
    """Return type and messages of each topic, with their stamps, as rosbags reads them."""
    topics = {}
    with highlevel.AnyReader([path]) as reader:
        for connection, stamp, raw in reader.messages():
            kind, found = topics.setdefault(connection.topic, (connection.msgtype, []))
            found.append((stamp, reader.deserialize(raw, kind)))
    return topics


@pytest.mark.parametrize("change", [{"paths": {}}, {"causes": np.zeros((4, 2), np.int8)}, {"numbers": {"n": [1.0]}}])
def test_what_does_not_fit_the_log_is_refused(recording, change):
    with pytest.raises(InvalidInputError, match=next(iter(change))):
        replace(recording, **change)
