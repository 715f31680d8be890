"""Texts of the library as a user of the command line should read them."""

from __future__ import annotations

import pytest

from beamfield.cli.wording import in_options


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("read it with lone_poses='odometry' and supply poses", "read it with --lone-poses odometry and supply poses"),
        ("read with stamps='order' if", "read with --stamps order if"),
        ("(give max_range if it measures that far)", "(give --max-range if it measures that far)"),
        ("unless no_return names NaN", "unless --no-return names NaN"),
        ("scan: the log has scans 0 to 9", "--scan: the log has scans 0 to 9"),
        ("scheduler: expected serial", "--scheduler: expected serial"),
        ("block_s: expected a positive number", "--block: expected a positive number"),
        ("stack: expected one of nav2, got 'x'", "--stack: expected one of nav2, got 'x'"),
        ("hit: expected a probability in (0.5, 1)", "--hit: expected a probability in (0.5, 1)"),
        # Not what only looks like it: values of a sensor, paths, quotations, the options themselves.
        ("the sensor's max_range is 8 m", "the sensor's max_range is 8 m"),
        ("/data/map_frame/a.log: no 'map_frame' in it", "/data/map_frame/a.log: no 'map_frame' in it"),
        ("my_map_frame.yaml, map_frame.yaml", "my_map_frame.yaml, map_frame.yaml"),
        ("--no-return: expected detect", "--no-return: expected detect"),
    ],
)
def test_parameters_of_the_library_are_options(text, expected):
    assert in_options(text) == expected
