"""Parameter files of other stacks: recognised, read with their places, changed without touching anything else."""

from __future__ import annotations

import difflib
import math

import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.stacks.beluga.filter import BelugaFilterParameters
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import ParameterSection, check_patch_target, read_stack_file, write_values
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.registry import STACKS
from beamfield.stacks.syntax.parameter_text import plain_value

NAV2 = """\
# localisation of the lobby robot
map_server:
  ros__parameters:
    yaml_filename: "lobby.yaml"
amcl:
  ros__parameters:
    use_sim_time: false
    z_hit: 0.5      # tuned by ear
    z_rand: 0.5
    laser_model_type: "likelihood_field_prob"
    max_beams: 60

    initial_pose: {x: 0.0, y: 1.0}
controller_server:
  ros__parameters:
    controller_frequency: 20.0
"""
TWO = NAV2.replace("map_server:", "amcl_2:").replace("yaml_filename", "laser_model_type").replace("lobby.yaml", "beam")
LAUNCH = """\
<launch>
  <arg name="z" default="0.5"/>
  <!-- amcl -->
  <node pkg="amcl" type="amcl" name="loc">
    <param name="laser_z_hit" value="0.95"/>
    <param value='$(arg z)' name='laser_z_rand'/> <!-- é -->
  </node>
  <node pkg="map_server" type="map_server" name="maps"><param name="frame_id" value="map"/></node>
</launch>
"""
INI = """\
// localisation
[MetricMap_occupancyGrid_00_creationOpts]
resolution=0.05
[MetricMap_occupancyGrid_00_likelihoodOpts]
likelihoodMethod   = 4   // 4: Thrun
LF_stdHit=0.35
LF_zRandom   = 0.05  ; share
"""
FLAT = "squash_factor: 2.2\nz_hit: 0.75\nsigma_hit: 8.0\nrange_method: rmgpu\n"


@pytest.fixture
def write(tmp_path):
    def write(text: str, name: str = "params.yaml"):
        path = tmp_path / name
        path.write_bytes(text.encode())
        return path

    return write


def changed_lines(before: str, after: str) -> list[str]:
    lines = [line for line in difflib.ndiff(before.splitlines(), after.splitlines()) if line[0] in "+-"]
    return sorted(lines, key=lambda line: line[0], reverse=True)


@pytest.mark.parametrize(
    ("text", "name", "stack", "model"),
    [
        (NAV2, "nav2.yaml", "nav2", "likelihood_field_prob"),
        (NAV2.replace("z_rand: 0.5", "model_unknown_space: true"), "b.yaml", "beluga", "likelihood_field_prob"),
        (LAUNCH, "amcl.launch", "ros1", "likelihood_field"),
        ("amcl:\n  laser_z_hit: 0.9\n  laser_model_type: beam\n", "amcl.yaml", "ros1", "beam"),
        (INI, "pf.ini", "mrpt", "LF_Thrun"),
        (INI.replace("= 4", "= lmRayTracing"), "pf.ini", "mrpt", "rayTracing"),
        (FLAT, "localize.yaml", "f1tenth", "table"),
        (
            "/robot1:\n  amcl:\n    ros__parameters:\n      set_initial_pose: true\n",
            "n.yaml",
            "nav2",
            "likelihood_field",
        ),
    ],
    ids=["nav2", "beluga", "launch", "ros1 yaml", "mrpt", "mrpt by name", "f1tenth", "amcl without weights"],
)
def test_stack_and_model_are_recognised(write, text, name, stack, model):
    file = read_stack_file(write(text, name))
    assert (file.stack, file.model) == (stack, model)


def test_nav2_and_beluga_files_that_look_alike_are_said_to(write):
    assert not read_stack_file(write(NAV2)).stack_is_certain
    said = read_stack_file(write(NAV2), stack="beluga")
    assert said.stack == "beluga"
    assert said.stack_is_certain


def test_values_come_with_their_lines(write):
    section = read_stack_file(write(NAV2)).section
    assert section.label == "amcl.ros__parameters"
    assert section.entries["z_hit"].value == 0.5
    assert section.entries["z_hit"].line == 8
    assert section.entries["max_beams"].value == 60
    assert "z_short" not in section.entries
    section = read_stack_file(write(LAUNCH, "a.launch")).section
    assert section.label == "loc"
    assert section.entries["laser_z_rand"].value == 0.5
    assert section.entries["laser_z_rand"].filled_in == "$(arg z)"
    file = read_stack_file(write(LAUNCH.replace(' default="0.5"', ""), "a.launch"))
    assert file.section.entries["laser_z_rand"].value is None
    with pytest.raises(FormatError, match=r"a\.launch:6: laser_z_rand: is substituted at launch: '\$\(arg z\)'"):
        checked_values(file)


