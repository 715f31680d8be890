"""The transform buffer against rotation matrices multiplied by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from beamfield.errors import FormatError
from beamfield.io.bags.frames import TransformBuffer


def matrix(translation, rotation) -> np.ndarray:
    """4 x 4 homogeneous matrix."""
    result = np.eye(4)
    result[:3, :3] = Rotation.from_quat(rotation).as_matrix()
    result[:3, 3] = translation
    return result


def matrices(transforms) -> np.ndarray:
    return np.stack([matrix(t, q) for t, q in zip(transforms.translation, transforms.rotation, strict=True)])


def random_transform(rng):
    return rng.normal(size=3), Rotation.random(random_state=rng).as_quat()


def test_a_chain_with_links_in_both_directions_is_the_product_of_matrices(rng):
    up, down, side = (random_transform(rng) for _ in range(3))
    buffer = TransformBuffer("log")
    buffer.add("a", "b", 0.0, *up, static=True)
    buffer.add("c", "b", 0.0, *down, static=True)
    buffer.add("c", "d", 0.0, *side, static=True)
    expected = matrix(*up) @ np.linalg.inv(matrix(*down)) @ matrix(*side)
    assert np.allclose(matrices(buffer.look_up("a", "d", [5.0]))[0], expected, atol=1e-12)
    assert np.allclose(matrices(buffer.look_up("d", "a", [5.0]))[0], np.linalg.inv(expected), atol=1e-12)


def test_moving_links_are_interpolated_linearly_and_spherically(rng):
    buffer = TransformBuffer("log")
    samples = [random_transform(rng) for _ in range(6)]
    times = np.array([0.0, 0.5, 0.7, 2.0, 2.1, 3.0])
    for time, sample in zip(times, samples, strict=True):
        buffer.add("odom", "base", time, *sample)
    when = rng.uniform(0.0, 3.0, 200)
    found = buffer.look_up("odom", "base", when)
    rotation = Slerp(times, Rotation.from_quat([q for _, q in samples]))(when)
    for axis in range(3):
        assert np.allclose(
            found.translation[:, axis], np.interp(when, times, [t[axis] for t, _ in samples]), atol=1e-12
        )
    turn = (Rotation.from_quat(found.rotation) * rotation.inv()).magnitude()
    assert turn.max() < 1e-7


def test_nothing_is_known_outside_the_samples_or_in_a_gap():
    buffer = TransformBuffer("log")
    for time in (1.0, 1.5, 9.0):
        buffer.add("odom", "base", time, (time, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    x = buffer.look_up("odom", "base", [0.999, 1.0, 1.25, 1.5, 5.0, 9.0, 9.001], max_gap=2.0).translation[:, 0]
    assert np.array_equal(x, [np.nan, 1.0, 1.25, 1.5, np.nan, 9.0, np.nan], equal_nan=True)
    held = buffer.look_up("odom", "base", [0.0, 99.0], hold=True).translation[:, 0]
    assert held.tolist() == [1.0, 9.0]


def test_a_single_sample_holds_only_at_its_time():
    buffer = TransformBuffer("log")
    buffer.add("odom", "base", 4.0, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert np.isfinite(buffer.look_up("odom", "base", [3.0, 4.0, 5.0]).translation[:, 0]).tolist() == [
        False,
        True,
        False,
    ]


def test_unsorted_and_repeated_stamps_are_put_in_order_and_the_last_one_counts():
    buffer = TransformBuffer("log")
    for time, x in ((2.0, 20.0), (1.0, 1.0), (2.0, 2.0), (0.0, 0.0)):
        buffer.add("odom", "base", time, (x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert buffer.look_up("odom", "base", [0.5, 1.5, 2.0]).translation[:, 0].tolist() == [0.5, 1.5, 2.0]
    assert buffer.stamps_between("odom", "base").tolist() == [0.0, 1.0, 2.0]


def test_the_last_static_transform_counts():
    buffer = TransformBuffer("log")
    for x in (1.0, 2.0):
        buffer.add("base", "laser", 0.0, (x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), static=True)
    assert buffer.look_up("base", "laser", [123.0]).translation[0, 0] == 2.0
    assert len(buffer.stamps_between("base", "laser")) == 0


def test_all_frames_are_known_only_if_static_transforms_and_others_were_recorded():
    buffer, still = TransformBuffer("log"), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert buffer.all_if_whole() == ()
    buffer.add("odom", "base", 0.0, *still)
    assert buffer.all_if_whole() == ()
    buffer.add("base", "laser", 0.0, *still, static=True)
    assert buffer.all_if_whole() == ("odom", "base", "laser")


def test_leading_slashes_do_not_matter_and_empty_names_are_skipped():
    buffer = TransformBuffer("log")
    buffer.add("/odom", "/base", 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), static=True)
    buffer.add("odom", "", 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    buffer.add("odom", "/odom", 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert buffer.frames == ["odom", "base"]
    assert buffer.connected("odom", "base")
    assert not buffer.connected("odom", "nowhere")
    assert buffer.connected("nowhere", "nowhere")


def test_unconnected_frames_are_named_with_the_trees_that_are_known():
    buffer = TransformBuffer("some.bag")
    buffer.add("odom", "base", 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    buffer.add("arm", "laser", 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    with pytest.raises(FormatError, match=r"some\.bag.*'base' and 'laser'.*\{'odom', 'base'\}; \{'arm', 'laser'\}"):
        buffer.look_up("base", "laser", [0.0])


@pytest.mark.parametrize(
    ("values", "what"),
    [
        (((np.nan, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), "finite"),
        (((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)), "length 1"),
        (((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0)), "length 1"),
        (((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.011)), "length 1"),
    ],
)
def test_what_is_no_transform_is_an_error_only_for_those_who_use_it(values, what):
    buffer = TransformBuffer("some.bag")
    buffer.add("odom", "base", 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), place="/tf, message 1")
    buffer.add("base", "camera", 0.0, *values, place="/tf, message 2")
    assert np.isfinite(buffer.look_up("odom", "base", [0.0]).translation).all()
    with pytest.raises(FormatError, match=f"/tf, message 2: transform from 'base' to 'camera': .*{what}"):
        buffer.look_up("odom", "camera", [0.0])


def test_headings_of_planar_poses_survive_a_roll_of_half_a_turn():
    buffer = TransformBuffer("log")
    rotation = (Rotation.from_euler("z", 0.7) * Rotation.from_euler("x", np.pi)).as_quat()
    buffer.add("base", "laser", 0.0, (1.0, 2.0, 3.0), rotation, static=True)
    assert np.allclose(buffer.look_up("base", "laser", [0.0]).planar(), [[1.0, 2.0, 0.7]], atol=1e-12)
