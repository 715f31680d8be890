"""Read the picture of a map as grey levels: PGM, PNG and BMP, with size and content checked before it is decoded."""

from __future__ import annotations

import os
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.BmpImagePlugin import BmpImageFile
from PIL.ImageFile import ImageFile
from PIL.PngImagePlugin import PngImageFile

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.files.png_pixels import DAMAGE, require_all_pixels

MAX_PIXELS = 400_000_000  # 1 km x 1 km at 5 cm

GreyArray = NDArray[np.uint8]

_HEADER_LIMIT = 65_536
_PIXELS_PER_BLOCK = 4_000_000


@dataclass(frozen=True, eq=False)
class MapImage:
    """A picture as it is stored, first row at the top.

    Parameters
    ----------
    grey
        (rows, cols) grey levels, 0 black to 255 white.
    opaque
        (rows, cols) whether a pixel is fully opaque; None if the picture has no transparency.
    """

    grey: GreyArray
    opaque: NDArray[np.bool_] | None = None


def read_map_image(path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS) -> MapImage:
    """Read a picture as 8-bit grey levels, as map_server does.

    It is a PGM (P2 or P5, 8 or 16 bits), PNG (grey, RGB or palette, any depth, with or without transparency) or BMP;
    which of them follows from its content. Deeper levels become round(255 level / maxval), but of 16-bit PNG in colour
    or with alpha the upper byte counts. Colours become their Rec. 709 luma, as in ImageMagick, which nav2 reads with;
    ROS 1 took the mean of the channels. Both agree on grey.

    FormatError if it is none of these, has more than `max_pixels` (found before they are decoded) or fewer than its
    header declares, or is damaged; InvalidInputError if `max_pixels` is not positive.
    """
    if max_pixels < 1:
        raise InvalidInputError(f"max_pixels: expected at least 1, got {max_pixels}")
    source = Path(path)
    with source.open("rb") as file:
        magic = file.read(2)
        file.seek(0)
        if magic in (b"P2", b"P5"):
            return MapImage(_read_pgm(file, source, max_pixels))
        return _read_with_pillow(file, source, max_pixels, magic)


# ---------------------------------------------------------------------------------------------------------------- PGM


def _read_pgm(file: BinaryIO, path: Path, max_pixels: int) -> GreyArray:
    start = file.read(_HEADER_LIMIT)
    plain = start[:2] == b"P2"
    (width, height, maxval), header_size = _pgm_header(start, path)
    _check_size(path, width, height, max_pixels)
    if not 1 <= maxval <= 65_535:
        raise FormatError(path, f"expected a largest grey level from 1 to 65535, got {maxval}", field="maxval")
    n_bytes = os.fstat(file.fileno()).st_size - header_size
    bytes_per_pixel = 1 if maxval < 256 else 2
    # In text every pixel but the last takes a digit and a space.
    needed = 2 * width * height - 1 if plain else bytes_per_pixel * width * height
    if n_bytes < needed:
        raise FormatError(path, f"truncated: {width} x {height} pixels need {needed} bytes, got {max(n_bytes, 0)}")
    file.seek(header_size)
    if plain:
        return _plain_levels(file, path, width, height, maxval, n_bytes)
    return _binary_levels(file, path, width, height, maxval)


def _pgm_header(start: bytes, path: Path) -> tuple[list[int], int]:
    """Return width, height, maxval and where the pixels begin; a comment may stand wherever a space may."""
    numbers: list[int] = []
    position = 2
    for name in ("width", "height", "maxval"):
        skipped = re.compile(rb"(?:[ \t\r\n\v\f]|#[^\r\n]*[\r\n])+").match(start, position)
        token = re.compile(rb"[0-9]{1,9}(?![0-9])").match(start, skipped.end()) if skipped else None
        if token is None:
            found = start[skipped.end() if skipped else position :][:16]
            raise FormatError(
                path, f"expected a number, got {found!r}", line=start.count(b"\n", 0, position) + 1, field=name
            )
        numbers.append(int(token.group()))
        position = token.end()
    # One space ends the header. A comment right behind maxval belongs to the header too, as netpbm has it.
    end = re.compile(rb"[ \t]*#[^\r\n]*[\r\n]|\r\n|[ \t\r\n\v\f]").match(start, position)
    if end is None:
        raise FormatError(path, f"expected a space behind the header, got {start[position : position + 16]!r}")
    return numbers, end.end()


