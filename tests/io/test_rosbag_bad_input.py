"""Bags that are missing, cut, damaged or senseless: one error that names the place, nothing else."""

from __future__ import annotations

import pickle
import shutil
import sqlite3
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from beamfield.errors import BeamfieldError, FormatError, InvalidInputError
from beamfield.io.bags.laser_scan import ordered_stamps
from beamfield.io.bags.reader import read_bag, read_bag_map
from beamfield.io.files import yaml_file
from beamfield.io.files.bag_storage import repair_of
from beamfield.io.read_log import read_log
from tests.fuzz.mutate.bag1 import CONNECTION, MAGIC, bag1_bytes, bag1_records
from tests.io.mini_bag import LASER_SCAN, RAW, STORAGES, MiniBag, quaternion


def refuse(path, pattern, error=FormatError, read=read_bag, **options):
    """Check that reading fails with one line that matches and names the file."""
    with pytest.raises(error, match=pattern) as caught:
        read(path, **options)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path).split("/")[-1] in text
    return text


def many_scans(storage: str) -> MiniBag:
    bag = MiniBag(storage)
    for i in range(200):
        bag.scan(1.0 + i, np.linspace(1.0, 2.0, 20))
    return bag


def storage_file(path):
    return path if path.is_file() else next(f for f in path.iterdir() if f.suffix in (".db3", ".mcap"))


def test_a_missing_file_passes_through(tmp_path):
    for name in ("no.bag", "no_folder", "no.mcap", "no.db3"):
        with pytest.raises(FileNotFoundError, match=name):
            read_bag(tmp_path / name)


def test_a_folder_that_is_no_bag(tmp_path):
    (tmp_path / "photos").mkdir()
    refuse(tmp_path / "photos", "not a bag: no metadata.yaml")


def test_ros1_bags_that_are_no_parts_of_one(tmp_path):
    for name in ("run_0", "run_2"):
        MiniBag("ros1").scan(1.0).write(tmp_path, name)
    refuse(tmp_path, "expected the parts of one bag, .*, got run_0.bag, run_2.bag; name one of the files")
    MiniBag("ros1").scan(1.0).write(tmp_path, "run_1")
    MiniBag("ros1").scan(1.0).write(tmp_path, "other")
    refuse(tmp_path, "got other.bag, run_0.bag, run_1.bag, run_2.bag")


def test_messages_that_a_database_holds_beside_itself_are_not_lost(tmp_path):
    """As a power cut leaves them: with immutable=1, as rosbags opens it, SQLite does not look at the file beside."""
    whole, cut = many_scans("sqlite3").write(tmp_path), tmp_path / "cut"
    file = storage_file(whole)
    base = sqlite3.connect(file)
    base.execute("PRAGMA journal_mode = WAL")
    with base:
        base.execute("UPDATE messages SET id = id + 1000 WHERE id > 100")
    shutil.copytree(whole, cut)
    base.close()
    refuse(cut, rf"cut off.* in {file.name}-wal\..*wal_checkpoint")
    with sqlite3.connect(storage_file(cut)) as base:
        base.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    base.close()
    assert len(read_bag(cut).only_sensor()) == 200


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_wrong_magic(suffix, tmp_path):
    path = tmp_path / f"x{suffix}"
    path.write_bytes(b"not a bag at all, but long enough")
    refuse(path, "starts with b'not a bag at all")


def test_an_empty_file(tmp_path):
    (tmp_path / "x.bag").touch()
    refuse(tmp_path / "x.bag", "it is empty")


def test_a_pickle_renamed_to_bag_is_not_opened(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("the pickle was loaded",))

    (tmp_path / "x.bag").write_bytes(pickle.dumps(Bomb()))
    refuse(tmp_path / "x.bag", "not a ROS 1 bag")


def test_an_mcap_renamed_to_bag(tmp_path):
    path = storage_file(MiniBag("mcap").scan(1.0).write(tmp_path))
    refuse(path.rename(tmp_path / "x.bag"), r"content is a \.mcap file.*'\.bag'")


