"""Launch files: arguments, conditions, several nodes, parameters that other files hold."""

from __future__ import annotations

import re

import pytest

from beamfield.errors import FormatError
from beamfield.stacks.files.parameter_file import read_stack_file, write_values

OF_TWO_ROBOTS = "".join(
    f"""<arg name="z" value="{z}" if="$(eval robot == '{robot}')"/>""" for robot, z in (("rb1", 0.5), ("tb", 0.9))
)


@pytest.fixture
def write(tmp_path):
    def write(body: str):
        path = tmp_path / "amcl.launch"
        path.write_bytes(f"<launch>\n{body}\n</launch>\n".encode())
        return path

    return write


def node(*inside: str, attributes: str = 'pkg="amcl" type="amcl" name="amcl"') -> str:
    return f"<node {attributes}>\n" + "\n".join(inside) + "\n</node>"


def param(name: str, value: str, more: str = "") -> str:
    return f'<param name="{name}" value="{value}" {more}/>'


@pytest.mark.parametrize(
    ("before", "written", "value"),
    [
        ('<arg name="z" default="0.5"/>', "$(arg z)", 0.5),
        ('<arg name="z" value="0.5"/>', "$( arg z)", None),
        ('<arg name="z"/>', "$(arg z)", None),
        ('<arg name="y" default="5"/><arg name="z" default="0.$(arg y)"/>', "$(arg z)", 0.5),
        ('<let name="z" value="1"/><arg name="z" default="0.5"/>', "$(var z)", 0.5),
        ("", "$(optenv Z_HIT 0.5)", 0.5),
        ("", "$(optenv Z_HIT)", None),
        ("", "$(env Z_HIT)", None),
        ("", "$(eval 1 / 2.0)", None),
        ('<arg name="z" default="$(arg z)"/>', "$(arg z)", None),
        (OF_TWO_ROBOTS, "$(arg z)", None),
        (f'<arg name="robot" default="tb"/>{OF_TWO_ROBOTS}', "$(arg z)", None),
    ],
)
def test_arguments_are_filled_in_with_their_defaults(write, before, written, value):
    section = read_stack_file(write(before + node(param("laser_z_hit", written)))).section
    assert section.entries["laser_z_hit"].value == value
    assert section.entries["laser_z_hit"].filled_in == written


def test_arguments_that_grow_without_bound_are_not_filled_in(write):
    twice = "".join(f'<arg name="a{i + 1}" default="$(arg a{i})$(arg a{i})"/>' for i in range(100))
    path = write('<arg name="a0" default="0123456789"/>' + twice + node(param("laser_z_hit", "$(arg a100)")))
    assert read_stack_file(path).section.entries["laser_z_hit"].value is None


@pytest.mark.parametrize(
    ("condition", "value"), [('if="$(arg big)"', 0.9), ('unless="$(arg big)"', 0.1), ('if="1"', 0.1), ('if="0"', 0.9)]
)
def test_what_conditions_take_out_by_default_is_not_there(write, condition, value):
    other = f"unless={condition[3:]}" if condition.startswith("if") else f"if={condition[7:]}"
    body = '<arg name="big" default="false"/>' + node(
        param("laser_z_hit", "0.1", condition), param("laser_z_hit", "0.9", other)
    )
    assert read_stack_file(write(body)).section.entries["laser_z_hit"].value == value
    group = '<arg name="big" default="false"/>' + "".join(
        f"<group {given}>{node(param('laser_z_hit', text))}</group>"
        for given, text in ((condition, "0.1"), (other, "0.9"))
    )
    assert read_stack_file(write(group)).section.entries["laser_z_hit"].value == value


def test_of_two_robots_one_is_chosen_by_label_or_line(write):
    two = "\n".join(f'<group ns="{robot}">{node(param("laser_z_hit", z))}</group>' for robot, z in (("a", 1), ("b", 2)))
    with pytest.raises(FormatError, match=r"give section by label or line: 'a/amcl' \(line 2\), 'b/amcl' \(line 5\)"):
        read_stack_file(write(two))
    assert read_stack_file(write(two), section="b/amcl").section.entries["laser_z_hit"].value == 2
    same = node(param("laser_z_hit", "1")) + "\n" + node(param("laser_z_hit", "2"))
    assert read_stack_file(write(same), section="5").section.entries["laser_z_hit"].value == 2