def test_only_changed_values_change_in_yaml(write):
    section = read_stack_file(write(NAV2)).section
    after = section.with_values({"z_hit": 0.97, "max_beams": 90, "laser_model_type": "beam", "sigma_hit": 1.0})
    assert changed_lines(NAV2, after) == [
        "-     z_hit: 0.5      # tuned by ear",
        '-     laser_model_type: "likelihood_field_prob"',
        "-     max_beams: 60",
        "+     z_hit: 0.97      # tuned by ear",
        '+     laser_model_type: "beam"',
        "+     max_beams: 90",
        "+     sigma_hit: 1.0",
    ]


def test_only_changed_values_change_in_a_launch_file(write):
    section = read_stack_file(write(LAUNCH, "a.launch")).section
    after = section.with_values({"laser_z_rand": 0.03, "laser_z_hit": 0.97, "laser_sigma_hit": 0.1})
    assert changed_lines(LAUNCH, after) == [
        '-     <param name="laser_z_hit" value="0.95"/>',
        "-     <param value='$(arg z)' name='laser_z_rand'/> <!-- é -->",
        '+     <param name="laser_z_hit" value="0.97"/>',
        "+     <param value='0.03' name='laser_z_rand'/> <!-- é -->",
        '+     <param name="laser_sigma_hit" value="0.1"/>',
    ]


def test_only_changed_values_change_in_an_ini_file(write):
    section = read_stack_file(write(INI, "pf.ini")).section
    after = section.with_values({"LF_stdHit": 0.1, "LF_zRandom": 0.2, "LF_decimation": 3})
    assert changed_lines(INI, after) == [
        "- LF_stdHit=0.35",
        "- LF_zRandom   = 0.05  ; share",
        "+ LF_stdHit=0.1",
        "+ LF_zRandom   = 0.2  ; share",
        "+ LF_decimation = 3",
    ]


@pytest.mark.parametrize(
    ("text", "name", "value", "after"),
    [
        ("z_hit:\nz_rand: 1\n", "z_hit", 0.5, "z_hit: 0.5\nz_rand: 1\n"),
        ("amcl: {z_hit: 1.0}\n", "z_rand", 0.1, "amcl: {z_rand: 0.1, z_hit: 1.0}\n"),
        ("amcl: {z_hit: 1.0}\n", "z_hit", 1e-7, "amcl: {z_hit: 1.0e-07}\n"),
        ("z_hit: 1.0\r\nx: 2\r\n", "z_rand", 0.1, "z_hit: 1.0\r\nx: 2\r\nz_rand: 0.1\r\n"),
        ("z_hit: 1.0", "z_rand", 0.1, "z_hit: 1.0\nz_rand: 0.1"),
        ("z_hit: 1.0\rx: 2\r", "z_rand", 0.1, "z_hit: 1.0\rx: 2\rz_rand: 0.1\r"),
        ("a: {z_hit: 1.0, # one\n  p: {x: 1}}\n", "z_rand", 0.1, "a: {z_rand: 0.1, z_hit: 1.0, # one\n  p: {x: 1}}\n"),
        ("'z_hit': 1.0 # z_hit: old\n\"z_rand\": # z_rand: 3\n", "z_rand", 0.1,
         "'z_hit': 1.0 # z_hit: old\n\"z_rand\": 0.1 # z_rand: 3\n"),
        ("z_hit: 1.0\nt: |\n  z_rand: 2\n  more\n", "z_rand", 0.1,
         "z_rand: 0.1\nz_hit: 1.0\nt: |\n  z_rand: 2\n  more\n"),
        ("amcl:\n  ros__parameters:\n    p: {x: 1}\n", "z_hit", 0.1,
         "amcl:\n  ros__parameters:\n    z_hit: 0.1\n    p: {x: 1}\n"),
    ],
    ids=["without value", "in brackets", "tiny", "windows line ends", "no last line end",
         "old mac line ends", "brackets over lines", "names in comments and quotes", "text in lines",
         "only maps inside"],
)  # fmt: skip
def test_odd_yaml_is_changed_and_read_again(write, text, name, value, after):
    section = read_stack_file(write(text)).section
    assert section.with_values({name: value}) == after
    assert read_stack_file(write(after)).section.entries[name].value == pytest.approx(value)