def test_a_recording_that_was_cut_off(tmp_path):
    path = MiniBag("ros1").scan(1.0).write(tmp_path)
    active = path.rename(f"{path}.active")
    refuse(active, r"cut off: `rosbag reindex log\.bag\.active` .* name it log\.bag$", read=read_log)


@pytest.mark.parametrize("profile", [b"ros1", b""])
def test_an_mcap_of_others_than_ros2_is_not_called_damaged(profile, tmp_path):
    path = MiniBag("mcap").scan(1.0).write(tmp_path)
    file = storage_file(path)
    content = file.read_bytes()
    header = struct.pack("<I", len(profile)) + profile
    (length,) = struct.unpack_from("<Q", content, 9)
    rest = length - len(header) - 4
    header += struct.pack("<I", rest) + bytes(rest)
    file.write_bytes(content[:17] + header + content[17 + length :])
    refuse(path, f"profile '{profile.decode()}', not 'ros2': give the ROS 1 .bag .* `ros2 bag convert`")


def test_an_old_bag_version(tmp_path):
    (tmp_path / "x.bag").write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    refuse(tmp_path / "x.bag", "version 102")


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.97])
def test_a_cut_bag(storage, share, tmp_path):
    path = many_scans(storage).write(tmp_path)
    file = storage_file(path)
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    repair = {
        "ros1": "rosbag reindex log.bag",
        "sqlite3": "sqlite3 log.db3 .dump | sed '/^ROLLBACK/s/.*/COMMIT;/' | sqlite3 repaired.db3",
        "mcap": "mcap recover log.mcap -o repaired.mcap",
    }
    assert f"; `{repair[storage]}` may save what is left" in refuse(path, "damaged or truncated")


