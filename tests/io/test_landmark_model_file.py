"""landmark_model.yaml and the choice of a reader for sightings."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from scipy.io import savemat

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.parameters.landmark_model_file import landmark_model_text, read_landmark_model
from beamfield.io.read_sightings_log import read_sightings_log
from beamfield.models.landmark_parameters import LandmarkParameters

BOTH = LandmarkParameters(
    0.1 + 1e-17, 1 / 3, 0.5, spurious_rate=0.1, max_range=12.5, range_bias=-2e-9, bearing_bias=3.0, range_scale=1.07
)


@pytest.mark.parametrize("parameters", [BOTH, LandmarkParameters(None, 0.2), LandmarkParameters(0.2, None)],
                         ids=["both", "bearing only", "range only"])  # fmt: skip
def test_what_is_written_is_read_back_to_the_last_bit(parameters, tmp_path):
    text = landmark_model_text(parameters, intervals={"sigma_range": (0.1, 0.2)}, provenance={"seed": 3})
    (tmp_path / "a.yaml").write_text(text)
    back = read_landmark_model(tmp_path / "a.yaml")
    for name in LandmarkParameters.__dataclass_fields__:
        assert getattr(back, name) == getattr(parameters, name)


def test_a_file_by_hand_needs_only_the_sigmas(tmp_path):
    (tmp_path / "a.yaml").write_text("landmark_model:\n  sigma_range: 0.2\n  sigma_bearing: null\n")
    assert read_landmark_model(tmp_path / "a.yaml").sigma_bearing is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("other: 1\n", "the key 'landmark_model' is missing"),
        ("landmark_model: 3\n", "a.yaml:1: landmark_model: expected the parameters' names and values, got 3"),
        ("landmark_model:\n  sigma_range: 0.1\n", "the key 'sigma_bearing' is missing in 'landmark_model'"),
        ("landmark_model:\n  sigma: 1\n", "a.yaml:2: .* unknown parameter 'sigma'; known are sigma_range"),
        ("landmark_model:\n  sigma_range: wide\n  sigma_bearing: 1\n", "a.yaml:2: .* expected a number, got 'wide'"),
        ("landmark_model: {sigma_range: 1, sigma_bearing: 1, range_bias: null}\n", "range_bias: expected a number"),
        ("landmark_model: {sigma_range: -1, sigma_bearing: 1}\n", "landmark_model: sigma_range: expected a positive"),
    ],
    ids=["key", "number", "missing", "unknown", "word", "null bias", "negative"],
)
def test_what_is_no_landmark_model_is_refused(text, message, tmp_path):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_landmark_model(tmp_path / "a.yaml")


def test_matrices_have_no_place_in_the_file():
    with pytest.raises(InvalidInputError, match="a signature covariance or confusion matrix has no place"):
        landmark_model_text(LandmarkParameters(0.1, 0.1, confusion=np.eye(2)))


def test_the_reader_is_chosen_by_what_a_file_holds(tmp_path):
    savemat(
        tmp_path / "m.mat",
        {"landmark": [[1.0, 0, 0]], "groundtruth": [[1.0, 1, 0, 0]], "measurement": [[1.0, 1, 1, 0]]},
    )
    assert read_sightings_log(tmp_path / "m.mat")[1].n_detections == 1
    savemat(tmp_path / "p.mat", {"TL": [[3.0, 0, 0]], "GT": [[0.0, 1, 0, 0]], "TD": [[0.0, 2, 3, 1]]})
    assert read_sightings_log(tmp_path / "p.mat")[0].ids.tolist() == [3]
    (tmp_path / "map.csv").write_text("id,x,y\n1,5,5\n")
    assert read_sightings_log(tmp_path / "m.mat", tmp_path / "map.csv")[0].positions.tolist() == [[5.0, 5.0]]
    (tmp_path / "landmark.csv").write_text("0,0\n")
    (tmp_path / "(X1,Y2).csv").write_text("30\n")
    assert read_sightings_log(tmp_path)[1].places.tolist() == [0]
    rows = b"stamp,x,y,theta,id,range,bearing\n1,0,0,0,1,7,\n"
    (tmp_path / "s.csv.gz").write_bytes(gzip.compress(rows))
    assert read_sightings_log(tmp_path / "s.csv.gz", tmp_path / "map.csv")[1].detections[0].ranges.tolist() == [7.0]


def test_raw_mrclam_files_are_found_beside_each_other(tmp_path):
    (tmp_path / "Robot2_Measurement.dat").write_text("1.0 72 2.5 0.1\n")
    (tmp_path / "Robot2_Groundtruth.dat.gz").write_bytes(gzip.compress(b"0.9 1 2 0.5\n1.1 1 2 0.5\n"))
    (tmp_path / "Barcodes.dat").write_text("6 72\n")
    (tmp_path / "Landmark_Groundtruth.dat").write_text("6 1.0 2.0 0 0\n")
    landmarks, log = read_sightings_log(tmp_path / "Robot2_Measurement.dat")
    assert landmarks.ids.tolist() == [6]
    np.testing.assert_allclose(log.poses, [[1.0, 2.0, 0.5]])
    (tmp_path / "Robot2_Groundtruth.dat.gz").unlink()
    with pytest.raises(FormatError, match=r"expected Robot2_Groundtruth\.dat beside it: there are no true poses"):
        read_sightings_log(tmp_path / "Robot2_Measurement.dat")
    with pytest.raises(FileNotFoundError, match=r"Robot3_Measurement\.dat"):
        read_sightings_log(tmp_path / "Robot3_Measurement.dat")


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("Robot1_Measurement.dat.gz", "Robot1_Odometry.dat.gz"), "without Robot.*_Groundtruth.dat: .* no true poses"),
        (
            ("Robot1_Measurement.dat", "Robot2_Measurement.dat.gz", "Robot1_Groundtruth.dat"),
            r"expected one of the folder's files: Robot1_Measurement\.dat, Robot2_Measurement\.dat\.gz$",
        ),
        (("Plaza1_.mat", "Plaza1_TD.txt"), r"expected one of the folder's files: Plaza1_\.mat$"),
        (tuple(f"mrclam{i}.mat" for i in range(1, 8)), r"mrclam1\.mat, .*, mrclam5\.mat and 2 more$"),
        (("sensor_data.dat", "world.dat"), "a Freiburg course log: it has odometry but no true poses"),
        (("notes.txt",), r"expected a CSV file .* landmark\.csv and \(Xa,Yb\)\.csv; got a folder with notes\.txt$"),
        ((), "got a folder with no files$"),
    ],
    ids=["no true poses", "MRCLAM", "Plaza", "many", "Freiburg", "unknown", "empty"],
)
def test_a_folder_of_another_kind_says_what_to_give_instead(names, message, tmp_path):
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(FormatError, match=message):
        read_sightings_log(tmp_path)


def test_other_mat_files_are_refused(tmp_path):
    savemat(tmp_path / "m.mat", {"speed": [[1.0]], "time": [[2.0]]})
    with pytest.raises(FormatError, match=r"m.mat: expected a CSV .* got a .mat file with the arrays speed, time"):
        read_sightings_log(tmp_path / "m.mat")
