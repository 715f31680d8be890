"""Changes to serialised ROS messages: numbers, counts of sequences, lengths of texts, the end."""

from __future__ import annotations

import random
import re
import struct

from tests.fuzz.mutate.havoc import NASTY, REAL, WHOLE, havoc, overwrite_number

_TEXT = re.compile(rb"[a-zA-Z_/][a-zA-Z0-9_/]{2,}")
_FIELD = re.compile(rb"[\w/]+(\[\d*\])? \w+")
_TYPES = (
    b"int32", b"uint8", b"int64", b"float32", b"float64", b"string", b"bool", b"time", b"duration", b"char", b"wstring",
    b"float32[]", b"float64[]", b"string[]", b"uint8[3]", b"float32[100000000]", b"int8[]", b"Header",
    b"std_msgs/Header",
    b"geometry_msgs/Point", b"builtin_interfaces/Time", b"nothing/Nothing", b"string<=5", b"float32[<=2]",
    b"float32[-1]",
)  # fmt: skip
_NAMES = (
    b"map", b"odom", b"base_link", b"base_footprint", b"laser", b"camera", b"/laser", b"//", b"", b"\xff", b"\x00",
    b"\x1b[2J",
    b"x" * 400, "\u202e".encode(),
)  # fmt: skip


def mutate_message(data: bytes, rng: random.Random) -> bytes:
    """Change one thing of a message."""
    step = rng.randrange(10)
    if step <= 3 and len(data) > 12:
        place = rng.randrange(4, len(data) - 3) & ~3
        width, code = rng.choice(((4, "<f"), (8, "<d")))
        return data[:place] + _packed(code, rng.choice(REAL)) + data[place + width :]
    if step <= 5 and len(data) > 8:
        place = rng.randrange(0, len(data) - 3) & ~3
        return data[:place] + struct.pack("<I", rng.choice(WHOLE) % 2**32) + data[place + 4 :]
    if step == 6:
        return overwrite_number(data, rng)
    if step == 7:
        return _renamed(data, rng)
    if step == 8:
        return data[: rng.randint(0, len(data))] if rng.random() < 0.6 else data + rng.randbytes(rng.randint(1, 40))
    return havoc(data, rng)


def mutate_definition(text: bytes, rng: random.Random) -> bytes:
    """Change one field of a message's definition."""
    lines = text.split(b"\n")
    fields = [i for i, line in enumerate(lines) if _FIELD.fullmatch(line)]
    if not fields:
        return havoc(text, rng)
    i, j = rng.choice(fields), rng.choice(fields)
    kind, _, name = lines[i].partition(b" ")
    step = rng.randrange(6)
    if step <= 2:
        lines[i] = rng.choice(_TYPES) + b" " + name
    elif step == 3:
        lines[i] = (
            kind
            + b" "
            + rng.choice((b"other", b"", b"class", b"_x", b"A", name + b" " + name, b"header", b"stamp", b"x"))
        )
    elif step == 4:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i : i + 1] = rng.choice(([], [lines[i]] * 2, [lines[i], b"uint8 EXTRA=3"], [lines[i], b"int32 more"]))
    return b"\n".join(lines)


def _renamed(data: bytes, rng: random.Random) -> bytes:
    """Give a text of the message another value of its own length, or of another with its count."""
    found = list(_TEXT.finditer(data))
    if not found:
        return data
    match = rng.choice(found)
    start, stop = match.span()
    name = rng.choice((*_NAMES, *NASTY))
    if rng.random() < 0.5 or start < 4:
        return data[:start] + name[: stop - start].ljust(stop - start, b"_") + data[stop:]
    # ROS 2 counts the zero at the end, ROS 1 has none.
    ends = data[stop : stop + 1] == b"\0"
    return data[: start - 4] + struct.pack("<I", len(name) + ends) + name + data[stop:]


def _packed(code: str, value: float) -> bytes:
    try:
        return struct.pack(code, value)
    except OverflowError:
        return struct.pack(code, float("inf"))
