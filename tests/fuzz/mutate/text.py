"""Changes to text: numbers, counts, words, lines, encodings."""

from __future__ import annotations

import random
import re
from collections.abc import Sequence

_WORD = re.compile(rb"[^\s,;=<>\"'\[\]{}():]+")
_NUMBER = re.compile(rb"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
NUMBERS = (
    b"0", b"-0", b"1", b"-1", b"2", b"180", b"181", b"361", b"682", b"1e3", b"0.5", b"-0.25", b"1e9", b"1e10", b"-1e12",
    b"1e38", b"1e99", b"1e100", b"1e154", b"1e155", b"1e200", b"1.7e308", b"-1.7e308", b"1e309", b"5e-324", b"1e-310",
    b"1e-160", b"nan", b"-nan", b"NaN", b"inf", b"-inf", b"Infinity", b".inf", b".nan", b"2147483647", b"2147483648",
    b"4294967296", b"999999999", b"9007199254740993", b"9223372036854775807", b"9223372036854775808", b"1" * 30,
    b"9" * 310, b"9" * 5000, b"0" * 5000 + b"1", b"1_0", b"0x10", b"0b1", b"0o7", b"1.", b".5", b".", b"-", b"+5",
    b"--1",
    b"1e", b"1e+", b"1,5", b"1d3", "\u0663".encode(), "\uff11".encode(), b"\xb2", b"1\x00", b"1:30",
    b"3.14159265358979",
    b"6.2832", b"-7", b"8191", b"81.91", b"100000",
)  # fmt: skip
WORDS = (
    b"x", b"#", b"%", b"//", b"ODOM", b"PARAM", b"FLASER", b"ROBOTLASER1", b"RAWLASER1", b"RLASER", b"TRUEPOS", b"O",
    b"L",
    b"VERTEX_SE2", b"SM_UPDATE", b"RESAMPLE", b"true", b"null", b"None", b"\x1b[31m", b"\xe9", "\u202e".encode(),
    b"A" * 300,
    b"{}", b"%(a)s", b"$(arg x)", b"..", b"\xff\xfe", b"stamp", b"good", b"scan_index", b"theta", b"id",
)  # fmt: skip
_ENDS = (b"\n", b"\r\n", b"\r", b"\x0b", b"\x0c", b"\x1c", b"\x85", b"\xc2\x85", b"\xe2\x80\xa8", b"\n\n", b"")
_INSERTS = (b"\xef\xbb\xbf", b"\x00", b"\xff", b"\xa0", b"\t", b"  ", b"#", b",", b",,", b"\x1a", b'"', b"\x7f", b"\\")


def mutate_text(content: bytes, rng: random.Random) -> bytes:
    """Change one thing of a text file."""
    return rng.choice(_STEPS)(content, rng)


def odd_number(old: bytes, rng: random.Random) -> bytes:
    """Return another number, often near the old one."""
    if rng.random() < 0.4 and _NUMBER.fullmatch(old) and len(old) < 20:
        value = float(old)
        near = rng.choice((value + 1, value - 1, value * 10, -value, value + 0.003, value / 2, value * 1.0000001))
        return (str(int(near)) if old.isdigit() and abs(near) < 1e15 else repr(near)).encode()
    return rng.choice(NUMBERS)


def _number(content: bytes, rng: random.Random) -> bytes:
    found = [match for match in _words(content, rng) if _NUMBER.fullmatch(match.group())]
    return _replaced(content, found, rng, odd_number)


def _word(content: bytes, rng: random.Random) -> bytes:
    def other(old: bytes, rng: random.Random) -> bytes:
        return rng.choice((b"", old + old, old[:-1], old.upper(), old + b"x", old + b" " + old, *WORDS, *NUMBERS))

    return _replaced(content, _words(content, rng), rng, other)


def _columns(content: bytes, rng: random.Random) -> bytes:
    """Change the same word of every line: a column of numbers that is odd as a whole."""
    index, value = rng.randint(0, 12), rng.choice(NUMBERS)
    lines = []
    for line in content.split(b"\n"):
        words = list(_WORD.finditer(line))
        if index < len(words) and _NUMBER.fullmatch(words[index].group()):
            start, stop = words[index].span()
            line = line[:start] + value + line[stop:]
        lines.append(line)
    return b"\n".join(lines)


def _swap_words(content: bytes, rng: random.Random) -> bytes:
    found = _words(content, rng)
    if len(found) < 2:
        return content
    one, two = sorted(rng.sample(range(len(found)), 2))
    (a, b), (c, d) = found[one].span(), found[two].span()
    return content[:a] + content[c:d] + content[b:c] + content[a:b] + content[d:]


def _lines(content: bytes, rng: random.Random) -> bytes:
    lines = content.split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    step = rng.randrange(6)
    if step == 0:
        del lines[i]
    elif step == 1:
        lines.insert(j, lines[i])
    elif step == 2:
        lines[i], lines[j] = lines[j], lines[i]
    elif step == 3:
        lines[i] = lines[i][: rng.randint(0, len(lines[i]))]
    elif step == 4:
        lines[i:i] = [lines[i]] * rng.choice((2, 10, 60))
    else:
        lines = lines[: i + 1]
    return b"\n".join(lines)


def _line_ends(content: bytes, rng: random.Random) -> bytes:
    end = rng.choice(_ENDS)
    if rng.random() < 0.5:
        return content.replace(b"\n", end)
    return content.replace(b"\n", end, rng.randint(1, 3))


def _insert(content: bytes, rng: random.Random) -> bytes:
    place = rng.choice((0, len(content), rng.randint(0, len(content))))
    return content[:place] + rng.choice(_INSERTS) + content[place:]


def _encoding(content: bytes, rng: random.Random) -> bytes:
    text = content.decode("latin-1")
    return rng.choice((
        text.encode("utf-16"), text.encode("utf-16-le"), text.encode("utf-8-sig"), text.encode("utf-8") + b"\xe9",
        text.encode("utf-32"), content.replace(b" ", b"\xc2\xa0", 3), content[::-1],
    ))  # fmt: skip


def _long_line(content: bytes, rng: random.Random) -> bytes:
    found = _words(content, rng)
    if not found:
        return content
    # Rarely beyond the longest line that is read.
    n = 1_500_000 if rng.random() < 0.004 else rng.choice((100, 1000, 5000))
    start, stop = rng.choice(found).span()
    return content[:start] + content[start:stop][:8] * 1 + (b" " + content[start:stop][:6]) * n + content[stop:]


def _words(content: bytes, rng: random.Random) -> Sequence[re.Match[bytes]]:
    """Return the words of the content, of some part of it if it is long."""
    start = 0 if len(content) < 6000 or rng.random() < 0.4 else rng.randrange(len(content))
    return [match for match, _ in zip(_WORD.finditer(content, start), range(800), strict=False)]


def _replaced(content: bytes, found: Sequence[re.Match[bytes]], rng: random.Random, other: object) -> bytes:
    if not found:
        return content
    match = rng.choice(found)
    return content[: match.start()] + other(match.group(), rng) + content[match.end() :]  # type: ignore[operator]


_STEPS = (
    *(_number,) * 8, *(_word,) * 4, *(_lines,) * 4, _columns, _columns, _swap_words, _line_ends, _insert, _insert,
    _encoding, _long_line,
)  # fmt: skip