def _binary_levels(file: BinaryIO, path: Path, width: int, height: int, maxval: int) -> GreyArray:
    to_grey = _grey_of_level(maxval)
    grey = np.empty((height, width), dtype=np.uint8)
    sample = np.dtype(np.uint8) if maxval < 256 else np.dtype(">u2")
    rows_per_block = max(1, _PIXELS_PER_BLOCK // width)
    for first in range(0, height, rows_per_block):
        rows = min(rows_per_block, height - first)
        content = file.read(rows * width * sample.itemsize)
        if len(content) < rows * width * sample.itemsize:
            raise FormatError(path, "truncated: the file became shorter while it was read")
        levels = np.frombuffer(content, dtype=sample).reshape(rows, width)
        _check_levels(levels, maxval, first, path)
        grey[first : first + rows] = to_grey[levels]
    return grey


def _plain_levels(file: BinaryIO, path: Path, width: int, height: int, maxval: int, n_bytes: int) -> GreyArray:
    # Ten bytes for each level is generous; it bounds what is read when the file is nothing but comments.
    limit = 10 * width * height + _HEADER_LIMIT
    if n_bytes > limit:
        raise FormatError(path, f"{width} x {height} pixels take at most {limit} bytes as text, got {n_bytes}")
    text = re.sub(rb"#[^\r\n]*", b"", file.read(n_bytes))
    stray = re.search(rb"[^0-9 \t\r\n\v\f]|[0-9]{10}", text)
    if stray is not None:
        found = text[stray.start() : stray.start() + 16]
        raise FormatError(path, f"expected grey levels, got {found!r}")
    # What is left is digits and spaces, which is all that this parser needs to be safe.
    levels: NDArray[np.int64] = np.fromstring(text.decode("ascii"), dtype=np.int64, sep=" ")
    if len(levels) < width * height:
        raise FormatError(path, f"truncated: expected {width * height} grey levels, got {len(levels)}")
    levels = levels[: width * height].reshape(height, width)
    _check_levels(levels, maxval, 0, path)
    return _grey_of_level(maxval)[levels]


def _grey_of_level(maxval: int) -> GreyArray:
    levels = np.arange(maxval + 1, dtype=np.int64)
    return ((2 * 255 * levels + maxval) // (2 * maxval)).astype(np.uint8)


def _check_levels(levels: NDArray[Any], maxval: int, first_row: int, path: Path) -> None:
    if int(levels.max()) > maxval:
        row, col = np.argwhere(levels > maxval)[0]
        raise FormatError(
            path,
            f"the grey level {int(levels[row, col])} at (row, col) = ({first_row + row}, {col}) "
            f"is above the largest one, {maxval}",
        )


def _check_size(path: Path, width: int, height: int, max_pixels: int) -> None:
    if width < 1 or height < 1:
        raise FormatError(path, f"expected a picture with pixels, got {width} x {height}")
    if width * height > max_pixels:
        raise FormatError(path, f"{width} x {height} pixels exceed the limit of {max_pixels}")


# ------------------------------------------------------------------------------------------------------------- Pillow


def _read_with_pillow(file: BinaryIO, path: Path, max_pixels: int, magic: bytes) -> MapImage:
    # The classes themselves, because Image.open adds a limit of its own that cannot be set for one call. They read no
    # pixels until load().
    kind = {b"\x89P": PngImageFile, b"BM": BmpImageFile}.get(magic)
    if kind is None:
        raise FormatError(path, f"expected a PGM (P2 or P5), PNG or BMP picture, got {magic!r} at its start")
    try:
        # Pillow warns of chunks that no map needs, such as an animation that is damaged.
        with warnings.catch_warnings(action="ignore"), kind(file) as picture:
            _check_size(path, *picture.size, max_pixels)
            if isinstance(picture, PngImageFile):
                require_all_pixels(file, picture)
                _spread_key(picture)
            else:
                _require_all_of_bmp(file, path, picture)
            picture.load()
            return _grey_and_opaque(picture)
    except FormatError:
        raise
    except DAMAGE as error:
        # An error of the file system itself carries an errno.
        if isinstance(error, OSError) and error.errno is not None:
            raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(path, f"damaged picture: {reason}") from error


def _spread_key(picture: PngImageFile) -> None:
    # Pillow spreads grey levels of 2 and 4 bits over 0 to 255, but not the level that stands for transparent.
    bits = {"L;2": 2, "L;4": 4}.get(str(picture.tile[0][3]))
    if bits and "transparency" in picture.info:
        largest = 2**bits - 1
        picture.info["transparency"] = (picture.info["transparency"] & largest) * 255 // largest


def _require_all_of_bmp(file: BinaryIO, path: Path, picture: ImageFile) -> None:
    # Before Pillow makes room for its pixels.
    decoder, _, data_start, details = picture.tile[0]
    if decoder != "raw":
        # Its codes may leave pixels out.
        raise FormatError(path, "run-length encoded BMP is not supported: save it uncompressed, or as PNG")
    stride: Any = details[1] if details else 0
    needed, found = stride * picture.height, os.fstat(file.fileno()).st_size - data_start
    if found < needed:
        raise FormatError(path, f"damaged picture: truncated, its pixels take {needed} bytes, got {max(found, 0)}")


def _grey_and_opaque(picture: Image.Image) -> MapImage:
    # In bands of rows: every step takes several bytes a pixel.
    grey = np.empty((picture.height, picture.width), dtype=np.uint8)
    opaque = np.empty(grey.shape, dtype=np.bool_) if picture.has_transparency_data else None
    rows_per_band = max(1, _PIXELS_PER_BLOCK // picture.width)
    for first in range(0, picture.height, rows_per_band):
        last = min(first + rows_per_band, picture.height)
        band_grey, band_opaque = _band(picture.crop((0, first, picture.width, last)))
        grey[first:last] = band_grey
        if opaque is not None:
            opaque[first:last] = band_opaque
    return MapImage(grey, opaque)


def _band(picture: Image.Image) -> tuple[GreyArray, NDArray[np.bool_] | None]:
    if picture.mode.startswith("I"):
        levels = np.asarray(picture).astype(np.int64)
        key = picture.info.get("transparency")
        return _grey_of_level(65_535)[np.clip(levels, 0, 65_535)], None if key is None else levels != key
    has_alpha = picture.has_transparency_data
    if picture.mode == "1" and has_alpha:
        # The key of white is 255 since Pillow 12.1 and was 1 before, which its conversions did not find.
        grey = np.asarray(picture.convert("L"))
        return grey, grey != (255 if picture.info["transparency"] else 0)
    if picture.mode in ("1", "L", "LA"):
        channels = np.asarray(picture.convert("LA" if has_alpha else "L"))
        grey = channels[..., 0] if has_alpha else channels
    else:
        channels = np.asarray(picture.convert("RGBA" if has_alpha else "RGB"))
        grey = _luma(channels[..., :3])
    return grey, channels[..., -1] == 255 if has_alpha else None


def _luma(rgb: GreyArray) -> GreyArray:
    # Integers keep grey exactly grey: the weights (Rec. 709, in millionths) sum to a million.
    red, green, blue = np.moveaxis(rgb.astype(np.int32), -1, 0)
    luma = (212_656 * red + 715_158 * green + 72_186 * blue + 500_000) // 1_000_000
    return np.asarray(luma, dtype=np.uint8)
