"""Maps: map_server YAML with each kind of picture, and Wean Hall's text."""

from __future__ import annotations

import gzip
import io
import tempfile
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

from beamfield.io.maps.range_table_file import precompute_ranges
from beamfield.maps.occupancy import OccupancyGrid
from tests.fuzz.case import Case, one_file
from tests.fuzz.mutate.png import png_bytes

YAML = """\
image: m.pgm
mode: {mode}
resolution: 0.05
origin: [-1.0, 2.5, 0.3]
negate: {negate}
occupied_thresh: 0.65
free_thresh: 0.196
"""
GREY = np.array([[0, 254, 205, 100], [254, 254, 0, 255], [205, 50, 150, 254]], dtype=np.uint8)
TABULATED = OccupancyGrid.from_ros([[0, 0, 100, 0, 0], [0, -1, 0, 0, 100], [0, 0, 0, 0, 0]], 0.2)
WEAN = """\
robot_specifications->global_mapsize_x   20
robot_specifications->resolution         10
robot_specifications->autoshifted_x      0

global_map[0]: 2 3
1.000 0.789 -1.000
0.000 0.100 0.5
"""


def map_yamls() -> list[Case]:
    """YAML files of all modes; their picture stays as it is."""
    picture = {"m.pgm": b"P5\n4 3\n255\n" + GREY.tobytes()}
    texts = [YAML.format(mode=mode, negate=negate) for mode in ("trinary", "scale", "raw") for negate in (0, 1)]
    texts.append(
        "image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    texts.append("image: ./m.pgm\nresolution: 1.0e-1\norigin:\n- 0\n- 0\n- 0\nnegate: false\noccupied_thresh: 0.65\n"
                 "free_thresh: 0.25\nmode: trinary # c\n")  # fmt: skip
    return [Case({"m.yaml": text.encode(), **picture}, "m.yaml", frozenset(picture)) for text in texts]


def pictures(*suffixes: str) -> list[Case]:
    """Pictures of these kinds below a YAML file that stays as it is."""
    made = {".pgm": _pgms, ".png": _pngs, ".bmp": _bmps}
    cases = []
    for suffix in suffixes:
        for mode in ("trinary", "scale", "raw"):
            yaml = YAML.format(mode=mode, negate=0).replace("m.pgm", f"m{suffix}").encode()
            cases += [Case({"m.yaml": yaml, f"m{suffix}": content}, "m.yaml", frozenset(["m.yaml"]))
                      for content in made[suffix]()]  # fmt: skip
    return cases


def wean_maps() -> list[Case]:
    return [one_file("w.dat", WEAN), one_file("w.dat.gz", gzip.compress(WEAN.encode(), mtime=0))]


def range_tables() -> list[Case]:
    """Tables of pre-cached ranges of `TABULATED`."""
    cases = []
    for max_range in (None, 2.0):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "m.ranges"
            precompute_ranges(path, TABULATED, headings=9, max_range=max_range)
            cases.append(one_file("m.ranges", path.read_bytes()))
    return cases


def _pgms() -> list[bytes]:
    words = " ".join(map(str, GREY.ravel().tolist())).encode()
    deep = (GREY.astype(np.uint16) * 257).astype(">u2")
    return [
        b"P5\n4 3\n255\n" + GREY.tobytes(),
        b"P5\n# CREATOR: a map server\n4 3\n65535\n" + deep.tobytes(),
        b"P5 4 3 15 " + (GREY >> 4).tobytes(),
        b"P2\n# comment\n4 3\n255\n" + words + b"\n",
        b"P2 4 3\n65535\n" + b" ".join(str(v).encode() for v in deep.ravel().tolist()),
    ]


def _pngs() -> list[bytes]:
    alpha = np.where(GREY > 200, 255, 128).astype(np.uint8)
    rgb = np.stack([GREY, GREY[::-1], GREY[:, ::-1]], axis=-1)
    palette = Image.fromarray(rgb).quantize(4)
    made = [
        _saved(Image.fromarray(GREY), "PNG"),
        _saved(Image.fromarray(GREY > 100), "PNG"),
        _saved(Image.fromarray(GREY.astype(np.uint16) * 257), "PNG"),
        _saved(Image.fromarray(np.dstack([GREY, alpha])), "PNG"),
        _saved(Image.fromarray(rgb), "PNG"),
        _saved(Image.fromarray(np.dstack([rgb, alpha])), "PNG"),
        _saved(palette, "PNG"),
        _saved(palette, "PNG", transparency=b"\x00\x80\xff\xff"),
        _saved(palette, "PNG", bits=2),
        _saved(Image.fromarray(GREY), "PNG", transparency=205),
        _saved(Image.fromarray(rgb), "PNG", transparency=(0, 205, 100)),
    ]
    return [*made, _interlaced()]


def _interlaced() -> bytes:
    """Return an Adam7 picture, which Pillow reads and does not write: 8 x 8 grey, pass by pass."""
    grey = np.arange(64, dtype=np.uint8).reshape(8, 8)
    raw = b""
    for row, col, down, right in ((0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2),
                                  (1, 0, 2, 1)):  # fmt: skip
        raw += b"".join(b"\0" + line.tobytes() for line in grey[row::down, col::right])
    header = bytes([0, 0, 0, 8, 0, 0, 0, 8, 8, 0, 0, 0, 1])
    return png_bytes([(b"IHDR", header), (b"IDAT", zlib.compress(raw)), (b"IEND", b"")])


def _bmps() -> list[bytes]:
    rgb = np.stack([GREY, GREY, 255 - GREY], axis=-1)
    pictures = (
        Image.fromarray(GREY),
        Image.fromarray(GREY > 100),
        Image.fromarray(rgb),
        Image.fromarray(rgb).quantize(4),
    )
    return [_saved(picture, "BMP") for picture in pictures]


def _saved(picture: Image.Image, kind: str, **options: object) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, kind, **options)
    return stream.getvalue()
