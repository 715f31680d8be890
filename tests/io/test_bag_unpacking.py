"""Compressed bags: honest ones are read, bombs are refused before anything makes room for them."""

from __future__ import annotations

import bz2
import sqlite3
import struct
from io import BytesIO
from pathlib import Path

import lz4.frame
import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.bags import unpacking as bag_unpacking
from beamfield.io.bags.bag_file import BagFile
from beamfield.io.bags.reader import read_bag, read_bag_map
from beamfield.io.bags.unpacking import max_unpacked, unpacked_bound
from beamfield.io.read_log import read_log
from tests.io.mini_bag import MiniBag

zstd = bag_unpacking._zstd()

KINDS = [
    ("ros1", "bz2"), ("ros1", "lz4"), ("sqlite3", "file"), ("sqlite3", "message"), ("mcap", "file"),
    ("mcap", "message"), ("mcap", "storage"),
]  # fmt: skip
MEGABYTE = 2**20
REFUSED = "unpacks to more than .* GB: refused as a bomb; .*max_unpacked"


@pytest.fixture
def low_limits(monkeypatch):
    """Let small bombs do."""
    monkeypatch.setattr(bag_unpacking, "FREE_BYTES", MEGABYTE)
    monkeypatch.setattr(bag_unpacking, "MAX_EXPANSION", 20)


def maps(storage: str, n_bytes: int, n: int = 1) -> MiniBag:
    """Maps of free cells, which are zeros."""
    bag = MiniBag(storage)
    for i in range(n):
        bag.grid(1.0 + i, n_bytes, 1, np.zeros(n_bytes, np.int8))
    return bag


def walk(path: Path) -> int:
    """Read all messages; return how many there are."""
    with BagFile(path) as bag:
        return sum(1 for _ in bag.messages(bag.topics))


@pytest.mark.parametrize(("storage", "compression"), KINDS)
def test_compressed_bags_are_read_as_others(storage, compression, tmp_path):
    bag = MiniBag(storage)
    for i in range(40):
        bag.scan(1.0 + i, np.linspace(1.0, 2.0 + i, 500), increment=0.01)
    expected = read_bag(bag.write(tmp_path, "plain"), mount=(0, 0, 0)).only_sensor()
    found = read_bag(bag.write(tmp_path, "packed", compression=compression), mount=(0, 0, 0)).only_sensor()
    np.testing.assert_array_equal(found.ranges, expected.ranges)
    np.testing.assert_array_equal(found.stamps, expected.stamps)


@pytest.mark.parametrize(("storage", "compression"), [(s, c) for s, c in KINDS if s != "ros1"])
def test_compressed_bags_are_read_without_their_metadata(storage, compression, tmp_path):
    path = MiniBag(storage).scan(1.0).scan(2.0).write(tmp_path, "log", compression=compression)
    (path / "metadata.yaml").unlink()
    (file,) = path.iterdir()
    assert len(read_log(path).only_sensor()) == 2
    if file.suffix == ".zstd":
        with zstd.open(file, "rb") as packed:
            file = file.with_suffix("")
            file.write_bytes(packed.read())  # unzstd leaves both
    assert len(read_log(path).only_sensor()) == 2
    assert len(read_log(file).only_sensor()) == 2


@pytest.mark.usefixtures("low_limits")
@pytest.mark.parametrize(("storage", "compression"), KINDS)
def test_a_bomb_is_refused_unless_it_is_allowed(storage, compression, tmp_path):
    path = maps(storage, 8 * MEGABYTE).write(tmp_path, compression=compression)
    with pytest.raises(FormatError, match=REFUSED):
        read_bag_map(path)
    with max_unpacked(0.02):
        assert read_bag_map(path).shape == (1, 8 * MEGABYTE)
    with pytest.raises(FormatError, match=REFUSED):
        read_bag_map(path)