@pytest.mark.skipif(shutil.which("sqlite3") is None, reason="the command line of SQLite is not installed")
def test_the_command_that_is_advised_mends_a_cut_database(tmp_path):
    file = storage_file(many_scans("sqlite3").write(tmp_path))
    content, page = file.read_bytes(), 4096  # file systems keep whole pages
    file.write_bytes(content[: int(0.9 * len(content)) // page * page])
    subprocess.run(repair_of(file), shell=True, cwd=file.parent, stderr=subprocess.DEVNULL)
    assert len(read_bag(file.with_name("repaired.db3")).only_sensor()) > 100


def test_a_compressed_file_of_a_bag_alone(tmp_path):
    path = MiniBag("sqlite3").scan(1.0).write(tmp_path, compression="file")
    packed = path / "log.db3.zstd"
    assert packed.is_file()
    text = r"compressed ROS 2 bag: give the bag's folder, or unpack it with `zstd -d log\.db3\.zstd`"
    refuse(packed, text)
    refuse(packed, text, read=read_log)


def test_missing_files_and_damaged_metadata_are_mended_by_reindexing(tmp_path):
    path = MiniBag("mcap").scan(1.0).write(tmp_path)
    storage_file(path).rename(path / "other.mcap")
    refuse(path, r"missing: \['log.mcap'\]; without them, `ros2 bag reindex` writes the metadata anew")
    (path / "metadata.yaml").write_text("a: 1")
    refuse(path, "metadata.yaml: .*is missing.*; `ros2 bag reindex` writes the metadata anew")


@pytest.mark.parametrize("storage", STORAGES)
def test_no_damaged_byte_gets_past_as_another_error(storage, tmp_path):
    path = many_scans(storage).write(tmp_path)
    file = storage_file(path)
    content = bytearray(file.read_bytes())
    rng = np.random.default_rng(5)
    for trial in range(60):
        damaged = content.copy()
        # Index and headers sit at both ends; the rest is spread over the file.
        span = (
            (0, 400) if trial % 3 == 0 else (len(content) - 400, len(content)) if trial % 3 == 1 else (0, len(content))
        )
        for where in rng.integers(*span, size=8):
            damaged[where] = rng.integers(256)
        file.write_bytes(damaged)
        try:
            read_bag(path)
        except BeamfieldError as error:
            assert "\n" not in str(error)  # noqa: PT017 - reading may as well succeed


def test_corrupted_metadata(tmp_path):
    path = MiniBag("sqlite3").scan(1.0).write(tmp_path)
    metadata = path / "metadata.yaml"
    good = metadata.read_text()
    for bad, reason in (("{", "not valid YAML"), ("", "empty"), ("[1, 2", "not valid YAML"), ("a: &a [*a]", "anchors"),
                        ("rosbag2_bagfile_information: 7", "damaged or truncated"), ("a: 1", "is missing"),
                        ("!!python/object:os.system [ls]", "expected keys"), ("\x00\xff", "not valid YAML"),
                        (good.replace("relative_file_paths", "more"), "damaged or truncated"),
                        (good.replace("- log.db3", "- 7"), "damaged or truncated")):  # fmt: skip
        metadata.write_text(bad)
        refuse(path, reason)


def test_what_storage_files_hold_is_not_taken_from_metadata(tmp_path):
    path = MiniBag("sqlite3").scan(1.0).write(tmp_path)
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 1", "message_count: many").replace("/scan", "7"))
    assert len(read_bag(path).only_sensor("/scan")) == 1


def test_metadata_that_takes_long_to_read_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(yaml_file, "MAX_EVENTS", 1_000)
    path = MiniBag("sqlite3").scan(1.0).write(tmp_path)
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text() + f"  more: [{'1,' * 1_000}]\n")
    refuse(path, r"metadata\.yaml:\d+: more than 1000 keys, values and brackets")


def test_metadata_in_yaml_1_1_is_read_in_silence(tmp_path):
    path = MiniBag("sqlite3").scan(1.0).write(tmp_path)
    metadata = path / "metadata.yaml"
    metadata.write_text("%YAML 1.1\n---\n" + metadata.read_text().replace("custom_data:", "more: 1e9\n  custom_data:"))
    assert len(read_bag(path).only_sensor()) == 1


def test_metadata_of_absurd_size(tmp_path):
    path = MiniBag("sqlite3").scan(1.0).write(tmp_path)
    with (path / "metadata.yaml").open("ab") as file:
        file.truncate(2**30)
    with pytest.raises(FormatError, match=r"metadata\.yaml: expected a YAML file of at most"):
        read_bag(path)


def test_metadata_that_names_a_missing_file(tmp_path):
    path = MiniBag("sqlite3").scan(1.0).write(tmp_path)
    storage_file(path).unlink()
    refuse(path, "files are missing")


def test_a_bag_without_scans_lists_its_topics(tmp_path):
    path = MiniBag().odometry(1.0, (0.0, 0.0)).declare("/scan", LASER_SCAN).write(tmp_path)
    refuse(path, r"no scans.*'/odom' \(nav_msgs/msg/Odometry\)")


def test_a_bag_with_point_clouds_instead_says_what_makes_scans_of_them(tmp_path):
    path = MiniBag().declare("/points", "sensor_msgs/msg/PointCloud2").write(tmp_path)
    refuse(path, r"no scans.*run pointcloud_to_laserscan on '/points'")


@pytest.mark.parametrize("storage", STORAGES)
def test_an_empty_bag(storage, tmp_path):
    refuse(MiniBag(storage).write(tmp_path), "no scans")


def test_an_unknown_topic_and_one_of_another_type(tmp_path):
    path = MiniBag().scan(1.0).odometry(1.0, (0.0, 0.0)).write(tmp_path)
    refuse(path, r"no topic '/laser'; the bag has '/scan' \(", InvalidInputError, sensor_topic="/laser")
    refuse(path, "'/odom' holds nav_msgs/msg/Odometry", InvalidInputError, sensor_topic="/odom")
    refuse(
        path,
        "'/scan' holds sensor_msgs/msg/LaserScan, expected nav_msgs/msg/Odometry or",
        InvalidInputError,
        poses_topic="/scan",
    )
    with pytest.raises(InvalidInputError, match="got both"):
        read_bag(path, poses_topic="/odom", map_frame="map")
    with pytest.raises(InvalidInputError, match="at least one topic"):
        read_bag(path, sensor_topic=[])


def changed_db3(bag: MiniBag, folder, *statements: str):
    """Write a bag, change it as a hostile one may be, and return its single file."""
    path = storage_file(bag.write(folder)).rename(folder / "x.db3")
    with sqlite3.connect(path) as base:
        for statement in statements:
            base.execute(statement)
    base.close()
    return path


def test_a_topic_with_messages_of_two_types(tmp_path):
    bag = MiniBag("sqlite3").odometry(1.0, (0.0, 0.0)).scan(1.0)
    path = changed_db3(bag, tmp_path, "UPDATE topics SET name = '/scan'")
    refuse(path, "/scan: expected one type of message, got 'nav_msgs/msg/Odometry' and 'sensor_msgs/msg/LaserScan'")


@pytest.mark.parametrize(
    ("name", "field", "read"),
    [("LaserScan", "ranges", read_bag), ("Transform", "rotation", read_bag), ("OccupancyGrid", "info", read_bag_map)],
)
def test_a_known_type_with_other_fields(name, field, read, tmp_path):
    bag = MiniBag("sqlite3").scan(1.0).tf("base_link", "laser", 1.0, static=True).grid(1.0, 1, 1, [0])
    path = changed_db3(
        bag, tmp_path, "UPDATE topics SET type_description_hash = ''",
        "UPDATE message_definitions SET type_description_hash = '', "
        f"encoded_message_definition = replace(encoded_message_definition, ' {field}\n', ' other\n')",
    )  # fmt: skip
    refuse(path, rf"message 1: .*{name}('|.*) (object has no attribute|without) '{field}'", read=read)


@pytest.mark.parametrize("topic", ["tf", "odometry"])
def test_a_known_type_with_arrays_for_numbers(topic, tmp_path):
    zero = (0.0, 0.0, 0.0)
    bag = MiniBag("sqlite3").scan(1.0)
    bag = bag.tf("base_link", "laser", 1.0, zero, static=True) if topic == "tf" else bag.odometry(1.0, zero[:2])
    path = changed_db3(
        bag, tmp_path, "UPDATE topics SET type_description_hash = ''",
        "UPDATE message_definitions SET type_description_hash = '', encoded_message_definition = "
        "replace(encoded_message_definition, 'float64 y', 'uint8[3] y')",
    )  # fmt: skip
    refuse(path, "message 1: not a valid .*: .*arrays")


def test_a_frame_without_a_name(tmp_path):
    path = changed_db3(
        MiniBag("sqlite3").scan(1.0), tmp_path, "UPDATE topics SET type_description_hash = ''",
        "UPDATE message_definitions SET type_description_hash = '', encoded_message_definition = "
        "replace(encoded_message_definition, 'string frame_id', 'uint8[] frame_id')",
    )  # fmt: skip
    refuse(path, "/scan, message 1: expected a frame_id, got array")


def test_two_topics_of_one_number(tmp_path):
    path = MiniBag("ros1").scan(1.0).grid(1.0, 1, 1, [0]).write(tmp_path)
    records = bag1_records(path.read_bytes()[len(MAGIC) :])
    for i, record in enumerate(records):
        if record.op == CONNECTION:
            records[i] = record.put(b"conn", bytes(4))
    path.write_bytes(bag1_bytes(records, offsets=True))
    refuse(path, "two topics share one id")


def test_frames_that_do_not_connect(tmp_path):
    bag = MiniBag().tf("odom", "base_link", 1.0).tf("tower", "laser", 1.0, static=True).scan(1.0)
    path = bag.write(tmp_path)
    refuse(path, r"'base_link' .*'laser' of /scan; the log has \{'odom', 'base_link'\}; \{'tower', 'laser'\}")
    refuse(path, "'base_link' and 'laser'", base_frame="base_link")


def test_only_the_sensors_without_a_chain_are_named(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 1.0, static=True).scan(1.0).scan(1.0, topic="/depth", frame="camera")
    path = bag.write(tmp_path)
    text = refuse(path, "'base_link' and the sensor's frame 'camera' of /depth")
    assert "/scan" not in text
    assert list(read_bag(path, sensor_topic="/scan").sensors) == ["/scan"]
    path = MiniBag().tf("chassis", "mast", 1.0).scan(1.0).write(tmp_path, "other")
    refuse(path, "no frame base_link or base_footprint.*'laser' of /scan.*{'chassis', 'mast'}")


def test_a_map_frame_that_is_not_there_or_does_not_connect(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 1.0, static=True).tf("map", "world", 1.0, static=True).scan(1.0)
    path = bag.write(tmp_path)
    refuse(path, "no frame 'earth'", InvalidInputError, map_frame="earth")
    refuse(path, "'map' and the robot 'base_link'", map_frame="map")
    assert any("'map' is not connected" in note for note in read_bag(path).notes)


def test_stamps_that_run_backwards(tmp_path):
    path = MiniBag().scan(5.0, recorded=1.0).scan(6.0, recorded=2.0).scan(3.0, recorded=3.0).write(tmp_path)
    refuse(path, r"/scan, message 3: the stamps run backwards, from 6\.000000 to 3\.000000 s; cut the bag there")


@pytest.mark.parametrize(
    "stamps",
    [
        np.r_[0.0:10.0:0.1, 9.0:20.0:0.1],  # a clock that was set back by a second
        np.r_[0.0:10.0:0.1, 9.3:20.0:0.3],  # so few scans a second that only the first is late
        np.ravel(np.column_stack([np.r_[1.0:10.0:0.1], np.r_[0.0:9.0:0.1]])),  # two publishers
        np.r_[50.0:60.0:0.1, np.zeros(5), 60.0:70.0:0.1],  # several scans without a stamp
        np.where(np.arange(200) % 10 == 5, 99.0, np.r_[0.0:20.0:0.1]),  # a stamp in ten is wrong
    ],
)
def test_stamps_of_a_clock_that_is_wrong(stamps):
    with pytest.raises(FormatError, match="the stamps run backwards"):
        ordered_stamps(stamps, Path("bag"), "/scan", [])


@pytest.mark.parametrize(
    ("wrong", "stamp"), [(0, 99.0), (100, 99.0), (100, 25.0), (198, 99.0), (100, 0.0), (199, 0.0), (100, -1e9)]
)
def test_few_messages_whose_stamps_alone_are_wrong_are_left_out(wrong, stamp):
    stamps, notes = np.r_[50.0:70.0:0.1][:200] - 40.0, []
    stamps[wrong] = stamp
    found, order = ordered_stamps(stamps, Path("bag"), "/scan", notes)
    rest = np.delete(np.arange(200), wrong)
    assert order.tolist() == rest.tolist()
    assert found.tolist() == stamps[rest].tolist()
    (note,) = notes
    assert f"1 of 200 messages left out, whose stamps alone are wrong (message {wrong + 1}: {stamp:.6f} s" in note


def test_a_scan_and_a_pose_whose_stamps_alone_are_wrong_are_left_out(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 1.0, static=True)
    for i in range(8):
        bag.scan(1e9 if i == 4 else 1.0 + i, [2.0 + 0.1 * i] * 3, recorded=1.0 + i)
        message = bag.pose(0.0 if i == 3 else 20.0 + i, (float(i), 0.0)).messages.pop()
        bag.add(message[0], message[1], message[3], 1.0 + i)
    log = read_bag(bag.write(tmp_path))
    assert log.only_sensor().ranges[:, 0].round(3).tolist() == [2.0, 2.1, 2.2, 2.3, 2.5, 2.6, 2.7]
    assert sum("left out, whose stamps alone are wrong" in note for note in log.notes) == 2


def test_poses_whose_stamps_run_backwards(tmp_path):
    bag = MiniBag().scan(1.0)
    for i, time in enumerate((5.0, 6.0, 1.0)):
        message = bag.pose(time, (0.0, 0.0)).messages.pop()
        bag.add(message[0], message[1], message[3], 1.0 + i)
    refuse(bag.write(tmp_path), "/amcl_pose, message 3: the stamps run backwards")


def test_a_scan_without_beams(tmp_path):
    refuse(MiniBag().scan(1.0).scan(2.0, []).write(tmp_path), "/scan, message 2: the scan has no beams")


def test_signalling_nans_of_damaged_scans_are_no_measurements(tmp_path):
    signalling = np.array([0x7FA00000, 0x3F800000, 0x3F800000], np.uint32).view(np.float32)
    log = read_bag(MiniBag().scan(1.0, signalling).write(tmp_path), mount=(0.0, 0.0, 0.0))
    assert np.isnan(log.only_sensor().ranges[0]).tolist() == [True, False, False]


def test_signalling_nans_of_damaged_rangers_are_refused(tmp_path):
    signalling = np.array([0x7FA00000] * 4, np.uint32).view(np.float32)
    refuse(MiniBag().raw(1.0, signalling, "/cf/state_ranger_qxyzw").write(tmp_path), "finite numbers, got .*nan")


def test_scans_of_nothing_but_nan(tmp_path):
    path = MiniBag().scan(1.0, [np.nan] * 3).scan(2.0, [np.nan] * 3).write(tmp_path)
    refuse(path, "/scan: every range of all 2 scans is NaN")


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        ({"angle_min": 0.5}, "message 2: angle_min 0.5.*no beam where most scans .* two sensors"),
        ({"angle_min": np.nan}, "message 2: expected a finite angle_min"),
        ({"increment": 14.3}, "message 2: .*full turn.*degrees"),
        ({"range_max": 20.0}, "message 2: range_max 20 m differs .* first scan, 10 m; give max_range$"),
        ({"frame": "other"}, "message 2: frame_id 'other' .*: cut the bag there"),
    ],
)
def test_a_sensor_that_changes_within_its_topic(change, pattern, tmp_path):
    refuse(MiniBag().scan(1.0).scan(2.0, **change).write(tmp_path), pattern)


