"""Properties of patching: in any document only the values asked for change, byte for byte."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from beamfield.stacks.files.parameter_file import ParameterSection, read_stack_file, write_values

KNOWN = ("laser_z_hit", "laser_z_rand", "laser_sigma_hit", "laser_max_beams", "laser_likelihood_max_dist")
COMMENT = st.sampled_from(["", "  # tuned", " # z: 'x' {", " # é <!-- -->", "   #"])
NUMBERS = st.one_of(
    st.floats(1e-3, 100.0).map(lambda x: f"{x:.4g}"), st.integers(1, 500).map(str), st.just("1.0e-3"), st.just("'a b'"),
    st.just("true"), st.just('"0.5"'), st.just(""),
)  # fmt: skip
OTHER = st.sampled_from(["alpha1", "odom_frame_id", "zhit", "laser", "z", "amcl_x"])


@st.composite
def entries(draw):
    """Return unique names, at least one of a measurement model."""
    known = draw(st.lists(st.sampled_from(KNOWN), min_size=1, max_size=4, unique=True))
    return draw(st.permutations([*known, *draw(st.lists(OTHER, max_size=3, unique=True))]))


@st.composite
def yaml_documents(draw):
    """Return the text of a YAML file for ROS 1, in one of many ways of writing it."""
    newline = draw(st.sampled_from(["\n", "\r\n"]))
    depth = draw(st.integers(0, 2))
    indent = draw(st.sampled_from(["  ", "    ", " "]))
    lines = draw(
        st.lists(st.sampled_from(["# a comment", "", "---", "other: [1, 2]  # list"]), max_size=2, unique=True)
    )
    lines = [line for line in lines if line != "---" or line == lines[0]]
    lines += [f"{indent * level}{name}:" for level, name in enumerate(("robot", "amcl")[:depth])]
    if draw(st.booleans()) and depth:
        pairs = ", ".join(f"{name}: {draw(NUMBERS) or 1}" for name in draw(entries()))
        lines[-1] += f" {{{pairs}}}{draw(COMMENT)}"
    else:
        for name in draw(entries()):
            quoted = draw(st.sampled_from([name, f'"{name}"', f"'{name}'"]))
            lines.append(
                f"{indent * depth}{quoted}:{draw(st.sampled_from([' ', '   ']))}{draw(NUMBERS)}{draw(COMMENT)}"
            )
            lines += draw(st.lists(st.sampled_from(["", f"{indent * depth}# between: 1"]), max_size=1))
    return newline.join(lines) + draw(st.sampled_from(["", newline, f"{newline}  ", f"{newline * 3}"]))


@st.composite
def launch_documents(draw):
    """Return the text of a ROS 1 launch file, in one of many ways of writing it."""
    newline = draw(st.sampled_from(["\n", "\r\n"]))
    lines = [draw(st.sampled_from(["<launch>", '<?xml version="1.0"?><launch>', "<!-- é --><launch>"]))]
    lines += draw(st.lists(st.sampled_from(['  <arg name="a" default="0.5"/>', "  <!-- <param/> -->", ""]), max_size=2,
                           unique=True))  # fmt: skip
    lines.append('  <node pkg="amcl" type="amcl" name="loc">')
    for name in draw(entries()):
        value = draw(st.one_of(NUMBERS.filter(lambda text: '"' not in text and "'" not in text), st.just("$(arg a)")))
        quote = draw(st.sampled_from(['"', "'"]))
        words = [f"name={quote}{name}{quote}", f"value={quote}{value}{quote}"]
        words = words if draw(st.booleans()) else words[::-1]
        end = draw(st.sampled_from(["/>", " />", "></param>"]))
        lines.append(f"    <param {'  '.join(words)}{end}" + draw(st.sampled_from(["", " <!-- <node> -->"])))
    lines += ["  </node>", "</launch>"]
    return newline.join(lines) + draw(st.sampled_from(["", newline, f"{newline}  ", f"{newline * 3}"]))


NEW_VALUES = st.dictionaries(
    st.sampled_from(KNOWN[:3]), st.floats(1e-3, 100.0).map(lambda x: float(f"{x:.6g}")), min_size=1, max_size=3
)


def check(text: str, name: str, values: dict[str, float]) -> None:
    """Patch a document and look at every byte of it, and at what a reader sees."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(text.encode())
        before = read_stack_file(path, stack="ros1", model="likelihood_field").section
        backup = write_values(before, values)
        assert backup.read_bytes() == text.encode()
        after = read_stack_file(path, stack="ros1", model="likelihood_field").section
    for item in before.entries.keys() | values.keys():
        assert after.entries[item].value == (values[item] if item in values else before.entries[item].value)
    assert after.entries.keys() == before.entries.keys() | values.keys()
    assert without(after, values, before) == without(before, values, before)


def without(section: ParameterSection, values: dict[str, float], before: ParameterSection) -> str:
    """Return the text with the values asked for taken out, and whole parameters that were new."""
    text = section.text
    for item, entry in sorted(section.entries.items(), key=lambda pair: -pair[1].start):
        if item not in values:
            continue
        start, stop = entry.start, entry.stop
        if item in before.entries:
            # A value where there was none brings a blank with it.
            start -= before.entries[item].start == before.entries[item].stop and section is not before and (
                section.syntax == "yaml"
            )  # fmt: skip
        elif section.syntax == "launch":
            start, stop = text.rindex("<param", 0, start), text.index("/>", stop) + 2
            start = before_line_start(text, start)
        elif text[stop : stop + 2] == ", ":
            start, stop = start - len(f"{item}: "), stop + 2
        else:
            start = before_line_start(text, start - len(f"{item}: "))
        text = text[:start] + text[stop:]
    return text


def before_line_start(text: str, at: int) -> int:
    """Return where the line break begins that a new line came with."""
    start = len(text[:at].rstrip(" \t"))
    return start - len(text[:start]) + len(text[:start].removesuffix("\n").removesuffix("\r"))


@settings(max_examples=40, derandomize=True)
@given(yaml_documents(), NEW_VALUES)
def test_only_the_values_asked_for_change_in_yaml(text, values):
    check(text, "amcl.yaml", values)


@settings(max_examples=40, derandomize=True)
@given(launch_documents(), NEW_VALUES)
def test_only_the_values_asked_for_change_in_launch_files(text, values):
    check(text, "amcl.launch", values)
