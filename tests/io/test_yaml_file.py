"""YAML files are read as plain values, and errors name the line."""

from __future__ import annotations

import pytest

from beamfield.errors import FormatError
from beamfield.io.files.yaml_file import read_yaml, shorten


@pytest.fixture
def write(tmp_path):
    def write_it(content: str | bytes):
        path = tmp_path / "a.yaml"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_it


def test_plain_values_come_with_their_types_and_lines(write):
    file = read_yaml(write("# c\na: 1\nb: [1, 2.5, x]\nc:\n  d: {e: yes, f: 1e-3}\n  g: true\n  h:\n"))
    assert file.values == {"a": 1, "b": [1, 2.5, "x"], "c": {"d": {"e": "yes", "f": 0.001}, "g": True, "h": None}}
    assert isinstance(file.values["a"], int)
    assert file.lines["a",] == 2
    assert file.lines["b", 2] == 3
    assert file.lines["c", "d", "f"] == 5
    assert file.lines["c", "h"] == 7


def test_a_byte_order_mark_and_windows_line_ends_are_read(write):
    assert read_yaml(write(b"\xef\xbb\xbfa: 1\r\nb: 2\r\n")).values == {"a": 1, "b": 2}


def test_numbers_without_a_point_are_read_in_silence_where_the_file_declares_yaml_1_1(write):
    assert read_yaml(write("%YAML 1.1\n---\na: 1e3\nb: 1.5\n")).values == {"a": 1000.0, "b": 1.5}


def test_dates_stay_text(write):
    assert read_yaml(write("a: 2024-13-45\nb: 2024-01-02\n")).values == {"a": "2024-13-45", "b": "2024-01-02"}


@pytest.mark.parametrize(
    ("content", "line", "message"),
    [
        ("", None, "empty"),
        ("# only a comment\n", None, "empty"),
        ("- 1\n- 2\n", 1, "expected keys with values, got a list"),
        ("just text\n", 1, "got the text 'just text'"),
        ("a: 1\nb: 2\na: 3\n", 3, "duplicate key 'a'"),
        ("c:\n  a: 1\n  a: 3\n", 3, "duplicate key 'a'"),
        ("a: 1\nb: !!python/object/apply:os.system ['true']\n", 2, "python/object/apply:os.system"),
        ("a: 1\nb: !!python/name:os.system\n", 2, "python/name:os.system"),
        ("a: !thing {b: 1}\n", 1, "!thing"),
        ("a: !!binary aGk=\n", 1, "binary"),
        ("a: 1\n---\nb: 2\n", 2, "second one"),
        ("a: &x 1\nb: *x\n", 1, "'&x'"),
        ("a: *x\n", 1, "'*x'"),
        ("%YAML 1.0\n---\na: 1\n", None, "expected YAML 1.1 or 1.2"),
        ("%YAML 1.3\n---\na: 1\n", None, "expected YAML 1.1 or 1.2"),
        ("%TAG ! tag:x,2000:\n---\n%YAML 9.9\n--\n", None, "expected YAML 1.1 or 1.2"),
        ("a: [1, 2\nb: 3\n", 2, "not valid YAML"),
        ("a: 1\n\tb: 2\n", 2, "not valid YAML"),
        ("5: 3\n", 1, "expected text as a key, got '5'"),
        ("[a]: 3\n", 1, "expected text as a key, got a list"),
        ("a: !!int foo\n", 1, "expected a value of type int, got 'foo'"),
        ("a: " + "1" * 5000 + "\n", 1, "expected a value of type int"),
        ("a: " + "[" * 60 + "\n", 1, "nested deeper"),
        ("[" * 3000, 1, "nested deeper"),
        ("a:\nb: [" + "1," * 20_000 + "]\n", 2, "more than 15000 keys, values and brackets"),
        (b"a: 1\nb: \xff\n", 2, r"b'\xff'"),
        (b"a: \x00\x01\n", None, "not valid YAML"),
    ],
)
def test_what_is_no_plain_yaml_is_named_with_its_line(write, content, line, message):
    path = write(content)
    with pytest.raises(FormatError) as caught:
        read_yaml(path)
    assert caught.value.line == line
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_large_file_is_refused_before_it_is_parsed(write):
    path = write("a: 1\n" + "#" * 300_000)
    with pytest.raises(FormatError, match="at most 200000 bytes"):
        read_yaml(path)
    assert read_yaml(path, max_bytes=400_000).values == {"a": 1}


def test_a_missing_file_is_the_file_systems_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_yaml(tmp_path / "none.yaml")


def test_values_are_found_by_their_keys_and_checked_for_type(write):
    file = read_yaml(write("a:\n  b: [1, x]\n  c: text\n  d: .inf\n  e: true\n  f: ''\ng: 1" + "0" * 400 + "\n"))
    assert file.number("a", "b", 0) == 1.0
    assert file.text("a", "c") == "text"
    for place, line, message in [
        (("a", "b", 1), 2, "a.b.1: expected a number, got 'x'"),
        (("a", "d"), 4, "a.d: expected a finite number, got inf"),
        (("a", "e"), 5, "a.e: expected a number, got True"),
        (("g",), 7, "g: expected a number, got one too large"),
        (("a", "z"), 1, "the key 'z' is missing in 'a'"),
        (("z",), None, "the key 'z' is missing"),
        (("a", "b", 2), 2, "the key 2 is missing in 'a.b'"),
        (("a", "c", "x"), 3, "the key 'x' is missing in 'a.c'"),
    ]:
        with pytest.raises(FormatError) as caught:
            file.number(*place)
        assert caught.value.line == line
        assert message in str(caught.value)
    for place in (("a", "f"), ("a", "b"), ("g",)):
        with pytest.raises(FormatError, match="expected text"):
            file.text(*place)


def test_long_values_are_shortened_in_messages():
    assert shorten("x" * 1000) == "'" + "x" * 59 + "..."
    assert shorten(3) == "3"