@pytest.mark.parametrize(
    ("scan", "pattern"),
    [
        ({"increment": 0.0, "angle_max": 1.0}, "angle_increment that is not 0"),
        ({"angle_min": np.inf}, "finite angle_min"),
        ({"increment": 14.3}, "full turn.*degrees"),
        ({"range_max": np.inf}, "range_max"),
        ({"range_max": 1e4}, r"range_max <= 3000, got 0.1 and 10000; give max_range \(the furthest reading is 3 m\)"),
        ({"range_max": 0.0}, r"give max_range \(the furthest reading is 3 m\)"),
        ({"range_min": np.nan}, "range_min"),
        ({"range_min": -1.0}, "range_min"),
    ],
)
def test_angles_and_limits_without_sense(scan, pattern, tmp_path):
    refuse(MiniBag().scan(1.0, **scan).write(tmp_path), f"/scan.*{pattern}")


def test_given_limits_without_sense(tmp_path):
    path = MiniBag().scan(1.0).write(tmp_path)
    with pytest.raises(InvalidInputError, match="min_range < max_range"):
        read_bag(path, min_range=3.0, max_range=2.0)
    for limits in ({"min_range": -1.0}, {"max_range": 0.0}, {"max_range": np.inf}):
        ((name, value),) = limits.items()
        with pytest.raises(InvalidInputError, match=f"{name}: expected a finite number of metres >=? 0, got {value}"):
            read_bag(path, **limits)