@pytest.mark.usefixtures("low_limits")
@pytest.mark.parametrize(("storage", "compression"), KINDS)
def test_many_chunks_are_a_bomb_together(storage, compression, tmp_path):
    path = maps(storage, MEGABYTE // 4, 40).write(tmp_path, compression=compression)
    with pytest.raises(FormatError, match=REFUSED):
        walk(path)


@pytest.mark.parametrize(("storage", "compression"), KINDS)
def test_a_chunk_that_does_not_fit_into_memory_is_refused_in_large_bags_too(
    storage, compression, tmp_path, monkeypatch
):
    monkeypatch.setattr(bag_unpacking, "MAX_CHUNK_BYTES", 3 * MEGABYTE)
    path = maps(storage, 8 * MEGABYTE).write(tmp_path, compression=compression)
    if compression == "file":
        walk(path)  # it is unpacked piece by piece, to a disk
    else:
        with pytest.raises(FormatError, match="one chunk of it " + REFUSED):
            walk(path)


@pytest.mark.usefixtures("low_limits")
def test_the_option_of_the_command_line_is_named_and_allows_more(tmp_path, capsys):
    path = str(maps("ros1", 8 * MEGABYTE).write(tmp_path, compression="lz4"))
    assert main(["inspect", path]) == 1
    assert "allow more gigabytes with --max-unpacked" in capsys.readouterr().err
    assert main(["inspect", path, "--max-unpacked", "0.02"]) == 0


@pytest.mark.parametrize("bad", ["much", -1, 0, float("nan"), float("inf"), True, None])
def test_a_limit_that_is_no_number_is_an_error(bad):
    with pytest.raises(InvalidInputError, match="expected a positive number of gigabytes, got "), max_unpacked(bad):
        pass


def test_an_unpacked_file_is_removed_and_what_a_killed_run_left_as_well(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    path = maps("mcap", 1000).write(tmp_path, compression="file")
    with BagFile(path):
        (scratch,) = (tmp_path / "temporary").iterdir()
        assert scratch.stat().st_mode & 0o777 == 0o700
    assert not list((tmp_path / "temporary").iterdir())
    path.joinpath("log.mcap.zstd").write_bytes(b"no zstd")
    with pytest.raises(FormatError, match="damaged or truncated"):
        walk(path)
    assert not list((tmp_path / "temporary").iterdir())


# --------------------------------------------------------------------------------------------------- MCAP by hand


def record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def chunk(packed: bytes, compression: bytes, claimed: int) -> bytes:
    return record(
        0x06, struct.pack("<QQQI", 1, 2, claimed, 0) + text(compression) + struct.pack("<Q", len(packed)) + packed
    )


def mcap(data: bytes, summary: bytes = b"") -> bytes:
    body = b"\x89MCAP0\r\n" + record(0x01, text(b"ros2") + text(b"by hand")) + data
    start = len(body) if summary else 0
    return body + summary + record(0x02, struct.pack("<QQI", start, 0, 0)) + b"\x89MCAP0\r\n"


ZEROS = bytes(8 * MEGABYTE)
BOMBS = {
    "zstd": (b"zstd", zstd.compress(ZEROS)),
    "zstd, frame by frame": (b"zstd", zstd.compress(ZEROS[: MEGABYTE // 2]) * 16),
    "zstd behind what is skipped": (b"zstd", struct.pack("<II", 0x184D2A53, 3) + b"abc" + zstd.compress(ZEROS)),
    "lz4": (b"lz4", lz4.frame.compress(ZEROS)),
    "lz4, small blocks with checksums": (
        b"lz4", lz4.frame.compress(ZEROS, block_size=lz4.frame.BLOCKSIZE_MAX64KB, block_checksum=True),
    ),
}  # fmt: skip


@pytest.mark.usefixtures("low_limits")
@pytest.mark.parametrize("claimed", [100, 2**40])
@pytest.mark.parametrize("name", BOMBS)
def test_a_chunk_is_judged_by_its_content_whatever_it_claims(tmp_path, name, claimed):
    compression, packed = BOMBS[name]
    (tmp_path / "a.mcap").write_bytes(mcap(chunk(packed, compression, claimed)))
    with pytest.raises(FormatError, match=f"a.mcap: .*{REFUSED}"):
        walk(tmp_path / "a.mcap")


@pytest.mark.usefixtures("low_limits")
@pytest.mark.parametrize("hidden", [False, True])
def test_chunks_of_the_index_count_each_time_and_wherever_they_are(tmp_path, hidden):
    one = chunk(zstd.compress(ZEROS[: MEGABYTE - 10]), b"zstd", MEGABYTE - 10)
    before = record(0x09, one)[: 9 if hidden else 0]
    data = before + one
    start = len(mcap(b"")) - 37 + len(before)
    entry = struct.pack("<QQQQI", 1, 2, start, len(one), 0) + struct.pack("<Q", 0) + text(b"zstd")
    entry += struct.pack("<QQ", len(one) - 9 - 40 - 4, MEGABYTE - 10)
    (tmp_path / "a.mcap").write_bytes(mcap(data, record(0x08, entry) * 2))
    with pytest.raises(FormatError, match=f"a.mcap: .*{REFUSED}"):
        walk(tmp_path / "a.mcap")


@pytest.mark.usefixtures("low_limits")
def test_a_bomb_in_a_packed_file_is_measured_by_what_the_user_was_given(tmp_path):
    path = maps("mcap", 1000).write(tmp_path, compression="file")
    inner = mcap(chunk(zstd.compress(ZEROS), b"zstd", 100) + record(0x0F, bytes(MEGABYTE // 2)))
    assert 20 * len(inner) > len(ZEROS)
    packed = path.joinpath("log.mcap.zstd").write_bytes(zstd.compress(inner))
    with pytest.raises(FormatError, match=f"log/log.mcap.zstd: {packed} bytes, .*{REFUSED}"):
        walk(path)


# --------------------------------------------------------------------------------------------------------- the bounds


def streamed(data: bytes) -> bytes:
    """Return a frame whose header says nothing of its size."""
    stream = zstd.ZstdCompressor()
    return b"".join([stream.compress(data[i : i + 70_000]) for i in range(0, len(data), 70_000)] + [stream.flush()])


def test_bounds_hold_and_are_not_far_off(rng):
    for size in (0, 1, 255, 256, 300, 5_000, 65_791, 65_792, 128 * 1024, 400_000, 3_000_000):
        for data in (bytes(size), rng.bytes(size), np.cumsum(rng.integers(-1, 2, size), dtype=np.uint8).tobytes()):
            for packed in (zstd.compress(data, 1), zstd.compress(data, 12), streamed(data)):
                bound = unpacked_bound(BytesIO(b"before" + packed), 6, len(packed), "zstd", enough=2**40)
                assert size <= bound <= 20 * size + 128 * 1024  # blocks need not be full
            for options in (
                {},
                {"block_linked": False, "content_checksum": True},
                {"block_size": 5, "store_size": False},
            ):
                packed = lz4.frame.compress(data, **options)
                bound = unpacked_bound(BytesIO(b"before" + packed), 6, len(packed), "lz4", enough=2**40)
                assert size <= bound <= size + 4 * MEGABYTE


def test_a_chunk_is_not_refused_for_blocks_that_are_not_full(rng, monkeypatch, tmp_path):
    data = np.cumsum(rng.integers(-1, 2, 3_000_000), dtype=np.uint8).tobytes()
    packed = zstd.compress(data, 12)
    assert unpacked_bound(BytesIO(packed), 0, len(packed), "zstd", enough=2**40) > 2 * len(data)
    monkeypatch.setattr(bag_unpacking, "FREE_BYTES", len(data))
    monkeypatch.setattr(bag_unpacking, "MAX_EXPANSION", 1)
    (tmp_path / "a.mcap").write_bytes(mcap(chunk(packed, b"zstd", len(data))))
    bag_unpacking.check_storage(tmp_path / "a.mcap")
    monkeypatch.setattr(bag_unpacking, "FREE_BYTES", len(data) - 1)
    with pytest.raises(FormatError, match=REFUSED):
        bag_unpacking.check_storage(tmp_path / "a.mcap")


def test_a_repeated_byte_of_two_megabytes_is_counted_as_such():
    # One block may claim 2^21 - 1 bytes; some libraries refuse it, others do not.
    frame = struct.pack("<IBB", 0xFD2FB528, 0, 0) + struct.pack("<I", (2**21 - 1) << 3 | 1 << 1 | 1)[:3] + b"\0"
    assert unpacked_bound(BytesIO(frame), 0, len(frame), "zstd", enough=2**40) == 2**21 - 1


@pytest.mark.parametrize("kind", ["zstd", "lz4"])
def test_damage_ends_the_count(rng, kind):
    packed = {"zstd": zstd.compress, "lz4": lz4.frame.compress}[kind](rng.bytes(300_000))
    for _ in range(300):
        damaged = bytearray(packed[: rng.integers(len(packed))])
        for where in rng.integers(0, max(1, min(40, len(damaged))), 3 if damaged else 0):
            damaged[where] = rng.integers(256)
        assert unpacked_bound(BytesIO(damaged), 0, len(damaged), kind, enough=2**20) >= 0


def test_a_bzip2_stream_that_ends_early_is_damage(tmp_path):
    path = maps("ros1", 100_000).write(tmp_path, compression="bz2")
    content = path.read_bytes()
    start = content.index(b"BZh")
    size = struct.unpack("<I", content[start - 4 : start])[0]
    assert len(bz2.decompress(content[start : start + size])) > 100_000
    cut = content[start : start + size].ljust(size)[: size - 8]
    path.write_bytes(content[:start] + cut + b"\0" * 8 + content[start + size :])
    with pytest.raises(FormatError, match="damaged or truncated"):
        walk(path)


# ------------------------------------------------------------------------------------------------------------- SQLite


@pytest.mark.parametrize("trick", [
    "CREATE TABLE messages(id, topic_id, timestamp, data AS (zeroblob(900000000)))",
    "CREATE VIEW messages AS SELECT 1 AS id, 1 AS topic_id, 1 AS timestamp, zeroblob(900000000) AS data",
    "CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)",
])  # fmt: skip
def test_a_database_that_makes_up_its_messages_is_refused(tmp_path, trick):
    path = maps("sqlite3", 100).write(tmp_path)
    with sqlite3.connect(path / "log.db3") as base:
        base.execute("DROP TABLE messages")
        base.execute(trick)
    base.close()
    with pytest.raises(FormatError, match=r"log\.db3: expected plain tables, but '.*' is computed on reading"):
        walk(path)


def test_a_database_with_a_text_for_a_time_is_refused(tmp_path):
    path = MiniBag("sqlite3").scan(1.0).scan(2.0).write(tmp_path)
    with sqlite3.connect(path / "log.db3") as base:
        base.execute("UPDATE messages SET timestamp = 'noon' WHERE id = 2")
    base.close()
    with pytest.raises(FormatError, match="/scan, message 2: expected the receive time in nanoseconds, got 'noon'"):
        read_bag(path)
