"""Changes to the content of files that keep enough of its structure to get deep into a reader."""

from __future__ import annotations

import gzip
import random
import struct
import zlib
from collections.abc import Callable, Sequence

from tests.fuzz.case import Case
from tests.fuzz.mutate.bag1 import mutate_bag1
from tests.fuzz.mutate.bmp import mutate_bmp
from tests.fuzz.mutate.havoc import havoc
from tests.fuzz.mutate.mcap import mutate_mcap
from tests.fuzz.mutate.pgm import mutate_pgm
from tests.fuzz.mutate.png import mutate_png
from tests.fuzz.mutate.sqlite import mutate_sqlite
from tests.fuzz.mutate.text import mutate_text
from tests.fuzz.mutate.xml import mutate_xml
from tests.fuzz.mutate.yaml import mutate_yaml

Mutator = Callable[[bytes, random.Random], bytes]

# By the end of the name; how much each mutator is worth.
_MUTATORS: dict[str, tuple[Mutator, ...]] = {
    ".yaml": (mutate_yaml, mutate_yaml, mutate_yaml, mutate_text),
    ".pgm": (mutate_pgm, mutate_pgm),
    ".png": (mutate_png, mutate_png, mutate_png),
    ".bmp": (mutate_bmp, mutate_bmp),
    ".launch": (mutate_xml, mutate_xml, mutate_text),
    ".bag": (mutate_bag1,) * 5,
    ".mcap": (mutate_mcap,) * 5,
    ".db3": (mutate_sqlite,) * 3,
}
_LONGEST = 2**20


def mutated(pool: Sequence[Case], rng: random.Random) -> Case:
    """Return one case of a pool, changed in one place or a few."""
    case = rng.choice(pool)
    for _ in range(min(1 + int(rng.expovariate(0.8)), 6)):
        name = rng.choice(case.loose)
        content = case.files[name]
        if rng.random() < 0.03:
            content = _spliced(content, rng.choice(pool).files.get(name, content), rng)
        else:
            content = _changed(name, content, rng)
        if len(content) <= _LONGEST or rng.random() < 0.02:
            case = case.changed(name, content)
    return case


def _changed(name: str, content: bytes, rng: random.Random) -> bytes:
    if content[:2] == b"\x1f\x8b" and rng.random() < 0.8:
        return _repacked(name, content, rng)
    suffix = name[name.rfind(".") :]
    if suffix == ".zstd":
        return havoc(content, rng)
    try:
        return rng.choice((*_MUTATORS.get(suffix, (mutate_text,) * 4), havoc))(content, rng)
    except (struct.error, ValueError, IndexError):  # what was changed before may have lost its structure
        return havoc(content, rng)


def _repacked(name: str, content: bytes, rng: random.Random) -> bytes:
    """Change what a gzip file holds."""
    try:
        inner = gzip.decompress(content)
    except (OSError, EOFError, zlib.error):
        return havoc(content, rng)
    return gzip.compress(_changed(name.removesuffix(".gz"), inner, rng), 1, mtime=0)


def _spliced(one: bytes, other: bytes, rng: random.Random) -> bytes:
    return one[: rng.randint(0, len(one))] + other[rng.randint(0, len(other)) :]
