"""Every example runs as it stands."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_example_runs_and_prints_a_result(path: Path, capsys: pytest.CaptureFixture[str], tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")
    assert len(capsys.readouterr().out.splitlines()) >= 2


def test_there_are_examples():
    assert EXAMPLES


@pytest.mark.real
def test_ceiling_markers_of_a_real_camera_are_where_its_own_detector_has_them(
    data: Path, capsys: pytest.CaptureFixture[str], monkeypatch
):
    pytest.importorskip("cv2", reason="the example finds markers with OpenCV, which beamfield does not need")
    path = next(path for path in EXAMPLES if path.stem == "ceiling_marker")
    bags = [data / "fiducial_ceiling" / name for name in ("aruco_images.bag", "aruco_transforms.bag")]
    monkeypatch.setattr("sys.argv", [str(path), *map(str, bags)])
    runpy.run_path(str(path), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("markers 100, 103, 106, 107, 110, 111, 112")
    distances = [float(line.split()[0]) for line in lines if "other detector" in line]
    assert len(distances) == 7
    # Less than a pixel, which is 1 to 3 mm up there.
    assert max(distances) < 3.0
