"""Changes to YAML written in lines: keys, values and their types, nesting, anchors, documents."""

from __future__ import annotations

import random
import re

from tests.fuzz.mutate.text import odd_number

_PAIR = re.compile(rb"^(\s*(?:- )?)([^\s:#][^:#]*):([ \t]+(.*))?$")
VALUES = (
    b"", b"~", b"null", b"true", b"false", b"yes", b"on", b"No", b"'1'", b'"0.5"', b"[]", b"{}", b"[1, 2]",
    b"[1, 2, 3]",
    b"[1, 2, 3, 4]", b"[[1], 2]", b"{a: 1}", b"{a: {b: [1]}}", b"[nan, inf, 0]", b"[.nan, .inf, 0]",
    b"[1e308, -1e308, 1e9]",
    b"&a 1", b"*a", b"&a [*a]", b"!!python/object:os.system [ls]", b"!!binary aGk=", b"!!float 1", b"!!int 1.5",
    b"!!str 1",
    b"!!set {a, b}", b"!!timestamp 2001-01-01", b"!foo 3", b"!<tag:x> 1", b"2001-12-14t21:59:43.10-05:00",
    b"2001-99-99",
    b"0x1F", b"0o17", b"017", b"0b11", b"1_000", b"1:30", b"1:30.5", b"1e3", b"1.e+3", b".5", b"-.5e-3", b"+1",
    b"- 1", b"|",
    b">", b"|2", b"|\n  text", b"'unclosed", b'"unclosed', b'"\\x00"', b'"\\ud800"', b'"\\U0010ffff"', b'"\\x1b[2J"',
    b"<<: *a",
    b"? a", b"@x", b"`x`", b"%x", b"#x", b"a: b", b"a: b: c", b"=", b"<<", b"[" * 30, b"[" * 300, b"{a: " * 60,
    b"0." + b"1" * 400,
    b"9" * 5000, b"-" + b"9" * 400, b"trinary", b"scale", b"raw", b"beam", b"likelihood_field",
    b"likelihood_field_prob",
    b"nav2_amcl::x", b"../m.pgm", b"/dev/null", b"m.pgm/", b".", b"..", b'""', b"~/x.pgm", b"~nobody/x", b'"a\\0b"',
    b"x" * 5000,
)  # fmt: skip
_HEADS = (b"%YAML 1.1\n---\n", b"%YAML 9.9\n---\n", b"%TAG ! tag:x,2000:\n---\n", b"---\n", b"--- |\n", b"\xef\xbb\xbf")
_TAILS = (
    b"\n---\na: 1\n",
    b"\n...\n",
    b"\n...\nx",
    b"\n---\n",
    b"\n\t",
    b"\n- 1\n",
    b"\n? [a, b]\n: c\n",
    b"\n<<: {a: 1}\n",
)


def mutate_yaml(content: bytes, rng: random.Random) -> bytes:
    """Change one thing of a YAML file."""
    lines = content.split(b"\n")
    pairs = [i for i, line in enumerate(lines) if _PAIR.match(line)]
    step = rng.randrange(12)
    if not pairs or step == 0:
        return rng.choice((rng.choice(_HEADS) + content, content + rng.choice(_TAILS)))
    i = rng.choice(pairs)
    match = _PAIR.match(lines[i])
    assert match is not None
    indent, key, value = match[1], match[2], match[4] or b""
    if step <= 3:
        lines[i] = indent + key + b": " + rng.choice(VALUES)
    elif step <= 5:
        lines[i] = indent + key + b": " + _with_number(value, rng)
    elif step == 6:
        del lines[i]
    elif step == 7:
        lines.insert(rng.randint(0, len(lines)), lines[i])
    elif step == 8:
        lines[i] = indent + rng.choice((b"1", b"~", b"'" + key + b"'", b"? " + key, b"<<", key + b"_", b"&b " + key,
        b"[a]",
                                        b"true", key + b" ", b"\xe9", b"2001-01-01",
                                        b"*a")) + b": " + value  # fmt: skip
    elif step == 9:
        lines[i] = indent + key + b":\n" + indent.replace(b"-", b" ") + b"  nested:" + (b" " + value if value else b"")
    elif step == 10:
        shift = rng.choice((b" ", b"  ", b"\t", b"- "))
        last = rng.randint(i, min(len(lines) - 1, i + 6))
        lines[i : last + 1] = [shift + line for line in lines[i : last + 1]]
    else:
        j = rng.choice(pairs)
        other = _PAIR.match(lines[j])
        assert other is not None
        lines[i] = indent + key + b": " + (other[4] or b"")
    return b"\n".join(lines)


def _with_number(value: bytes, rng: random.Random) -> bytes:
    """Change one number of a value, which may be a list."""
    words = re.split(rb"([\[\],\s]+)", value)
    places = [i for i, word in enumerate(words) if re.fullmatch(rb"[-+.\d][\w.+-]*", word)]
    if not places:
        return rng.choice(VALUES)
    i = rng.choice(places)
    words[i] = odd_number(words[i], rng)
    return b"".join(words)
