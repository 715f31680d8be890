"""Changes to PGM pictures: numbers of the header, comments, blanks, missing and extra pixels."""

from __future__ import annotations

import random
import re

_HEADER = re.compile(rb"(P\d)(\s+)(?:#[^\n]*\n)?(\S+)(\s+)(\S+)(\s+)(\S+)(\s)")
NUMBERS = (
    b"0", b"1", b"2", b"3", b"6", b"7", b"15", b"100", b"254", b"255", b"256", b"1000", b"32768", b"65535", b"65536",
    b"20000",
    b"400000001", b"99999", b"999999999", b"9999999999", b"-1", b"+4", b"4.0", b"1e2", b"0x4", b"x", b"", b"00000004",
    b"4 4",
)  # fmt: skip
BLANKS = (
    b" ",
    b"\n",
    b"\t",
    b"\r\n",
    b"\r",
    b"\v\f",
    b"#c\n",
    b" # c\n ",
    b"#\r",
    b"  \n\n",
    b"",
    b"#",
    b"#" + b"x" * 70_000 + b"\n",
)


def mutate_pgm(content: bytes, rng: random.Random) -> bytes:
    """Change one thing of a PGM picture."""
    match = _HEADER.match(content)
    step = rng.randrange(6)
    if match is None or step == 0:
        cut = rng.randint(0, min(len(content), 40))
        return content[: len(content) - cut] if rng.random() < 0.6 else content + content[-cut:]
    parts, pixels = list(match.groups()), content[match.end() :]
    if step <= 2:
        parts[rng.choice((2, 4, 6))] = rng.choice(NUMBERS)
    elif step == 3:
        parts[rng.choice((1, 3, 5, 7))] = rng.choice(BLANKS)
    elif step == 4:
        parts[0] = rng.choice((b"P1", b"P2", b"P3", b"P4", b"P5", b"P6", b"P7", b"p5"))
    else:
        words = pixels.split(b" ")
        words[rng.randrange(len(words))] = rng.choice((*NUMBERS, b"# c\n3", b"\x00", b"\xff\xff"))
        pixels = b" ".join(words)
    return b"".join(parts) + pixels