def test_a_node_whose_parameters_are_in_another_file_says_which(write):
    body = node('<rosparam command="load" file="$(find robot)/amcl.yaml"/>')
    message = r"amcl\.launch:3: the parameters of the node 'amcl' are .* in '\$\(find robot\)/amcl.yaml'"
    with pytest.raises(FormatError, match=message):
        read_stack_file(write(body))


def test_the_text_of_rosparam_is_read_and_changed_in_its_place(write):
    path = write(
        '<arg name="z" default="0.7"/>'
        + node(
            param("laser_max_beams", "30"),
            '<rosparam subst_value="true">',
            "  # t\u00fcned: by hand",
            "  laser_z_hit: 0.5   # not 0.9",
            "  initial_cov: [0.1,",
            "    0.2]",
            "  'laser_z_rand': $(arg z)",
            "  tables:",
            "    laser_sigma_hit: 7",
            "  - one",
            "  odom_model_type: 'diff'",
            "</rosparam>",
            '<rosparam command="delete" param="x"/>',
        )
    )
    file = read_stack_file(path)
    entries = file.section.entries
    assert {name: entry.value for name, entry in entries.items()} == {
        "laser_max_beams": 30, "laser_z_hit": 0.5, "initial_cov": "[0.1,", "laser_z_rand": 0.7, "tables": None,
        "odom_model_type": "diff",
    }  # fmt: skip
    assert [entries[name].line for name in ("laser_z_hit", "laser_z_rand", "odom_model_type")] == [6, 9, 13]
    assert not file.section.elsewhere
    before = path.read_text()
    write_values(file.section, {"laser_z_hit": 0.25, "laser_z_rand": 0.75, "laser_sigma_hit": 0.1})
    assert path.read_text() == before.replace("hit: 0.5 ", "hit: 0.25 ").replace("$(arg z)", "0.75").replace(
        "\n</node>", '\n  <param name="laser_sigma_hit" value="0.1"/>\n</node>'
    )


@pytest.mark.parametrize(
    "text",
    [
        "{laser_z_hit: 0.5}", "laser_z_hit: 0.5\n  laser_z_rand: 0.5", "  laser_z_hit: 0.5\nlaser_z_rand: 0.5",
        "laser_z_hit: &lt;0.5", "<!-- laser_z_hit: 0.5 -->\nlaser_z_hit: 0.6", "laser_z_hit 0.5",
        "<![CDATA[laser_z_hit: 0.5]]>",
    ],
)  # fmt: skip
def test_a_text_of_rosparam_that_is_not_understood_is_refused_but_for_other_programs(write, text):
    body = f"<rosparam>\n{text}\n</rosparam>"
    with pytest.raises(FormatError, match=r"amcl\.launch:\d+: expected lines 'name: value' in the text of <rosparam>"):
        read_stack_file(write(node(body)))
    other = node(body.replace("laser", "costmap"), attributes='pkg="move_base" type="move_base" name="move_base"')
    entries = read_stack_file(write(other + node(param("laser_z_hit", "0.4")))).section.entries
    assert entries["laser_z_hit"].value == 0.4


def test_of_a_parameter_given_several_times_the_last_counts_and_is_the_one_that_changes(write):
    # As in the launch file of amcl's own examples, and in those made of it.
    tags = param("laser_lambda_short", "0.1"), param("laser_z_hit", "0.4"), param("laser_lambda_short", "0.2")
    path = write(node("<rosparam>laser_z_hit: 0.5</rosparam>", *tags))
    section = read_stack_file(path).section
    assert {name: entry.value for name, entry in section.entries.items()} == {
        "laser_z_hit": 0.4, "laser_lambda_short": 0.2,
    }  # fmt: skip
    assert section.entries["laser_z_hit"].others == ((3, 0.5),)
    before = path.read_text()
    write_values(section, {"laser_z_hit": 0.6, "laser_lambda_short": 0.3})
    assert path.read_text() == before.replace('value="0.4"', 'value="0.6"').replace('value="0.2"', 'value="0.3"')


