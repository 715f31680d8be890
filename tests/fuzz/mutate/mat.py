"""Changes to MATLAB 5 files: elements, dimensions, types, sizes, and what is below the compression."""

from __future__ import annotations

import random
import struct
import zlib

from tests.fuzz.mutate.havoc import REAL, havoc, overwrite_number

_COMPRESSED = 15


def mutate_mat(content: bytes, rng: random.Random) -> bytes:
    """Change one thing of a MATLAB file."""
    step = rng.randrange(8)
    elements = _elements(content)
    if step <= 1 or not elements:
        # Tags and numbers stand at multiples of eight.
        place = 128 + 8 * rng.randrange(max(1, (len(content) - 128) // 8))
        return overwrite_number(content, rng, at=min(place + rng.choice((0, 4)), len(content)))
    if step <= 3:
        place = 128 + 8 * rng.randrange(max(1, (len(content) - 128) // 8))
        return content[:place] + struct.pack("<d", rng.choice(REAL)) + content[place + 8 :]
    i, j = rng.randrange(len(elements)), rng.randrange(len(elements))
    if step == 4:
        elements[i], elements[j] = elements[j], elements[i]
    elif step == 5:
        elements = elements[:i] + elements[i + 1 :] if rng.random() < 0.5 else [*elements, elements[i]]
    else:
        elements[i] = _repacked(elements[i], rng)
    return content[:128] + b"".join(elements)


def _elements(content: bytes) -> list[bytes]:
    elements, at = [], 128
    while at + 8 <= len(content):
        _, size = struct.unpack_from("<II", content, at)
        elements.append(content[at : at + 8 + size])
        at += 8 + size
    return elements


def _repacked(element: bytes, rng: random.Random) -> bytes:
    """Change what a compressed element holds; compress one that is not."""
    kind = struct.unpack_from("<I", element)[0]
    inner = element
    if kind == _COMPRESSED:
        try:
            inner = zlib.decompress(element[8:])
        except zlib.error:
            return havoc(element, rng)
    inner = overwrite_number(inner, rng) if rng.random() < 0.6 else havoc(inner, rng)
    packed = zlib.compress(inner, 1)
    return struct.pack("<II", _COMPRESSED, len(packed)) + packed