def test_what_does_not_change_stays_as_it_was_written(write):
    text = "z_hit: 5.0e-1\nz_rand: !!float 0.50\nlaser_model_type: 'beam'\n"
    section = read_stack_file(write(text)).section
    assert section.with_values({"z_hit": 0.5, "z_rand": 0.5, "laser_model_type": "beam"}) == text


def test_only_nodes_with_a_model_count_beside_others_of_amcl(write):
    text = NAV2 + "amcl_map_client:\n  ros__parameters:\n    use_sim_time: true\n"
    assert read_stack_file(write(text)).section.label == "amcl.ros__parameters"


SHARED = """\
/**:
  ros__parameters:
    use_sim_time: true
    z_hit: 0.4
    alpha1: 0.3
amcl:
  ros__parameters:
    z_hit: 0.6
    z_rand: 0.4  # mine
"""


def test_parameters_of_all_nodes_are_those_of_the_node_unless_it_has_its_own(write):
    section = read_stack_file(write(SHARED)).section
    assert section.label == "amcl.ros__parameters"
    assert {name: entry.value for name, entry in section.entries.items()} == {
        "use_sim_time": True, "z_hit": 0.6, "alpha1": 0.3, "z_rand": 0.4,
    }  # fmt: skip
    path = section.path
    write_values(section, {"z_hit": 0.5, "alpha1": 0.1, "alpha2": 0.2})
    # Other nodes, such as another robot's amcl, keep what all get.
    expected = SHARED.replace("z_hit: 0.6", "z_hit: 0.5")
    assert path.read_text() == expected.replace("# mine\n", "# mine\n    alpha1: 0.1\n    alpha2: 0.2\n")
    assert read_stack_file(path).section.entries["alpha1"].value == 0.1


def test_what_comes_behind_a_node_for_all_is_changed_there_as_it_may_count(write):
    shared, _, node = SHARED.replace("    z_hit: 0.4\n", "").partition("amcl:")
    section = read_stack_file(write(f"amcl:{node}{shared}")).section
    assert section.with_values({"alpha1": 0.1}) == section.text.replace("alpha1: 0.3", "alpha1: 0.1")
    assert section.with_values({"alpha1": 0.3}) == section.text


@pytest.mark.parametrize(
    ("pattern", "node", "counts"),
    [("/*", "amcl", True), ("/robot1/**", "/robot1/amcl", True), ("/**/amcl", "/robot1/amcl", True),
     ("/robot2/**", "/robot1/amcl", False), ("/*", "/robot1/amcl", False), ("/robot*", "/robot1/amcl", False)],
)  # fmt: skip
def test_parameters_of_several_nodes_by_wildcards_are_those_of_the_nodes_they_match(write, pattern, node, counts):
    path = write(SHARED.replace("amcl:", f"{node}:").replace("/**:", f"{pattern}:"))
    if counts:
        section = read_stack_file(path).section
        assert (section.entries["z_hit"].value, section.entries["alpha1"].value) == (0.6, 0.3)
        assert section.with_values({"alpha1": 0.1}).startswith(section.text.rstrip().rpartition("\n")[0])
        return
    with pytest.raises(FormatError, match="several sections have such parameters"):
        read_stack_file(path)


def test_a_nodes_section_without_parameters_of_the_laser_gets_those_of_all_nodes(write):
    text = SHARED.replace("    z_hit: 0.6\n    z_rand: 0.4  # mine\n", "    alpha2: 0.7\n")
    section = read_stack_file(write(text)).section
    assert (section.label, section.entries["z_hit"].value) == ("amcl.ros__parameters", 0.4)
    alone = read_stack_file(write(text.partition("amcl:")[0])).section
    assert (alone.label, alone.entries["z_hit"].value) == ("/**.ros__parameters", 0.4)


