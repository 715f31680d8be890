"""The comment by which the doctor knows calibrated values."""

from __future__ import annotations

from dataclasses import replace

import pytest

from beamfield.stacks.files.calibration_record import (
    goes_with_moved_map,
    is_as_calibrated,
    is_noted,
    record_text,
    with_record,
)
from beamfield.stacks.files.parameter_file import read_stack_file, write_values
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.nav2.motion import Nav2Motion
from beamfield.stacks.registry import parameter_class

FILES = {
    "nav2": ("p.yaml", "amcl:\n  ros__parameters:\n    z_hit: 0.5\n    t: |\n      text\n"),
    "ros1": ("p.launch", '<launch>\n  <node pkg="amcl" type="amcl" name="a">\n  </node>\n</launch>'),
    "mrpt": ("p.ini", "[a_likelihoodOpts]\nLF_stdHit = 0.3"),
    "f1tenth": ("q.yaml", "{squash_factor: 2.2, z_hit: 0.75}"),
}


@pytest.mark.parametrize("stack", FILES)
def test_a_record_survives_in_a_patched_file_and_any_change_voids_it(tmp_path, stack):
    name, text = FILES[stack]
    path = tmp_path / name
    path.write_text(text)
    file = read_stack_file(path, stack=stack)
    sigma = {"nav2": "sigma_hit", "ros1": "laser_sigma_hit", "mrpt": "LF_stdHit", "f1tenth": "sigma_hit"}[stack]
    fitted = replace(checked_values(file), **{sigma: 0.123456789})
    write_values(file.section, {sigma: 0.123456789}, record=record_text(stack, file.model, fitted, None, "1.0", "well"))
    again = read_stack_file(path, stack=stack)
    assert "1.0, well" in again.section.text
    assert is_as_calibrated(again.section.text, stack, again.model, checked_values(again), None)
    for item, value in ((sigma, 0.1235), *([("do_beamskip", True)] if stack == "nav2" else [])):
        changed = replace(checked_values(again), **{item: value})
        assert not is_as_calibrated(again.section.text, stack, again.model, changed, None)
    assert not is_as_calibrated(text, stack, again.model, checked_values(again), None)


def test_a_record_is_of_one_stack_and_model():
    nav2, beluga = parameter_class("nav2")(), parameter_class("beluga")()
    text = with_record("", record_text("nav2", "beam", nav2, Nav2Motion(), "1.0", "well"), "yaml")
    assert text.startswith("# nav2 beam: calibrated by beamfield 1.0, well; checksum ")
    assert with_record(text, text[2:].rstrip(), "yaml") == text
    assert is_as_calibrated(text, "nav2", "beam", nav2, Nav2Motion())
    assert not is_as_calibrated(text, "nav2", "beam", nav2, Nav2Motion(alpha1=0.5))
    assert not is_as_calibrated(text, "nav2", "likelihood_field", nav2, Nav2Motion())
    assert not is_as_calibrated(text, "beluga", "beam", beluga, Nav2Motion())


@pytest.mark.parametrize(
    ("text", "moved"),
    [
        ("# for the map of the cellar\n", False),
        ("# calibrated by beamfield 1; checksum 1 of the values; chosen for the map amcl_map.yaml\n", True),
        ("# calibrated by beamfield 1\n# for the map amcl_map.yaml beside this file, see there\namcl: {}\n", True),
        ("# chosen for the map amcl_map.yaml\n# calibrated by beamfield 2\n", False),
        ("# chosen for the map amcl_map.yaml\n# chosen for the map as it is\n", False),
    ],
)
def test_of_several_records_the_last_says_which_map_the_values_are_for(text, moved):
    assert goes_with_moved_map(text) is moved


OF_VALUES = (
    "nav2 beam: calibrated by beamfield 1, 90% of 9 held-out windows covered; checksum 0123456789abcdef of the values"
)


@pytest.mark.parametrize(
    ("record", "noted"),
    [
        ("", True),
        (OF_VALUES.replace("90% of 9", "88% of 17"), True),
        (OF_VALUES.replace("0123", "3210"), False),
        (f"{OF_VALUES}; chosen for the map amcl_map.yaml", False),
        ("chosen for the map amcl_map.yaml", False),
    ],
)
def test_another_log_that_confirms_the_same_values_for_the_same_map_has_nothing_to_note(record, noted):
    assert is_noted(record, f"amcl: {{}}\n# {OF_VALUES}\n") is noted
