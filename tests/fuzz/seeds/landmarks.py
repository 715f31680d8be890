"""Landmarks, lines, and what robots saw of them."""

from __future__ import annotations

import io

import numpy as np
from scipy.io import savemat

from tests.fuzz.case import Case, one_file

INSTANT = {
    "landmark": [[1, 0.5, 1.5], [4, 2.0, 3.0]],
    "groundtruth": [[10, 0.0, 1.0, 0.1], [12, 0.5, 1.0, 0.2]],
    "measurement": [[12, 4, 2.5, 0.3], [12, 1, 1.5, -0.3], [10, 4, 2.2, 0.1]],
}
PLAZA = {
    "TL": [[0, 5.0, 0.0], [6, 0.0, 5.0]],
    "GT": [[0.0, 0.0, 0.0, 3.0], [0.5, 1.0, 0.0, -3.0], [4.0, 2.0, 0.0, -3.0]],
    "TD": [[0.25, 2, 6, 7.0], [0.1, 2, 0, 8.0], [2.0, 2, 0, 9.0]],
}
SIGHTINGS = "stamp,x,y,theta,id,range,bearing\n0.5,1,2,0.1,3,2.5,0.3\n0.5,1,2,0.1,,2.5,\n1.5,1.5,2,0.2,-1,,-0.5\n"


def landmark_maps() -> list[Case]:
    texts = (
        "id,x,y\n3,1.5,2.5\n7,-1,0\n",
        "id,x,y,signature\n3,1.5,2.5,0.5\n7,-1,0,0.25\n",
        "# map\nid, x, y, type\n3, 1.5, 2.5, 0\n\n7, -1, 0, 2\n",
        "id,x,y,signature_1,signature_2\n3,1.5,2.5,0.5,1\n7,-1,0,0.25,2\n",
    )
    return [one_file("l.csv", text) for text in texts]


def line_maps() -> list[Case]:
    return [
        one_file("l.csv", "id,rho,alpha\n1,2.5,0.3\n2,-1,3.0\n"),
        one_file("l.csv", "id,x1,y1,x2,y2\n1,0,0,1,1\n2,3,0,3,5\n"),
    ]


def amrl_maps() -> list[Case]:
    return [one_file("a.txt", "0,0,1,1\n3.5, 0, 3.5, 5\n-1,-2,-3,-4\n")]


def mrclam_landmarks() -> list[Case]:
    return [one_file("Landmark_Groundtruth.dat", "# subject x y\n6 1.5 2.5 0.0001 0.0002\n7 -1 0 0.0001 0.0001\n")]


def course_worlds() -> list[Case]:
    return [one_file("world.dat", "1 2 1\n2 0 4\n3 2 7\n")]


def course_logs() -> list[Case]:
    return [one_file("sensor_data.dat", "ODOMETRY 0.1 0.5 -0.1\nSENSOR 1 1.9 0.3\nSENSOR 2 3.8 1.5\nODOMETRY 0 1 0\n")]


def sightings() -> list[Case]:
    """A CSV file of sightings; the map beside it stays as it is."""
    return [Case({"s.csv": SIGHTINGS.encode(), "l.csv": b"id,x,y\n3,1.5,2.5\n"}, "s.csv", frozenset(["l.csv"]))]


def mrclam_sets() -> list[Case]:
    files = {
        "Robot1_Measurement.dat": b"# time barcode range bearing\n10.5 72 2.5 0.3\n10.5 5 1.5 -0.3\n11.0 99 2 0\n",
        "Robot1_Groundtruth.dat": b"10.0 1 2 0.1\n10.25 1.1 2 0.1\n10.5 1.2 2 0.2\n10.9 1.3 2 0.2\n11.1 1.4 2 0.2\n",
        "Barcodes.dat": b"1 5\n6 72\n7 27\n",
        "Landmark_Groundtruth.dat": b"6 1.5 2.5 0.0001 0.0002\n7 -1 0 0.0001 0.0001\n",
    }
    return [Case(files, "Robot1_Measurement.dat")]


def mat_files() -> list[Case]:
    """MRCLAM moments and Plaza ranges, plain and compressed."""
    return [
        one_file("a.mat", _mat(content, compressed=compressed))
        for content in (INSTANT, PLAZA)
        for compressed in (False, True)
    ]


def roh_folders() -> list[Case]:
    files = {
        "landmark.csv": b"0.0, 1.0\n2.0, 3.0\n",
        "(X1.5,Y3.0).csv": b"10.0, -20.5\n11, -20\n",
        "(X0,Y-1).csv": b"5, 6\n",
    }
    return [Case(files, ".")]


def _mat(content: dict[str, list[list[float]]], *, compressed: bool) -> bytes:
    stream = io.BytesIO()
    savemat(
        stream, {name: np.array(rows, dtype=np.float64) for name, rows in content.items()}, do_compression=compressed
    )
    # The header holds the time of writing.
    return b"MATLAB 5.0 MAT-file".ljust(124) + stream.getvalue()[124:]