def test_which_of_two_values_a_node_gets_must_not_depend_on_the_release(write):
    shared, _, node = SHARED.partition("amcl:")
    with pytest.raises(FormatError, match=r":8: z_hit: is in 'amcl\.ros__parameters', too: which one counts"):
        read_stack_file(write(f"amcl:{node}{shared}"))
    section = read_stack_file(write(f"amcl:{node}{shared}".replace("    z_hit: 0.4\n", ""))).section
    assert (section.entries["z_hit"].value, section.entries["alpha1"].value) == (0.6, 0.3)


def test_keys_may_be_numbers_in_other_sections(write):
    assert read_stack_file(write("waypoints:\n  1: {2.5: a}\n" + NAV2)).section.entries["z_hit"].value == 0.5


@pytest.mark.parametrize(
    ("text", "stack", "certain"),
    [
        ("laser_z_hit: 0.5\n", "ros1", True),
        ("laser_z_hit: 0.5\nexecution_policy: seq\n", "beluga", True),
        ("amcl:\n  laser_max_range: 12.0\n", "ros1", True),
        ("amcl:\n  z_hit: 0.5\n", "nav2", False),
        ("/**:\n  ros__parameters:\n    z_hit: 0.5\n", "nav2", False),
        ("particle_filter:\n  ros__parameters:\n    z_hit: 0.5\n", "f1tenth", True),
    ],
)
def test_whose_file_a_yaml_file_can_be(write, text, stack, certain):
    file = read_stack_file(write(text))
    assert (file.stack, file.stack_is_certain) == (stack, certain)


@pytest.mark.parametrize(
    ("text", "stack", "is_good"),
    [
        (NAV2, "nav2", True), (NAV2, "beluga", True), (NAV2, "ros1", False), (FLAT, "nav2", False),
        ("laser_z_hit: 0.5\n", "nav2", False), ("laser_z_hit: 0.5\n", "ros1", True),
    ],
    ids=["nav2", "beluga", "ros 1 into ROS 2", "nav2 into f1tenth", "nav2 into ROS 1", "ros 1"],
)  # fmt: skip
def test_values_go_into_files_of_their_own_stack_only(write, text, stack, is_good):
    file = read_stack_file(write(text), stack=stack, model=STACKS[stack].default_model)
    if is_good:
        check_patch_target(file)
        return
    with pytest.raises(FormatError, match=f"expected a file of {stack}, this is one of"):
        check_patch_target(file)


def test_a_change_that_would_reach_further_is_not_made(write):
    path = write("z_hit:\n  - 0.5\n  - 0.7\nz_rand: 0.5\n")
    before = path.read_bytes()
    with pytest.raises(FormatError, match="without changing other parts; the file is unchanged"):
        write_values(read_stack_file(path).section, {"z_hit": 0.6})
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == ["params.yaml"]


@pytest.mark.parametrize(
    ("written", "is_good"),
    [
        ("z_hit: 0.6\nz_rand: 0.5\nmax_beams: 1\n", True),
        ("z_hit: 0.600001\nz_rand: 0.5\nmax_beams: 1\n", True),
        ("z_hit: 0.6001\nz_rand: 0.5\nmax_beams: 1\n", False),
        ("z_hit: 0.6\nz_rand: 0.51\nmax_beams: 1\n", False),
        ("z_hit: 0.6\nz_rand: 0.5\nmax_beams: '1'\n", False),
        ("z_hit: 0.6\nz_rand: 0.5\nmax_beams: true\n", False),
        ("z_hit: 0.6\nz_rand: 0.5\n", False),
        ("z_hit: 0.6\nz_rand: 0.5\nmax_beams: 1\nalpha1: 0.2\n", False),
        ("z_hit: 0.6\nz_rand: 0.5\nmax_beams: 1\nz_hit: 0.6\n", False),
        ("z_hit: [0.6\n", False),
    ],
    ids=["as asked", "six digits", "another value", "an old one changed", "text", "truth", "one lost", "one more",
         "twice", "no YAML"],
)  # fmt: skip
def test_what_was_written_is_read_before_it_takes_the_files_place(write, monkeypatch, written, is_good):
    path = write("z_hit: 0.5\nz_rand: 0.5\nmax_beams: 1\n")
    before, section = path.read_bytes(), read_stack_file(path).section
    monkeypatch.setattr(ParameterSection, "with_values", lambda *_: written)
    if is_good:
        write_values(section, {"z_hit": 0.6})
        assert path.read_text() == written
        return
    with pytest.raises(FormatError, match="the file is unchanged"):
        write_values(section, {"z_hit": 0.6})
    assert path.read_bytes() == before