def test_one_mount_for_two_sensors(tmp_path):
    path = MiniBag().scan(1.0).scan(1.0, topic="/other").write(tmp_path)
    refuse(path, "one mount was given, but the bag has 2 sensors", InvalidInputError, mount=(0, 0, 0))


def test_a_bent_mount(tmp_path):
    path = MiniBag().scan(1.0).write(tmp_path)
    with pytest.raises(InvalidInputError, match="mount: expected finite"):
        read_bag(path, mount=(0.0, np.nan, 0.0))
    with pytest.raises(InvalidInputError, match="heading of mount: expected radians, at most a full turn, got 90"):
        read_bag(path, mount=(0.0, 0.0, 90.0))


@pytest.mark.parametrize(("xy", "q"), [((np.nan, 0.0), (0, 0, 0, 1.0)), ((0.0, 0.0), (0.0, 0, 0, 0))])
def test_poses_that_are_none(xy, q, tmp_path):
    bag = MiniBag().scan(1.0).odometry(0.5, (0.0, 0.0), topic="/ground_truth")
    path = bag.odometry(1.5, xy, q=q, topic="/ground_truth").write(tmp_path)
    refuse(path, "/ground_truth, message 2: pose: expected")


def test_a_transform_that_is_none_names_its_message(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 1.0, static=True).tf("odom", "base_link", 1.0)
    path = bag.tf("odom", "base_link", 2.0, (np.nan, 0.0, 0.0)).scan(1.5).write(tmp_path)
    refuse(path, "/tf, message 2: transform from 'odom' to 'base_link': expected finite")


