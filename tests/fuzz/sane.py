"""What must hold of everything that a reader returns, however odd its file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from beamfield.detection_log import DetectionLog
from beamfield.fleet.manifest import ManifestRow
from beamfield.fleet.run_record import RunRecord, record_from_json
from beamfield.io.bags.fiducial_detections import FiducialDetections
from beamfield.io.filter_run import FilterRun
from beamfield.io.trajectory import IndexedTrack
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.lines import LineMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table import RangeTable
from beamfield.models.beam_parameters import BeamParameters, SavedBeamModel
from beamfield.models.camera_intrinsics import CameraIntrinsics
from beamfield.models.field_parameters import SavedLikelihoodField
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.sensors import ScanLog, Track, usable_ranges
from beamfield.stacks.files.parameter_file import StackFile
from beamfield.stacks.registry import STACKS


def manifest(result: Any) -> None:
    assert result
    for row in result:
        assert isinstance(row, ManifestRow)
        texts = (row.log, row.map, row.robot, row.site, row.poses, row.sensor)
        assert all(isinstance(text, str) for text in texts)
        assert all(texts[:4])
        assert (row.robot + row.site).isprintable()
        assert row.start is None or np.isfinite(row.start).all()
        assert row.resolve(row.log)


def run_record(result: Any) -> None:
    assert isinstance(result, RunRecord)
    assert result.status in ("used", "left out")
    assert record_from_json(result.to_json(), "again").to_json() == result.to_json()
    if result.is_used:
        assert result.finder.n_beams == len(result.mounts)
        assert result.map_info is not None
    for file in result.files:
        assert file.path.startswith("beams/")
        assert ".." not in file.path.split("/")


def grid(result: Any) -> None:
    assert isinstance(result, OccupancyGrid)
    assert result.probability.ndim == 2
    assert result.probability.size > 0
    known = result.probability[~np.isnan(result.probability)]
    assert ((known >= 0.0) & (known <= 1.0)).all()
    assert np.isfinite(result.origin).all()
    assert 0.0 < result.resolution < np.inf
    assert (result.occupied.astype(int) + result.free + result.unknown == 1).all()


def range_table(result: Any) -> None:
    assert isinstance(result, RangeTable)
    longest = result.plan.max_range or 3.0
    poses = [[x, y, theta] for x in (-0.1, 0.1, 0.5) for y in (0.1, 0.3) for theta in (0.0, 3.1, -2.0)]
    ranges = result.cast(poses, longest)
    assert ((ranges >= 0.0) & (ranges <= longest)).all()


def log(result: Any) -> None:
    assert isinstance(result, ScanLog)
    assert result.sensors
    for sensor in result.sensors.values():
        t, k = len(sensor.stamps), sensor.finder.n_beams
        assert t > 0
        assert k > 0
        assert sensor.ranges.shape == (t, k)
        assert np.isfinite(sensor.stamps).all()
        assert (np.diff(sensor.stamps) >= 0.0).all()
        assert np.isfinite(sensor.finder.mounts).all()
        used = usable_ranges(sensor.ranges, sensor.finder)
        assert (np.isnan(used) | ((used >= sensor.finder.min_range) & (used <= sensor.finder.max_range))).all()
        for poses in (sensor.poses, sensor.odometry):
            _rows_are_finite_or_nan(poses)
    if result.odometry is not None:
        track(result.odometry)
    assert all(isinstance(note, str) for note in result.notes)


def track(result: Any) -> None:
    assert isinstance(result, Track)
    assert result.stamps.ndim == 1
    assert result.poses.shape == (len(result.stamps), 3)
    assert np.isfinite(result.stamps).all()
    assert np.isfinite(result.poses).all()
    assert (np.diff(result.stamps) >= 0.0).all()
    assert (np.abs(result.poses[:, 2]) <= np.pi).all()
    if isinstance(result, IndexedTrack):
        assert (np.diff(result.scan_indices) > 0).all()


def filter_run(result: Any) -> None:
    assert isinstance(result, FilterRun)
    track(result.track)
    assert len(result.stamps) == len(result.particles)
    assert (np.diff(result.stamps) > 0.0).all()
    assert all(np.isfinite(poses).all() and len(poses) > 0 for poses in result.particles)


def landmarks(result: Any) -> None:
    assert isinstance(result, LandmarkMap)
    assert result.positions.shape == (len(result), 2)
    assert np.isfinite(result.positions).all()
    assert len(set(result.ids.tolist())) == len(result)
    assert result.signatures is None or np.isfinite(result.signatures).all()


def lines(result: Any) -> None:
    assert isinstance(result, LineMap)
    assert np.isfinite(result.lines).all()
    assert result.segments is None or np.isfinite(result.segments).all()


def sightings(result: Any) -> None:
    given, detections = result
    landmarks(given)
    assert isinstance(detections, DetectionLog)
    assert len(detections.poses) == len(detections.detections)
    assert np.isfinite(detections.stamps).all()
    _rows_are_finite_or_nan(detections.poses)


def beam_model(result: Any) -> None:
    assert isinstance(result, SavedBeamModel)
    assert isinstance(result.parameters, BeamParameters)
    assert 0.0 <= result.min_range < result.max_range < np.inf


def field_model(result: Any) -> None:
    assert isinstance(result, SavedLikelihoodField)
    assert 0.0 <= result.min_range < result.max_range < np.inf
    assert 0.0 < result.exponent <= 1.0
    assert result.n_beams >= 1


def landmark_model(result: Any) -> None:
    assert isinstance(result, LandmarkParameters)


def stack_file(result: Any) -> None:
    file, parameters = result
    assert isinstance(file, StackFile)
    assert file.model in STACKS[file.stack].models
    section = file.section
    for name, entry in section.entries.items():
        assert name == entry.name
        assert 0 <= entry.start <= entry.stop <= len(section.text)
    # What is written again as it is stays as it is.
    numbers = {
        name: entry.value
        for name, entry in section.entries.items()
        if isinstance(entry.value, (int, float)) and abs(entry.value) < 1e300 and not entry.filled_in
    }
    assert section.with_values(numbers) == section.text
    assert parameters is not None


def camera(result: Any) -> None:
    if isinstance(result, CameraIntrinsics):
        assert np.isfinite(result.matrix).all()
        return
    assert isinstance(result, Sequence)
    for item in result:
        if isinstance(item, FiducialDetections):
            assert np.isfinite(item.stamp)
            assert len(item.ids) == len(item.corners) == len(item.positions) == len(item.rotations)
        else:
            stamp, grey = item
            assert np.isfinite(stamp)
            assert grey.ndim == 2
            assert grey.dtype == np.uint8


def command(result: Any) -> None:
    """A command ends with a documented code, and says what is wrong on its last line."""
    code, out, err = result
    assert code in (0, 1, 2, 3)
    assert "Traceback" not in err
    if code in (1, 2) and not out:
        errors = [line.startswith("beamfield: error: ") for line in err.splitlines()]
        assert sum(errors) == 1, err
        assert errors[-1], err
    assert _prints(out), out
    assert _prints(err), err


def _prints(text: str) -> bool:
    return all(character.isprintable() or character == "\n" for character in text)


def _rows_are_finite_or_nan(poses: Any) -> None:
    finite = np.isfinite(poses)
    assert (finite.all(axis=1) | np.isnan(poses).all(axis=1)).all()