def test_a_link_stays_a_link(write, tmp_path):
    path = write(NAV2)
    link = tmp_path / "link.yaml"
    link.symlink_to(path)
    write_values(read_stack_file(link).section, {"z_hit": 0.6})
    assert link.is_symlink()
    assert "z_hit: 0.6 " in path.read_text()


def test_faults_in_other_sections_of_an_ini_file_do_not_matter(write):
    text = "#include x\n[other]\nfree text\na=1\na=2\n" + INI + "\n[more]\n<<<END\n"
    assert read_stack_file(write(text, "p.ini")).section.entries["LF_stdHit"].value == 0.35


HOSTILE = {
    "bomb.yaml": b"a: &a [x]\nb: [*a, *a]\nz_hit: 0.5\n", "deep.yaml": b"a: " + b"[" * 5000 + b"]" * 5000,
    "nul.yaml": b"z_hit: 0.5\0\n", "nul.launch": b"<launch>\0</launch>", "latin.yaml": b"z_hit: \xff\n",
    "latin.launch": b"<launch>\xff</launch>",
    "utf16.yaml": "z_hit: 0.5\n".encode("utf-16"),
    "big.yaml": b"# " + b"x" * 200_001, "big.launch": b"<!--" + b"x" * 2_000_001, "big.ini": b"# " + b"x" * 2_000_001,
    "digits.yaml": b"z_hit: " + b"9" * 6000, "tag.yaml": b"z_hit: !!python/object:os.system 1\n",
    "nested.launch": b"<a>" * 50_000 + b"</a>" * 50_000, "start.py": b"import launch\n", "key.yaml": b"? z_hit\n",
    "method.yaml": b"z_hit: 0.5\nlaser_model_type: 3\n",
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(HOSTILE[name])
    with pytest.raises(FormatError, match=name) as refused:
        read_stack_file(path)
    assert len(str(refused.value)) < 300 + len(str(path))


def test_bytes_of_other_encodings_in_an_ini_file_stay(write):
    # As in the examples of MRPT.
    path = write("", "p.ini")
    path.write_bytes(b"// J. L. Blanco \xa9 2007\r\n" + INI.encode())
    before = path.read_bytes()
    write_values(read_stack_file(path).section, {"LF_stdHit": 0.1})
    assert path.read_bytes() == before.replace(b"0.35", b"0.1")


def test_of_a_key_given_twice_the_last_counts_and_other_nodes_may_have_two(write):
    text = "amcl:\n  ros__parameters:\n    z_hit: 0.4\n    z_rand: 0.5\n    z_hit: 0.6 # ours\n"
    path = write("planner: {a: 1}\n" + text + "planner: {a: 2, b: 3}\n")
    section = read_stack_file(path).section
    assert (section.entries["z_hit"].value, section.entries["z_hit"].others) == (0.6, ((4, 0.4),))
    write_values(section, {"z_hit": 0.7, "sigma_hit": 0.1})
    changed = text.replace("0.6 # ours\n", "0.7 # ours\n    sigma_hit: 0.1\n")
    assert path.read_text() == "planner: {a: 1}\n" + changed + "planner: {a: 2, b: 3}\n"


def test_ros_1_rounds_counts_and_ros_2_does_not(write):
    path = write("laser_z_hit: 0.5\nresample_interval: 0.5\nmin_particles: 99.4\n")
    settings = read_filter_settings(read_stack_file(path))
    assert (settings.particles.resample_interval, settings.particles.min_particles) == (1, 99)
    with pytest.raises(FormatError, match=r"resample_interval: expected a whole number, got 0\.5"):
        read_filter_settings(read_stack_file(write("amcl: {ros__parameters: {resample_interval: 0.5}}\n")))


@pytest.mark.parametrize(
    ("written", "value"), [("030", 24), ("-030", -24), ("'030'", "030"), ("030.0", 30.0), ("30", 30)]
)
def test_a_whole_number_that_begins_with_0_is_octal_to_ros(write, written, value):
    section = read_stack_file(write(f"laser_z_hit: 0.5\nlaser_max_beams: {written}\n")).section
    assert section.entries["laser_max_beams"].value == value
    assert section.with_values({"laser_max_beams": 30}).endswith("laser_max_beams: 30\n")


@pytest.mark.parametrize(
    ("written", "radians"),
    [
        ("!degrees 10.0", math.pi / 18),
        ("deg(90)", math.pi / 2),
        ("!radians 0.3", 0.3),
        ("rad(2*pi/3)", 2 * math.pi / 3),
    ],
)
def test_angles_are_read_as_ros_1_reads_them(write, written, radians):
    file = read_stack_file(write(f"laser_z_hit: 0.5\nupdate_min_a: {written}\n"))
    assert file.section.entries["update_min_a"].value == pytest.approx(radians)
    assert read_filter_settings(file).particles.update_min_a == pytest.approx(radians)
    assert file.section.with_values({"laser_z_hit": 0.6}).endswith(f"0.6\nupdate_min_a: {written}\n")


def test_a_distance_too_small_for_a_number_is_0(write):
    file = read_stack_file(write("laser_z_hit: 0.5\nupdate_min_d: 0.000000000000000000001\n"))
    assert read_filter_settings(file).particles.update_min_d == 0.0


def test_a_line_of_a_million_blanks_takes_no_time(write):
    section = read_stack_file(write("[a]\nLF_stdHit = x" + " " * 1_000_000 + "x\n", "p.ini")).section
    assert section.entries["LF_stdHit"].line == 2


def test_a_node_without_parameters_gets_one(write):
    text = '<launch>\n  <node pkg="amcl" type="amcl" name="loc">\n  </node>\n</launch>\n'
    after = read_stack_file(write(text, "a.launch")).section.with_values({"laser_z_hit": 0.5})
    assert read_stack_file(write(after, "b.launch")).section.entries["laser_z_hit"].value == 0.5


def test_writing_keeps_backups_and_permissions(write):
    path = write(NAV2)
    path.chmod(0o600)
    first = write_values(read_stack_file(path).section, {"z_hit": 0.6})
    second = write_values(read_stack_file(path).section, {"z_hit": 0.7})
    assert [first.name, second.name] == ["params.yaml.bak", "params.yaml.bak2"]
    assert first.read_text() == NAV2
    assert "z_hit: 0.6 " in second.read_text()
    assert "z_hit: 0.7 " in path.read_text()
    assert [p.stat().st_mode & 0o777 for p in (path, first, second)] == [0o600] * 3
    launch = write(LAUNCH, "a.launch")
    backup = write_values(read_stack_file(launch).section, {"laser_z_hit": 0.6})
    assert read_stack_file(backup).stack == "ros1"  # as `evaluate` reads it


def test_a_byte_order_mark_stays(write):
    path = write("\ufeff" + FLAT)
    write_values(read_stack_file(path).section, {"z_hit": 0.7})
    assert path.read_bytes().decode() == "\ufeff" + FLAT.replace("0.75", "0.7")


def test_a_read_only_file_is_left_alone(write):
    path = write(NAV2)
    section = read_stack_file(path).section
    path.chmod(0o444)
    with pytest.raises(PermissionError, match="read-only"):
        write_values(section, {"z_hit": 0.6})
    assert [file.name for file in path.parent.iterdir()] == ["params.yaml"]
    assert path.read_text() == NAV2


def test_a_file_that_changed_meanwhile_is_left_alone(write):
    path = write(NAV2)
    section = read_stack_file(path).section
    path.write_text(NAV2 + "# more\n")
    with pytest.raises(FormatError, match="has changed since"):
        write_values(section, {"z_hit": 0.6})
    assert path.read_text() == NAV2 + "# more\n"


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("a: 1\n", "p.yaml", r"p\.yaml: no parameters of a measurement model found"),
        (TWO, "p.yaml", r"several sections .* 'amcl_2.ros__parameters' \(line 3\), 'amcl.ros__parameters' \(line 6\)"),
        (NAV2.replace("field_prob", "field_best"), "p.yaml", r"p\.yaml:10: laser_model_type: no model of nav2"),
        ("just text\n", "p.yaml", "expected keys with values"),
        ("<launch><node></launch>", "p.launch", r"p\.launch:1: not valid XML: mismatched tag"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><launch/>', "p.launch", r"document types are not supported, got <!DOCTYPE a"),
        ("<launch/>", "p.launch", "no parameters of a measurement model found"),
        ("amcl: {z_hit: 1.0}\namcl: {a: 1}\n", "p.yaml", r"p\.yaml:2: duplicate key 'amcl', as in line 1: .* keep one"),
        ("[a]\nLF_stdHit=1\nLF_stdHit=2\n", "p.ini", r"p\.ini:3: LF_stdHit: duplicate name in \[a\]"),
        ("[a]\nnonsense\n", "p.ini", r"p\.ini:2: expected \[section\], name = value or a comment, got 'nonsense'"),
        ("[a]\nlikelihoodMethod = 77\n", "p.ini", r"p\.ini:2: likelihoodMethod: no model of mrpt .* got 77"),
    ],
    ids=["no such file", "several", "model", "text", "xml", "doctype", "no node", "twice", "twice 2", "ini", "method"],
)  # fmt: skip
def test_bad_files_are_refused_with_their_line(write, text, name, message):
    with pytest.raises(FormatError, match=message):
        read_stack_file(write(text, name))