def test_a_tag_counts_more_than_the_text_of_rosparam_below_it(write):
    # roslaunch sets the tags of a node last (`_node_tag` in its xmlloader.py).
    path = write(node(param("laser_z_hit", "0.4"), "<rosparam>laser_z_hit: 0.5</rosparam>"))
    entry = read_stack_file(path).section.entries["laser_z_hit"]
    assert (entry.value, entry.others) == (0.4, ((4, 0.5),))


def test_what_may_be_there_does_not_replace_what_is(write):
    unsure = param("laser_z_hit", "0.9", 'if="$(arg outdoors)"')
    for tags in ((param("laser_z_hit", "0.1"), unsure), (unsure, param("laser_z_hit", "0.1"))):
        entry = read_stack_file(write(node(*tags))).section.entries["laser_z_hit"]
        assert (entry.value, entry.others) == (0.1, ())


def test_which_of_several_that_may_be_there_counts_is_not_known(write):
    conditions = [f"""if="$(eval robot == '{robot}')\"""" for robot in "abc"]
    given = [param("laser_z_hit", z, more) for z, more in zip(("0.7", "0.8", "0.9"), conditions, strict=True)]
    entry = read_stack_file(write(node(*given))).section.entries["laser_z_hit"]
    assert (entry.value, entry.filled_in) == (None, "0.7 or 0.8 or 0.9")
    same = [param("laser_z_hit", "0.7", more) for more in conditions]
    assert read_stack_file(write(node(*same))).section.entries["laser_z_hit"].value == 0.7


def test_arguments_for_an_included_file_are_not_this_file_s(write):
    included = '<include file="$(find robot)/more.launch"><arg name="z" value="0.9"/></include>'
    own = '<arg name="z" default="0.5"/>'
    for before in (included + own, own + included):
        assert (
            read_stack_file(write(before + node(param("laser_z_hit", "$(arg z)")))).section.entries["laser_z_hit"].value
            == 0.5
        )


def test_a_namespace_is_filled_in(write):
    group = f'<arg name="robot" default="r1"/><group ns="$(arg robot)">{node(param("laser_z_hit", "0.5"))}</group>'
    assert read_stack_file(write(group)).section.label == "r1/amcl"


def test_the_included_files_are_named_where_no_node_has_parameters(write):
    files = "".join(f'<include file="{name}.launch"/>' for name in ("base", "amcl", "rviz"))
    other = node(attributes='pkg="map_server" type="map_server" name="map"')
    with pytest.raises(FormatError, match=r"no node with parameters of a measurement model, .* 'amcl\.launch'$"):
        read_stack_file(write(files + other))
    with pytest.raises(FormatError, match=r"included files .* 'base\.launch', 'rviz\.launch'$"):
        read_stack_file(write(files.replace('<include file="amcl.launch"/>', "")))


def test_all_files_that_have_the_parameters_are_named(write):
    files = '<rosparam file="filter.yaml"/><rosparam file="laser.yaml"/>'
    with pytest.raises(FormatError, match=r"not in this file but in 'filter\.yaml' and 'laser\.yaml': give that file"):
        read_stack_file(write(node(files)))