def test_a_pose_topic_without_messages(tmp_path):
    path = MiniBag().scan(1.0).declare("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped").write(tmp_path)
    refuse(path, "/amcl_pose: the topic holds no poses", poses_topic="/amcl_pose")


@pytest.mark.parametrize("size", [2**31, 2**32 - 1, 5000])
def test_an_array_that_claims_an_absurd_size(size, tmp_path):
    path = MiniBag("sqlite3").scan(1.0).scan(2.0).write(tmp_path)
    with sqlite3.connect(storage_file(path)) as base:
        data = bytearray(base.execute("SELECT data FROM messages WHERE id = 2").fetchone()[0])
        where = data.index(struct.pack("<I3f", 3, 1.0, 2.0, 3.0))
        data[where : where + 4] = struct.pack("<I", size)
        base.execute("UPDATE messages SET data = ? WHERE id = 2", (bytes(data),))
    base.close()
    refuse(path, "/scan, message 2: the bag is damaged or truncated")


def test_ranger_messages_that_are_too_short(tmp_path):
    path = MiniBag("ros1").raw(1.0, [1.0, 2.0], "/cf/state_ranger_qxyzw").write(tmp_path)
    refuse(path, "message 1: expected 9 finite numbers")
    assert RAW in refuse(MiniBag("ros1").raw(1.0, [1.0], "/other").write(tmp_path, "other"), "no scans")