def test_one_of_several_sections_can_be_chosen(write):
    path = write(TWO)
    assert read_stack_file(path, section="amcl.ros__parameters").section.line == 6
    assert read_stack_file(path, section="3").section.label == "amcl_2.ros__parameters"
    with pytest.raises(
        FormatError, match=r"no section 'x' .* known sections: 'amcl_2.ros__parameters', 'amcl.ros__param"
    ):
        read_stack_file(path, section="x")


def test_unknown_stacks_and_models_are_refused(write):
    with pytest.raises(InvalidInputError, match="stack: expected one of nav2, ros1, beluga, mrpt, f1tenth, got 'ros9'"):
        read_stack_file(write(NAV2), stack="ros9")
    with pytest.raises(InvalidInputError, match=r"model: nav2 has likelihood_field, .* got 'table'"):
        read_stack_file(write(NAV2), model="table")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "two\nlines", ""])
def test_values_that_no_file_can_hold_are_refused(write, value):
    section = read_stack_file(write(NAV2)).section
    with pytest.raises(InvalidInputError, match="value: expected"):
        section.with_values({"z_hit": value})


BELUGA_1 = "laser_z_hit: 0.77   # mine\nlaser_max_beams: 100\nselective_resampling: false\n"


def test_belugas_names_for_ros_1_are_read_and_written_as_they_are(write):
    path = write(BELUGA_1)
    file = read_stack_file(path)
    assert file.is_of_other_node
    values = checked_values(file)
    assert (values.z_hit, values.max_beams) == (0.77, 100)
    # The node for ROS 1 has ROS 1's defaults.
    assert (values.z_rand, values.z_short, values.sigma_hit, values.laser_max_range) == (0.05, 0.1, 0.2, 100.0)
    write_values(file.section, file.by_names_in_file({"z_hit": 0.6, "sigma_hit": 0.1}))
    assert path.read_text() == BELUGA_1.replace("0.77", "0.6") + "laser_sigma_hit: 0.1\n"


