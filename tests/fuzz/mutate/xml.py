"""Changes to launch files: tags, attributes, arguments, includes, quotes, entities."""

from __future__ import annotations

import random
import re

from tests.fuzz.mutate.text import odd_number

_TAG = re.compile(rb"<[^<>]*>")
_ATTRIBUTE = re.compile(rb"([\w:-]+)(\s*=\s*)(\"[^\"]*\"|'[^']*')")
VALUES = (
    b"", b"$(arg z)", b"$(arg nothing)", b"$(var z)", b"$(find pkg)/x.yaml", b"$(eval 1/0)", b"$(env HOME)",
    b"$(optenv A 0.5)",
    b"$(arg $(arg z))", b"$(", b")", b"&lt;", b"&amp;", b"&#65;", b"&#0;", b"&#x110000;", b"&unknown;", b"<", b"]]>",
    b"a\nb",
    b"amcl", b"nav2_amcl", b"beluga_amcl", b"particle_filter", b"true", b"false", b"1", b"0", b"beam", b"double",
    b"str", b"yaml",
    b"\xe9", "\u00e9".encode(), b"x" * 2000, b"[1, 2]", b"{a: 1}", b"~z", b"/amcl/laser_z_hit", b"laser_z_hit",
    b"z_hit",
)  # fmt: skip
PIECES = (
    b"<!-- comment -->", b"<!-- -- -->", b"<!--", b"-->", b"<![CDATA[ x ]]>", b"<?pi x?>",
    b"<!DOCTYPE a [<!ENTITY b 'c'>]>",
    b"<arg name='z' default='0.1'/>", b"<arg name='z'/>", b"<include file='$(find a)/b.launch'/>", b"<group>",
    b"</group>",
    b"<rosparam command='load' file='x.yaml'/>", b"<rosparam>laser_z_hit: 0.5</rosparam>", b"<rosparam>a: [</rosparam>",
    b"<param name='laser_z_hit' value='1'/>", b"<param name='laser_z_rand'/>", b"<param/>",
    b"<param name='a' textfile='b'/>",
    b"<remap from='a' to='b'/>",
    b"<node pkg='amcl' type='amcl' name='two'><param name='laser_z_hit' value='1'/></node>",
    b"</node>", b"<node>", b"<a:b/>", b"text", b"&", b"<group if='$(arg z)'>", b"<" * 50, b"<a>" * 300,
)  # fmt: skip


def mutate_xml(content: bytes, rng: random.Random) -> bytes:
    """Change one thing of a launch file."""
    step = rng.randrange(10)
    attributes = list(_ATTRIBUTE.finditer(content))
    tags = list(_TAG.finditer(content))
    if step <= 5 and attributes:
        return _attribute(content, rng.choice(attributes), rng)
    if step <= 8 and tags:
        start, stop = rng.choice(tags).span()
        if step == 6:
            return content[:start] + content[stop:]
        if step == 7 and rng.random() < 0.5:
            return content[:start] + content[start:stop] + content[start:]
        place = rng.choice((start, stop))
        return content[:place] + rng.choice(PIECES) + content[place:]
    if rng.random() < 0.5:
        encoding = rng.choice((b"utf-8", b"latin-1", b"utf-16", b"nothing", b"ascii"))
        return b"<?xml version='1.0' encoding='" + encoding + b"'?>\n" + content
    return content.replace(b'"', b"'") if rng.random() < 0.5 else content.replace(b"/>", b">", rng.randint(1, 2))


def _attribute(content: bytes, match: re.Match[bytes], rng: random.Random) -> bytes:
    name, equals, quoted = match.groups()
    value = quoted[1:-1]
    step = rng.randrange(12)
    if step <= 3:
        value = rng.choice(VALUES)
    elif step <= 6:
        value = odd_number(value, rng)
    elif step <= 9:
        name = rng.choice(
            (b"name", b"value", b"default", b"if", b"unless", b"type", b"pkg", b"ns", b"command", b"x:y", b"1")
        )
    elif step == 10:
        return content[: match.start()] + match.group() + b" " + match.group() + content[match.end() :]
    else:
        return content[: match.start()] + content[match.end() :]
    quote = rng.choice((b'"', b"'"))
    return content[: match.start()] + name + equals + quote + value + quote + content[match.end() :]