@pytest.mark.parametrize(
    ("grid", "pattern"),
    [
        ({"width": 3, "height": 2, "data": [0] * 5}, "width 3 x height 2 cells, got 5"),
        ({"width": 2**31, "height": 2**31, "data": [0]}, "got 1"),
        ({"width": 0, "height": 0, "data": []}, "got 0"),
        ({"width": 1, "height": 1, "data": [101]}, "got 101"),
        ({"width": 1, "height": 1, "data": [0], "resolution": 0.0}, "resolution"),
        ({"width": 1, "height": 1, "data": [0], "xy": (np.nan, 0.0)}, "origin"),
        ({"width": 1, "height": 1, "data": [0], "q": (0.0, 0.0, 0.0, 3.0)}, "length 1"),
        ({"width": 1, "height": 1, "data": [0], "q": (0.0, 0.0, 0.0, 1e300)}, "length 1"),
        ({"width": 1, "height": 1, "data": [0], "q": quaternion(roll=1.0)}, "about z only"),
    ],
)
def test_maps_without_sense(grid, pattern, tmp_path):
    path = MiniBag().grid(1.0, **grid).write(tmp_path)
    refuse(path, f"/map, message 1: .*{pattern}", read=read_bag_map)


def test_bags_without_a_map_or_with_several(tmp_path):
    path = MiniBag().scan(1.0).write(tmp_path)
    refuse(path, "no map.*'/scan'", read=read_bag_map)
    path = MiniBag().grid(1.0, 1, 1, [0], topic="/a").grid(1.0, 1, 1, [0], topic="/b").write(tmp_path, "two")
    refuse(path, "several map topics.*'/a', '/b'", InvalidInputError, read=read_bag_map)
    path = MiniBag().declare("/map", "nav_msgs/msg/OccupancyGrid").write(tmp_path, "none")
    refuse(path, "no message", read=read_bag_map)