def test_belugas_filter_for_ros_1_has_names_and_defaults_of_its_own(write):
    file = read_stack_file(
        write(BELUGA_1 + "odom_model_type: omnidirectional_drive\nodom_alpha3: 0.07\nkld_err: 0.03\n")
    )
    settings = read_filter_settings(file)
    assert settings.sensor.z_hit == 0.77
    assert (settings.motion.robot_model_type, settings.motion.alpha3, settings.motion.alpha1) == (
        "omnidirectional_drive", 0.07, 0.2,
    )  # fmt: skip
    assert settings.particles == BelugaFilterParameters(
        min_particles=100,
        max_particles=5000,
        pf_err=0.03,
        resample_interval=2,
        update_min_d=0.2,
        update_min_a=math.pi / 6,
    )
    assert file.by_names_in_file({"alpha3": 0.05, "z_hit": 0.6}) == {"odom_alpha3": 0.05, "laser_z_hit": 0.6}
    with pytest.raises(FormatError, match=r"params\.yaml:4: odom_alpha3: expected a number >= 0, got -1"):
        read_filter_settings(read_stack_file(write(BELUGA_1 + "odom_alpha3: -1\n")))


def test_a_ros_1_file_is_belugas_if_one_says_so(write):
    file = read_stack_file(write("laser_z_hit: 0.77\n"), stack="beluga")
    assert checked_values(file).z_hit == 0.77
    check_patch_target(file)


