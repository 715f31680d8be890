"""Mutations keep what they promise to keep, and get past the first check of a reader."""

from __future__ import annotations

import random
import zlib
from collections import Counter
from pathlib import Path

import pytest

from tests.fuzz.mutate import _MUTATORS, mutated
from tests.fuzz.mutate.bag1 import bag1_bytes, bag1_records
from tests.fuzz.mutate.mcap import mcap_bytes, mcap_records
from tests.fuzz.mutate.png import MAGIC, mutate_png, png_bytes, png_chunks
from tests.fuzz.mutate.text import mutate_text
from tests.fuzz.outcome import observe
from tests.fuzz.seeds import bags, maps
from tests.fuzz.target import Target
from tests.fuzz.targets import BY_NAME, TARGETS


def test_what_is_taken_apart_goes_together_again() -> None:
    for case in maps.pictures(".png"):
        content = case.files["m.png"]
        assert png_bytes(png_chunks(content)) == content
    for case in bags.scan_bags("ros1"):
        content = case.files["b.bag"]
        assert bag1_bytes(bag1_records(content[13:]), offsets=True) == content
    content = bags.scan_bags("mcap")[0].files["b.mcap"]
    again = mcap_bytes(mcap_records(content[8:-8]), offsets=True)
    # But for the footer, whose checksum nobody reads.
    assert again[:-36] == content[:-36]


def test_the_checksums_of_changed_pictures_are_right() -> None:
    rng, right, n = random.Random(1), 0, 300
    content = maps.pictures(".png")[0].files["m.png"]
    for _ in range(n):
        changed = mutate_png(content, rng)
        chunks, at = png_chunks(changed), len(MAGIC)
        sums = []
        for kind, data in chunks:
            at += 12 + len(data)
            sums.append(changed[at - 4 : at] == zlib.crc32(kind + data).to_bytes(4, "big"))
        right += all(sums) and bool(chunks)
    assert right > 0.85 * n


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_no_mutator_fails_on_a_valid_file(target: Target) -> None:
    """What a mutator raises on damaged files is caught, which must not hide that it fails on all."""
    rng = random.Random(2)
    for case in target.seeds():
        for name in case.loose:
            content, suffix = case.files[name], name[name.rfind(".") :]
            for mutator in set(_MUTATORS.get(suffix, (mutate_text,))):
                assert any(mutator(content, rng) != content for _ in range(5))


@pytest.mark.parametrize("name", ["bag1", "db3", "mcap", "png", "carmen", "stack_yaml", "launch"])
def test_mutated_files_end_at_many_places(name: str, tmp_path: Path) -> None:
    rng, target = random.Random(3), BY_NAME[name]
    seeds = target.seeds()
    found = Counter(
        outcome.place or outcome.kind for outcome in (observe(target, mutated(seeds, rng), tmp_path) for _ in range(50))
    )
    assert found["ok"] >= 3
    assert len(found) >= 4
    assert max(found.values()) <= 35
