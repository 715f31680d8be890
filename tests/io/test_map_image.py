"""Pictures of maps: every kind of PGM and PNG, and hostile ones."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from PIL import Image
from PIL.BmpImagePlugin import BmpImageFile
from PIL.PngImagePlugin import PngImageFile

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.maps.map_image import read_map_image

GREY = np.array([[0, 1, 100], [205, 254, 255]], dtype=np.uint8)


@pytest.fixture
def write(tmp_path):
    def write_it(content: bytes):
        path = tmp_path / "a.pgm"
        path.write_bytes(content)
        return path

    return write_it


@pytest.fixture
def save(tmp_path):
    def save_it(picture: Image.Image, **options):
        path = tmp_path / "a.png"
        picture.save(path, **options)
        return path

    return save_it


def chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def png_with_header(
    width: int, height: int, depth: int, colour: int, rows: bytes, *extra: tuple[bytes, bytes]
) -> bytes:
    """Return a PNG written by hand, independent of Pillow."""
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    between = b"".join(chunk(*one) for one in extra)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + between
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


# ---------------------------------------------------------------------------------------------------------------- PGM


@pytest.mark.parametrize(
    "header",
    [
        b"P5\n3 2\n255\n",
        b"P5 3 2 255 ",
        b"P5\r\n3 2\r\n255\r\n",
        b"P5\n# made by hand 7 7\n3 2\n255\n",
        b"P5\n#\n# two\n\t 3 # width\n 2#height\n  255\n",
        b"P5#at once\n3 2 255\n",
        b"P5\n3 2\n255 # behind maxval\n",
        b"P5 3 2 255# directly behind maxval\n",
    ],
)
def test_binary_pgm_with_comments_and_spaces_anywhere(write, header):
    image = read_map_image(write(header + GREY.tobytes()))
    np.testing.assert_array_equal(image.grey, GREY)
    assert image.grey.dtype == np.uint8
    assert image.opaque is None


def test_pixels_that_look_like_spaces_or_comments_are_pixels(write):
    pixels = b"\n\n#\r# "
    image = read_map_image(write(b"P5\n3 2\n255\n" + pixels))
    assert image.grey.tobytes() == pixels


def test_what_follows_the_first_picture_is_not_read(write):
    assert read_map_image(write(b"P5 3 2 255\n" + GREY.tobytes() + b"P5 1 1 255\nx")).grey.tobytes() == GREY.tobytes()


@pytest.mark.parametrize(
    "text",
    [
        b"P2\n3 2\n255\n0 1 100\n205 254 255\n",
        b"P2\n3 2\n255\n  0  1 100 205 254 255",
        b"P2 # plain\n3 2\n# c\n255\n0\n1 # one\n100\r\n205\t254 000255\n",
    ],
)
def test_plain_pgm_with_comments_and_spaces_anywhere(write, text):
    np.testing.assert_array_equal(read_map_image(write(text)).grey, GREY)


@pytest.mark.parametrize("maxval", [1, 2, 3, 15, 100, 254, 255, 256, 1000, 4095, 65535])
@pytest.mark.parametrize("plain", [True, False])
def test_other_depths_are_scaled_to_eight_bits_and_rounded(write, maxval, plain):
    levels = np.unique(np.linspace(0, maxval, 40).round().astype(np.int64))
    header = f"{'P2' if plain else 'P5'}\n{len(levels)} 1\n{maxval}\n".encode()
    if plain:
        body = " ".join(str(v) for v in levels).encode()
    else:
        body = levels.astype(">u2" if maxval > 255 else "u1").tobytes()
    # Half a level up, in whole numbers: floor(255 v / m + 1/2).
    expected = [(510 * int(v) + maxval) // (2 * maxval) for v in levels]
    assert read_map_image(write(header + body)).grey[0].tolist() == expected


def test_many_rows_are_read_in_blocks_without_mixing_them(write, rng, monkeypatch):
    monkeypatch.setattr("beamfield.io.maps.map_image._PIXELS_PER_BLOCK", 100)
    for dtype, maxval in (("u1", 255), (">u2", 65535)):
        levels = rng.integers(0, maxval + 1, (57, 31))
        image = read_map_image(write(b"P5 31 57 %d\n" % maxval + levels.astype(dtype).tobytes()))
        np.testing.assert_array_equal(image.grey, (510 * levels + maxval) // (2 * maxval))


def test_pillow_reads_the_same_from_eight_bit_pgm(write, rng):
    levels = rng.integers(0, 256, (40, 30)).astype(np.uint8)
    path = write(b"P5 30 40 255\n" + levels.tobytes())
    with Image.open(path) as other:
        np.testing.assert_array_equal(read_map_image(path).grey, np.asarray(other))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "expected a PGM (P2 or P5), PNG or BMP picture, got b''"),
        (b"P6\n1 1\n255\nabc", "got b'P6'"),
        (b"GIF89a......", "got b'GI'"),
        (b"P5", "width: expected a number, got b''"),
        (b"P5\nx 2\n255\n", "width: expected a number, got b'x 2"),
        (b"P5\n3\n", "height: expected a number, got b''"),
        (b"P5\n-3 2\n255\n", "width: expected a number, got b'-3 2"),
        (b"P53 2 255\n", "width: expected a number, got b'3 2 255"),
        (b"P5\n3 2.5 255\n", "maxval: expected a number, got b'.5 255"),
        (b"P5\n12345678901 2 255\n", "width: expected a number"),
        (b"P5\n3 2 255", "expected a space behind the header, got b''"),
        (b"P5\n3 2 255x", "expected a space behind the header, got b'x'"),
        (b"P5\n0 2\n255\n", "expected a picture with pixels, got 0 x 2"),
        (b"P5\n3 2\n0\n", "maxval: expected a largest grey level from 1 to 65535, got 0"),
        (b"P5\n3 2\n65536\n", "maxval: expected a largest grey level from 1 to 65535, got 65536"),
        (b"P5\n3 2\n255\nabcde", "truncated: 3 x 2 pixels need 6 bytes, got 5"),
        (b"P5\n3 2\n256\n" + b"a" * 11, "truncated: 3 x 2 pixels need 12 bytes, got 11"),
        (b"P5\n3 2\n100\nabcdez", "the grey level 101 at (row, col) = (1, 1) is above the largest one, 100"),
        (b"P2\n3 2\n255\n1 2 3", "truncated: 3 x 2 pixels need 11 bytes, got 5"),
        (b"P2\n3 2\n255\n1 2 3 4 5      ", "truncated: expected 6 grey levels, got 5"),
        (b"P2\n3 2\n255\n1 2 3 4 5 x", "expected grey levels, got b'x'"),
        (b"P2\n3 2\n255\n1 2 3 4 5 -6", "expected grey levels, got b'-6'"),
        (b"P2\n3 2\n255\n1 2 3 4 5 256", "the grey level 256 at (row, col) = (1, 2)"),
        (b"P2\n3 2\n255\n1 2 3 4 5 99999999999999999999", "expected grey levels, got b'9999"),
        (b"P2\n1 1\n255\n#" + b"x" * 100_000, "take at most"),
    ],
)
def test_a_damaged_pgm_is_named_with_what_is_wrong(write, content, message):
    path = write(content)
    with pytest.raises(FormatError) as caught:
        read_map_image(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("magic", [b"P2", b"P5"])
def test_a_pgm_bomb_is_refused_by_its_header(write, magic):
    path = write(magic + b"\n999999999 999999999\n255\n0")
    with pytest.raises(FormatError, match="exceed the limit of 400000000"):
        read_map_image(path)


def test_the_limit_of_pixels_can_be_set(write):
    path = write(b"P5 3 2 255\n" + GREY.tobytes())
    assert read_map_image(path, max_pixels=6).grey.shape == (2, 3)
    with pytest.raises(FormatError, match="3 x 2 pixels exceed the limit of 5"):
        read_map_image(path, max_pixels=5)
    with pytest.raises(InvalidInputError, match="max_pixels"):
        read_map_image(path, max_pixels=0)


# ---------------------------------------------------------------------------------------------------------------- PNG


def test_png_grey_one_bit_palette_and_rgb_of_grey_give_the_same_levels(save):
    for picture in (
        Image.fromarray(GREY),
        Image.fromarray(np.repeat(GREY[..., None], 3, axis=2)),
        Image.fromarray(GREY).convert("P"),
    ):
        image = read_map_image(save(picture))
        np.testing.assert_array_equal(image.grey, GREY)
        assert image.opaque is None
    one_bit = read_map_image(save(Image.fromarray(GREY > 100)))
    np.testing.assert_array_equal(one_bit.grey, 255 * (GREY > 100))


@pytest.mark.parametrize(("depth", "row", "levels"), [
    (1, 0b10110000, [255, 0, 255, 255]),
    (2, 0b00011011, [0, 85, 170, 255]),
    (4, None, [0, 17, 170, 255]),
])  # fmt: skip
def test_png_of_fewer_bits_written_by_hand(write, depth, row, levels):
    body = bytes([0, row]) if row is not None else bytes([0, 0x01, 0xAF])
    image = read_map_image(write(png_with_header(4, 1, depth, 0, body)))
    assert image.grey[0].tolist() == levels


def test_png_of_sixteen_bits_is_rounded_to_eight(write):
    levels = [0, 128, 129, 32896, 65535]
    body = b"\0" + np.array(levels, dtype=">u2").tobytes()
    image = read_map_image(write(png_with_header(5, 1, 16, 0, body)))
    assert image.grey[0].tolist() == [(510 * v + 65535) // 131070 for v in levels]
    assert image.opaque is None


@pytest.mark.parametrize("mode", ["LA", "RGBA"])
def test_only_fully_opaque_pixels_are_opaque(save, mode):
    alpha = np.array([[255, 254, 0], [255, 128, 255]], dtype=np.uint8)
    channels = [GREY] * (1 if mode == "LA" else 3) + [alpha]
    image = read_map_image(save(Image.fromarray(np.stack(channels, axis=2))))
    np.testing.assert_array_equal(image.grey, GREY)
    np.testing.assert_array_equal(image.opaque, alpha == 255)


@pytest.mark.parametrize(("depth", "colour", "body", "key"), [
    (8, 0, bytes([0, 10, 20]), b"\0\x14"),
    (1, 0, bytes([0, 0b01000000]), b"\0\x01"),
    (2, 0, bytes([0, 0b01100000]), b"\0\x02"),
    (4, 0, bytes([0, 0x1E]), b"\0\x0e"),
    (16, 0, bytes([0, 0, 10, 0, 20]), b"\0\x14"),
    (8, 2, bytes([0, 1, 1, 1, 9, 9, 9]), b"\0\x09\0\x09\0\x09"),
])  # fmt: skip
def test_a_transparent_colour_key_counts_as_transparency(write, depth, colour, body, key):
    image = read_map_image(write(png_with_header(2, 1, depth, colour, body, (b"tRNS", key))))
    assert image.opaque is not None
    assert image.opaque[0].tolist() == [True, False]


def test_a_palette_with_transparent_entries(write):
    palette = (b"PLTE", bytes([0, 0, 0, 205, 205, 205, 255, 255, 255]))
    image = read_map_image(write(png_with_header(3, 1, 8, 3, bytes([0, 0, 1, 2]), palette, (b"tRNS", b"\xff\x00"))))
    assert image.grey[0, [0, 2]].tolist() == [0, 255]
    assert image.opaque is not None
    assert image.opaque[0].tolist() == [True, False, True]


def test_colours_become_their_rec709_luma(save):
    colours = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [10, 200, 90]]], dtype=np.uint8)
    image = read_map_image(save(Image.fromarray(colours)))
    expected = np.rint(colours @ np.array([0.212656, 0.715158, 0.072186]))
    np.testing.assert_array_equal(image.grey, expected)


def test_bmp_is_read_because_map_server_reads_it(tmp_path):
    path = tmp_path / "a.bmp"
    Image.fromarray(GREY).save(path)
    np.testing.assert_array_equal(read_map_image(path).grey, GREY)


def test_a_png_bomb_is_refused_by_its_header(write):
    path = write(png_with_header(40_000, 40_000, 8, 0, b"\0" * 10))
    with pytest.raises(FormatError, match="40000 x 40000 pixels exceed the limit of 400000000"):
        read_map_image(path)


def test_a_png_above_pillows_own_limit_and_below_ours_is_not_refused_for_its_size(write):
    path = write(png_with_header(14_000, 14_000, 1, 0, b"\0" * 10))
    with pytest.raises(FormatError, match=r"damaged picture: .*truncated"):
        read_map_image(path)


def interlaced_rows(grey: np.ndarray, depth: int = 8) -> bytes:
    """Return a picture's rows in Adam7's order, from the definition: every eighth pixel first, the odd rows last."""
    passes = [
        grey[0::8, 0::8],
        grey[0::8, 4::8],
        grey[4::8, 0::4],
        grey[0::4, 2::4],
        grey[2::4, 0::2],
        grey[0::2, 1::2],
    ]
    rows = b""
    for part in (*passes, grey[1::2]):
        if part.size:
            bits = np.unpackbits(part[..., None], axis=2)[..., 8 - depth :].reshape(len(part), -1)
            rows += b"".join(b"\0" + row.tobytes() for row in np.packbits(bits, axis=1))
    return rows


def interlaced_png(width: int, height: int, depth: int, rows: bytes) -> bytes:
    content = bytearray(png_with_header(width, height, depth, 0, rows))
    content[28] = 1
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    return bytes(content)


@pytest.mark.parametrize("depth", [1, 4, 8])
def test_interlaced_pictures_of_every_size_are_read_and_refused_without_their_last_byte(write, rng, depth):
    for height, width in np.ndindex(10, 10):
        levels = rng.integers(0, 2**depth, (height + 1, width + 1)).astype(np.uint8)
        rows = interlaced_rows(levels, depth)
        image = read_map_image(write(interlaced_png(width + 1, height + 1, depth, rows)))
        np.testing.assert_array_equal(image.grey, levels * (255 // (2**depth - 1)))
        with pytest.raises(FormatError, match=f"{width + 1} x {height + 1} pixels take {len(rows)} bytes"):
            read_map_image(write(interlaced_png(width + 1, height + 1, depth, rows[:-1])))


@pytest.mark.parametrize(("depth", "colour", "bits"), [
    (1, 0, 1), (2, 0, 2), (4, 0, 4), (8, 0, 8), (16, 0, 16), (8, 2, 24), (16, 2, 48), (8, 3, 8), (8, 4, 16),
    (16, 4, 32), (8, 6, 32), (16, 6, 64),
])  # fmt: skip
def test_a_png_whose_pixel_data_end_early_is_an_error_and_no_black_rows(write, depth, colour, bits):
    palette = [(b"PLTE", bytes(range(9)))] if colour == 3 else []
    row = b"\0" + b"\1" * -(-13 * bits // 8)
    assert read_map_image(write(png_with_header(13, 7, depth, colour, row * 7, *palette))).grey.shape == (7, 13)
    for missing in (1, len(row), 7 * len(row)):
        rows = (row * 7)[:-missing]
        with pytest.raises(FormatError, match=f"a.pgm: .*truncated, 13 x 7 pixels take {7 * len(row)} bytes"):
            read_map_image(write(png_with_header(13, 7, depth, colour, rows, *palette)))


def test_a_png_that_lies_about_its_size_is_refused_before_room_is_made_for_it(write, monkeypatch):
    monkeypatch.setattr(PngImageFile, "load", lambda *_: pytest.fail("room was made"))
    path = write(png_with_header(64, 6_250_000, 8, 0, b"\0" * 65))
    assert path.stat().st_size < 100
    with pytest.raises(FormatError, match="64 x 6250000 pixels take 406250000 bytes"):
        read_map_image(path)
    # Dense enough to be possible by its size, but not there.
    with pytest.raises(FormatError, match="65000 x 1000 pixels take 65001000 bytes"):
        read_map_image(write(png_with_header(65_000, 1_000, 8, 0, b"\0" * 64_000_000)))


def test_pixel_data_in_several_chunks_count_only_while_they_follow_each_other(write, rng):
    rows = b"".join(b"\0" + row.tobytes() for row in rng.integers(0, 256, (50, 40)).astype(np.uint8))
    whole = zlib.compress(rows)
    head = png_with_header(40, 50, 8, 0, b"")[:33]
    parts = [chunk(b"IDAT", part) for part in (whole[:700], b"", whole[700:])]
    grey = read_map_image(write(head + b"".join(parts) + chunk(b"IEND", b""))).grey
    np.testing.assert_array_equal(grey, np.frombuffer(rows, np.uint8).reshape(50, 41)[:, 1:])
    with pytest.raises(FormatError, match="truncated"):
        read_map_image(write(head + parts[0] + chunk(b"tEXt", b"a\0b") + parts[2] + chunk(b"IEND", b"")))
    with pytest.raises(FormatError, match="truncated"):
        read_map_image(write(head + parts[0]))


def test_a_png_without_pixel_data_or_with_those_of_a_part_only_is_an_error(write):
    head, rest = png_with_header(2, 2, 8, 0, b"\0ab\0cd")[:33], png_with_header(2, 2, 8, 0, b"\0ab\0cd")[33:]
    with pytest.raises(FormatError, match="damaged picture"):
        read_map_image(write(head + rest[-12:]))
    frame = chunk(b"fcTL", struct.pack(">IIIIIHHBB", 0, 1, 1, 0, 0, 1, 1, 0, 0))
    with pytest.raises(FormatError, match="some pixels have no data"):
        read_map_image(write(head + frame + rest))


def bmp(width: int, height: int, bits: int, pixels: bytes, compression: int = 0) -> bytes:
    """Return a BMP written by hand, with a grey palette up to 8 bits."""
    palette = b"".join(bytes((g, g, g, 0)) for g in range(256)) if bits == 8 else b""
    header = struct.pack("<IiiHHIIiiII", 40, width, height, 1, bits, compression, 0, 0, 0, 0, 0)
    start = 14 + 40 + len(palette)
    return b"BM" + struct.pack("<IHHI", start + len(pixels), 0, 0, start) + header + palette + pixels


@pytest.mark.parametrize(("bits", "stride"), [(8, 8), (24, 16)])
def test_a_bmp_with_missing_pixels_is_refused_before_room_is_made_for_it(write, monkeypatch, bits, stride):
    assert read_map_image(write(bmp(5, 3, bits, b"\7" * 3 * stride))).grey.tolist() == [[7] * 5] * 3
    monkeypatch.setattr(BmpImageFile, "load", lambda *_: pytest.fail("room was made"))
    for height, found in ((3, 3 * stride - 1), (80_000_000, 3 * stride), (-3, stride)):
        needed = abs(height) * stride
        with pytest.raises(FormatError, match=f"truncated, its pixels take {needed} bytes, got {found}"):
            read_map_image(write(bmp(5, height, bits, b"\7" * found)))


def test_a_bmp_with_run_length_codes_is_refused_because_they_may_leave_pixels_out(write):
    # Two pixels, then the end of the line: the other three would be black.
    with pytest.raises(FormatError, match="run-length encoded BMP is not supported: save it uncompressed, or as PNG"):
        read_map_image(write(bmp(5, 1, 8, b"\2\7\0\0\0\1", compression=1)))


def test_a_damaged_png_is_an_error_that_names_the_file(save, rng):
    path = save(Image.fromarray(rng.integers(0, 256, (60, 60)).astype(np.uint8)))
    content = path.read_bytes()
    for broken in (content[:20], content[:60], content[:-1000], b"\x89PNG" + content[4:30], content[:100] + b"x" * 500):
        path.write_bytes(broken)
        with pytest.raises(FormatError, match=r"a\.png: damaged picture"):
            read_map_image(path)


@pytest.mark.parametrize("extra", [[], [(b"iCCP", b"name")]], ids=["no palette", "short colour profile"])
def test_a_png_whose_chunks_do_not_fit_its_header_is_an_error_that_names_the_file(write, extra):
    # Pillow fails on these with errors of its own that say nothing of the file.
    path = write(png_with_header(2, 2, 8, 3, b"\0ab\0cd", *extra))
    with pytest.raises(FormatError, match=r"a\.pgm: damaged picture: \w+"):
        read_map_image(path)


def test_a_png_with_a_chunk_beyond_its_end_is_refused_before_room_is_made_for_it(write):
    good = png_with_header(2, 2, 8, 0, b"\0ab\0cd")
    assert read_map_image(write(good + b"\xff" * 20)).grey.tolist() == [[97, 98], [99, 100]]
    path = write(good[:33] + b"\x7f\xff\xff\xff" + good[37:])
    with pytest.raises(FormatError, match="truncated, a chunk b'IDAT' declares 2147483647 bytes"):
        read_map_image(path)


def test_a_damaged_animation_is_left_out_in_silence(write):
    path = write(png_with_header(2, 2, 8, 0, b"\0ab\0cd", (b"acTL", bytes(8))))
    assert read_map_image(path).grey.tolist() == [[97, 98], [99, 100]]


def test_a_missing_picture_is_the_file_systems_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_map_image(tmp_path / "none.pgm")