@pytest.mark.parametrize("other", ["z_hit: 0.5", "sigma_hit: 0.1"])
def test_names_of_both_of_belugas_nodes_are_refused(write, other):
    path = write(f"{BELUGA_1}{other}\n")
    name = other.split(":")[0]
    with pytest.raises(
        FormatError, match=rf"params\.yaml:4: {name}: is a name of Beluga's node for ROS 2, laser_z_hit one"
    ):
        read_stack_file(path)


def test_ros_2_ignores_the_names_of_ros_1(write):
    text = "amcl:\n  ros__parameters:\n    laser_z_hit: 0.77\n    execution_policy: seq\n"
    file = read_stack_file(write(text))
    assert file.stack == "beluga"
    assert not file.is_of_other_node
    assert checked_values(file).z_hit == 0.5


@pytest.mark.parametrize(
    ("kind", "possible"),
    [("differential_drive", ("beluga",)), ("nav2_amcl::DifferentialMotionModel", ("nav2", "beluga"))],
)
def test_a_file_with_belugas_name_of_a_motion_model_is_belugas(write, kind, possible):
    text = f'amcl:\n  ros__parameters:\n    z_hit: 0.5\n    robot_model_type: "{kind}"\n'
    assert read_stack_file(write(text)).possible == possible


def test_an_amcl_node_stays_amcls_whatever_stray_names_it_has(write):
    text = LAUNCH.replace("</node>", '<param name="execution_policy" value="seq"/></node>', 1)
    assert read_stack_file(write(text, "a.launch")).possible == ("ros1",)
    assert read_stack_file(write(text.replace('pkg="amcl"', 'pkg="beluga_amcl"'), "a.launch")).possible == ("beluga",)


OTHER_FILES = {
    "beam_model.yaml": (
        "beam_model:\n  z_hit: 0.5\n  sigma_hit: 0.1\n",
        "this is beamfield's own beam model: `beamfield t",
    ),
    "likelihood_field.yaml": (
        "likelihood_field:\n  z_hit: 0.5\n  z_rand: 0.4\n  sigma_hit: 0.1\n",
        "this is beamfield's own likelihood field",
    ),
    "landmark_model.yaml": ("landmark_model:\n  sigma_range: 0.1\n", "this is beamfield's own landmark model"),
    "map.yaml": (
        "image: a.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n",
        r"this is the YAML file of a map \(give it with",
    ),
    "metadata.yaml": ("rosbag2_bagfile_information:\n  version: 5\n", "this is the metadata of a ROS 2 bag"),
    "calibration.json": ('{"parameters": {"z_hit": 0.5}}', "this is JSON, in which beamfield writes results"),
    "poses.tum": ("# stamp\n1.5 0 0 0 0 0 0 1\n", "this is a file of poses"),
    "poses.csv": ("t,x,y,theta\n1,2,3,4\n", "this is a file of poses"),
    "run.bag": ("#ROSBAG V2.0\n", "this is a bag"),
    "run.log": ("# CARMEN\nFLASER 1 2.0 0 0 0 0 0 0 0 host 0\n", "this is a log"),
    "random.yaml": ("a: {b: 1}\n", "no parameters of a measurement model found"),
}


@pytest.mark.parametrize("name", OTHER_FILES)
def test_files_of_other_kinds_are_named(write, name):
    text, message = OTHER_FILES[name]
    with pytest.raises(FormatError, match=message) as refused:
        read_stack_file(write(text, name))
    assert "expected a parameter file of nav2, ROS 1 amcl, Beluga, MRPT or F1TENTH" in str(refused.value)


def test_a_long_value_takes_a_time_that_grows_with_its_length():
    # Where digits match in two ways, this takes minutes.
    word = "0" * 200_000 + "x"
    assert plain_value(word) == word


@pytest.mark.parametrize("text", ["x,y," * 500, "# a\n" * 400 + "1 " * 600])
def test_a_file_of_another_kind_is_known_in_a_time_that_grows_with_its_length(write, text):
    # A pattern of several free parts takes a minute for the first 400 characters of columns.
    with pytest.raises(FormatError):
        read_stack_file(write("a: [\n" + text, "poses.yaml"))
    with pytest.raises(FormatError):
        read_stack_file(write(text, "poses.csv"))
