"""Changes to BMP pictures: fields of the two headers, the palette, the length of the pixels."""

from __future__ import annotations

import random

from tests.fuzz.mutate.havoc import overwrite_number


def mutate_bmp(content: bytes, rng: random.Random) -> bytes:
    """Change one field of a BMP picture, or what follows the headers."""
    if rng.random() < 0.75:
        return overwrite_number(content, rng, at=rng.choice((2, 10, 14, 18, 20, 22, 24, 26, 28, 30, 34, 38, 46, 50)))
    return (
        content[: rng.randint(14, max(len(content), 14))] if rng.random() < 0.5 else content + bytes(rng.randint(1, 60))
    )