@pytest.mark.parametrize(
    ("outside", "source"),
    [
        ('<rosparam ns="/amcl">\nlaser_z_hit: 0.1\n</rosparam>', "the text of <rosparam>"),
        ('<rosparam param="amcl">\nlaser_z_hit: 0.1\n</rosparam>', "the text of <rosparam>"),
        (param("/amcl/laser_z_hit", "0.1"), "a <param> outside of it"),
        ('<arg name="n" default="amcl"/><group ns="$(arg n)">' + param("laser_z_hit", "0.1") + "</group>", "a <param>"),
        ('<rosparam ns="amcl" file="filter.yaml"/>', "filter.yaml"),
        ('<group ns="amcl"><rosparam file="filter.yaml"/></group>', "filter.yaml"),
        ('<rosparam file="$(find robot)/amcl_params.yaml"/>', "$(find robot)/amcl_params.yaml"),
    ],
)
def test_parameters_outside_of_the_node_are_not_passed_over_in_silence(write, outside, source):
    with pytest.raises(FormatError, match=f"the parameters of the node 'amcl' are not .* in '?{re.escape(source)}"):
        read_stack_file(write(outside + node()))
    ((line, found),) = read_stack_file(write(outside + node(param("laser_z_rand", "0.1")))).section.elsewhere
    assert (line, found[: len(source)]) == (2, source)


@pytest.mark.parametrize(
    "outside",
    [
        '<rosparam ns="move_base" file="amcl.yaml"/>',
        '<rosparam ns="amcl2">\nlaser_z_hit: 0.1\n</rosparam>',
        '<rosparam file="costmap.yaml"/>',
        '<rosparam ns="amcl" command="delete" param="laser_z_hit"/>',
        param("amcl/use_map_topic", "true"),
        param("laser_z_hit", "0.1"),
    ],
)
def test_what_is_set_outside_for_others_does_not_count(write, outside):
    assert not read_stack_file(write(outside + node())).section.elsewhere


@pytest.mark.parametrize(
    ("body", "stack", "certain"),
    [
        (node(param("laser_z_hit", "1")), "ros1", True),
        (node(param("z_hit", "1.0"), attributes='pkg="nav2_amcl" exec="amcl" name="amcl"'), "nav2", True),
        (node(param("z_hit", "1.0"), attributes='pkg="beluga_amcl" exec="amcl_node" name="amcl"'), "beluga", True),
        (node(param("laser_z_hit", "1"), attributes='pkg="beluga_amcl" type="amcl_node" name="amcl"'), "beluga", True),
        (node(param("squash_factor", "2.2"), param("z_hit", "0.8"),
              attributes='pkg="particle_filter" type="particle_filter.py" name="pf"'), "f1tenth", True),
    ],
    ids=["amcl", "nav2", "beluga", "beluga in ROS 1", "f1tenth"],
)  # fmt: skip
def test_whose_node_it_is(write, body, stack, certain):
    file = read_stack_file(write(body))
    assert (file.stack, file.stack_is_certain) == (stack, certain)


def test_the_value_is_found_among_attributes_that_look_like_it(write):
    path = write(node('<param name="laser_z_hit" data-value=\'7\' myvalue = "8" value = \'0.5\'\n  type="double" />'))
    section = read_stack_file(path).section
    after = section.with_values({"laser_z_hit": 0.6})
    assert after == section.text.replace("'0.5'", "'0.6'")


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"], ids=["unix", "windows", "old mac"])
def test_new_parameters_stand_before_the_end_tag_and_out_of_comments(write, newline):
    path = write(node("  " + param("laser_z_hit", "0.5") + " <!-- two", "  lines -->"))
    path.write_bytes(path.read_bytes().replace(b"\n", newline.encode()))
    section = read_stack_file(path).section
    after = section.with_values({"laser_z_rand": 0.5, "laser_z_hit": 0.5})
    new = f'  <param name="laser_z_rand" value="0.5"/>{newline}'
    assert after == section.text.replace(f"{newline}</node>", f"{newline}{new}</node>")


def test_a_node_without_end_tag_takes_no_new_parameters(write):
    section = read_stack_file(write('<node pkg="amcl" type="amcl" name="amcl"/>')).section
    with pytest.raises(FormatError, match=r":2: amcl: has no end tag"):
        section.with_values({"laser_z_hit": 0.5})


def test_forty_thousand_parameters_are_read_in_a_moment(write):
    many = (param(f"p{i}", "é") for i in range(40_000))
    section = read_stack_file(write(node(*many, param("laser_z_hit", "0.25")))).section
    entry = section.entries["laser_z_hit"]
    assert section.text[entry.start : entry.stop] == "0.25"
