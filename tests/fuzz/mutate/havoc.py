"""Changes that know nothing of a format: bits, bytes, numbers, blocks."""

from __future__ import annotations

import random
import struct
from typing import TypeVar

T = TypeVar("T")
WHOLE = (
    0, 1, 2, 3, 4, 7, 8, 16, 31, 32, 64, 100, 127, 128, 255, 256, 512, 1000, 1024, 4096, 32767, 32768, 65535, 65536,
    2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1,
)  # fmt: skip
REAL = (
    0.0, -0.0, 1.0, -1.0, 0.5, 1e-9, -1e-9, 1e-38, 5e-324, 1e9, 1e10, 1e38, 1e100, 1e155, 1e300, 1.7e308, -1e300,
    float("inf"), float("-inf"), float("nan"), 3.14159, 6.3, 1e3, -1e3, 81.91, 0.1,
)  # fmt: skip
NASTY = (b"", b"\0", b"\xff", b"\n", b"\r", b"\x80", b" ", b"'", b'"', b"%s", b"\xef\xbb\xbf", b"\x1b[2J", b"/../")
_SIZES = ((1, "B"), (2, "H"), (4, "I"), (8, "Q"))


def havoc(content: bytes, rng: random.Random) -> bytes:
    """Change a few places of any content."""
    for _ in range(1 + int(rng.expovariate(1.0))):
        content = rng.choice(_STEPS)(content, rng)
    return content


def overwrite_number(content: bytes, rng: random.Random, *, at: int | None = None, big: bool = False) -> bytes:
    """Put an odd number of 1 to 8 bytes, or of floating point, somewhere; the length stays."""
    if not content:
        return content
    size, code = rng.choice(_SIZES)
    # Numbers of most formats begin at multiples of four.
    place = rng.randrange(len(content)) if at is None else at
    if at is None and rng.random() < 0.7:
        place -= place % min(size, 4)
    order = ">" if big else "<"
    if size >= 4 and rng.random() < 0.35:
        packed = _real(rng.choice(REAL), size, order)
    elif rng.random() < 0.3 and place + size <= len(content):
        (old,) = struct.unpack_from(order + code, content, place)
        packed = struct.pack(order + code, (old + rng.choice((-8, -4, -2, -1, 1, 2, 4, 8))) % 2 ** (8 * size))
    else:
        packed = struct.pack(order + code, rng.choice(WHOLE) % 2 ** (8 * size))
    return content[:place] + packed[: len(content) - place] + content[place + size :]


def reordered(items: list[T], rng: random.Random, first: int = 0) -> list[T]:
    """Leave out an item from number `first` on, put one elsewhere once more, or let two change places."""
    i, j = rng.randrange(first, len(items)), rng.randrange(first, len(items))
    step = rng.randrange(3)
    if step == 0:
        return items[:i] + items[i + 1 :]
    if step == 1:
        return [*items[:j], items[i], *items[j:]]
    changed = list(items)
    changed[i], changed[j] = changed[j], changed[i]
    return changed


def _real(value: float, size: int, order: str) -> bytes:
    if size == 8:
        return struct.pack(order + "d", value)
    try:
        return struct.pack(order + "f", value)
    except OverflowError:
        return struct.pack(order + "f", float("inf"))


def _flip(content: bytes, rng: random.Random) -> bytes:
    if not content:
        return content
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _byte(content: bytes, rng: random.Random) -> bytes:
    if not content:
        return content
    place = rng.randrange(len(content))
    return content[:place] + bytes([rng.randrange(256)]) + content[place + 1 :]


def _truncate(content: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.5:
        return content[: max(0, len(content) - rng.randint(1, 40))]
    return content[: rng.randint(0, len(content))]


def _delete(content: bytes, rng: random.Random) -> bytes:
    place, length = _span(content, rng)
    return content[:place] + content[place + length :]


def _repeat(content: bytes, rng: random.Random) -> bytes:
    place, length = _span(content, rng)
    times = rng.choice((1, 1, 1, 2, 10, 100))
    return content[: place + length] + content[place : place + length] * times + content[place + length :]


def _move(content: bytes, rng: random.Random) -> bytes:
    place, length = _span(content, rng)
    rest = content[:place] + content[place + length :]
    to = rng.randint(0, len(rest))
    return rest[:to] + content[place : place + length] + rest[to:]


def _insert(content: bytes, rng: random.Random) -> bytes:
    place = rng.randint(0, len(content))
    piece = rng.choice(NASTY) if rng.random() < 0.7 else rng.randbytes(rng.randint(1, 16))
    return content[:place] + piece + content[place:]


def _span(content: bytes, rng: random.Random) -> tuple[int, int]:
    place = rng.randint(0, len(content))
    return place, min(rng.choice((1, 1, 2, 4, 8, 32, 256, 4096)), len(content) - place)


_STEPS = (_flip, _flip, _byte, overwrite_number, overwrite_number, _truncate, _delete, _repeat, _move, _insert)
