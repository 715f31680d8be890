"""Beluga's filter: its clusters against a slow transcription, and where its loop differs from AMCL's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose, invert, wrap_angle
from beamfield.localization.replay import PoseBelief
from beamfield.sensors import SensorLog
from beamfield.stacks.beluga.clusters import cluster_labels, heaviest_cluster
from beamfield.stacks.beluga.filter import BelugaFilterParameters
from beamfield.stacks.beluga.models import BelugaField, BelugaFieldProb
from beamfield.stacks.filters.amcl_filter import AmclFilterParameters
from beamfield.stacks.nav2.models import Nav2FieldProb
from beamfield.stacks.registry import build_filter
from tests.stacks.small_room import small_room
from tests.stacks.test_emulators_contract import BELUGA, NAV2
from tests.stacks.test_filters import START, drive

STEPS = [(0.2, 0, 0), (-0.2, 0, 0), (0, 0.2, 0), (0, -0.2, 0), (0, 0, 0.524), (0, 0, -0.524)]


def beluga_filter(**changes):
    return build_filter("beluga", BelugaField(small_room(), BELUGA), parameters=BelugaFilterParameters(**changes))


def cell(pose) -> tuple[int, int, int]:
    heading = float(wrap_angle(pose[2]))
    return math.floor(pose[0] / 0.2), math.floor(pose[1] / 0.2), math.floor(heading / 0.524)


def slow_labels(poses, weights) -> list[int]:
    """The same clusters: peaks from the highest down, each flooding downhill, cell by cell."""
    members: dict[tuple[int, int, int], list[int]] = {}
    for i, pose in enumerate(poses):
        members.setdefault(cell(pose), []).append(i)
    mean = {key: sum(weights[i] for i in those) / len(those) for key, those in members.items()}
    cap = sorted(mean.values())[int(len(mean) * 0.9)]
    mean = {key: min(value, cap) for key, value in mean.items()}
    label: dict[tuple[int, int, int], int] = {}
    # Equal ones in the order of their cells.
    order = lambda key: (-mean[key], key)  # noqa: E731
    for peak in sorted(mean, key=order):
        if peak in label:
            continue
        label[peak] = len(set(label.values()))
        flood = [peak]
        while flood:
            key = min(flood, key=order)
            flood.remove(key)
            for step in STEPS:
                other = cell(compose(poses[members[key][0]], step))
                if other in mean and other not in label and mean[other] <= mean[key]:
                    label[other] = label[peak]
                    flood.append(other)
    return [label[cell(pose)] for pose in poses]


def test_clusters_are_those_of_a_slow_transcription(rng):
    centres = [(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 3.0, 3.1)]
    poses = np.concatenate([rng.normal(centre, (0.25, 0.25, 0.2), (60, 3)) for centre in centres])
    weights = rng.permutation(np.arange(1.0, 181.0))  # no two cells alike
    weights /= weights.sum()
    found = cluster_labels(poses, weights).tolist()
    assert found == slow_labels(poses, weights)
    assert len(set(found)) > 3


def test_equal_weights_join_what_touches_and_a_turn_about_pi_separates_nothing():
    poses = np.array([[0.1, 0.1, np.pi - 0.1 + 0.02 * i] for i in range(11)])
    assert set(cluster_labels(poses, np.full(11, 1 / 11))) == {0}
    apart = np.concatenate([poses, poses + np.array([5.0, 0.0, 0.0])])
    for far in ([0.0, 0.0, 0.0], [5e5, 5.4e6, 0.0]):
        assert len(set(cluster_labels(apart + far, np.full(22, 1 / 22)))) == 2
    # The rounding of 1 / n makes no cell heavier than the next.
    row = np.repeat([[0.1 + 0.2 * i, 0.1, 0.0] for i in range(10)], np.arange(3, 13), axis=0)
    assert set(cluster_labels(row, np.full(75, 1 / 75))) == {0}


def test_the_answer_is_the_heaviest_cluster_of_more_than_one_particle():
    near, far, lone = [[0.0, 0.0, 0.0]] * 3, [[5.0, 5.0, 1.0]] * 2, [[9.0, 0.0, 0.0]]
    weights = np.array([0.1, 0.1, 0.05, 0.2, 0.15, 0.4])
    np.testing.assert_allclose(heaviest_cluster(np.array(near + far + lone), weights), [5.0, 5.0, 1.0])
    np.testing.assert_allclose(heaviest_cluster(np.array([[1.0, 2.0, 3.0]]), np.ones(1)), [1.0, 2.0, 3.0])


def test_motion_counts_by_its_length():
    log = drive(40, 0.1)
    turned = compose([0.0, 0.0, np.pi / 4], log.odometry)
    log = SensorLog(log.finder, log.stamps, log.ranges, log.poses, turned)
    replay = beluga_filter().run(log, START, np.random.default_rng(1))
    assert replay.updates.tolist() == list(range(0, 40, 3))


def test_the_particles_number_what_kld_sampling_asks_for():
    replay = beluga_filter(min_particles=300, max_particles=900).run(drive(4), START, np.random.default_rng(1))
    assert replay.particles[0] == 300
    assert replay.particles[1] < 900
    replay = beluga_filter(min_particles=700, max_particles=100).run(drive(4), START, np.random.default_rng(1))
    assert replay.particles.tolist() == [100, 100]


def test_every_update_has_an_answer_also_without_resampling():
    log = drive()
    replay = beluga_filter(resample_interval=1000).run(log, START, np.random.default_rng(1))
    anchors = compose(replay.poses, invert(log.odometry))
    assert len(np.unique(anchors.round(9), axis=0)) == len(replay.updates)
    assert (replay.particles == 2000).all()


def test_particles_worth_more_than_half_their_number_are_kept_if_asked_for():
    start = PoseBelief.around(START.mean, sd_position=1e-4, sd_heading=1e-4)  # all alike
    kept = beluga_filter(selective_resampling=True).run(drive(2), start, np.random.default_rng(1))
    assert kept.particles.tolist() == [2000]


def test_weights_that_drop_bring_random_poses_into_amcl_and_not_into_beluga():
    log = drive(4)
    ranges = np.array(log.ranges)
    ranges[1:] = 0.3  # fits nowhere
    log = SensorLog(log.finder, log.stamps, ranges, log.poses, log.odometry)
    rates = {"recovery_alpha_slow": 0.001, "recovery_alpha_fast": 0.9, "min_particles": 2000}
    amcl = build_filter("nav2", Nav2FieldProb(small_room(), NAV2), parameters=AmclFilterParameters(**rates))
    beluga = build_filter("beluga", BelugaFieldProb(small_room(), BELUGA), parameters=BelugaFilterParameters(**rates))
    # Random poses have any heading.
    spread = [np.diff(one.run(log, START, np.random.default_rng(1)).covariances[:, 2, 2])[0] for one in (amcl, beluga)]
    assert spread[0] > 0.2 > 0.1 > spread[1]


def test_what_cannot_be_run_is_refused():
    for values in ({"spatial_resolution_x": 0.0}, {"max_particles": 0}, {"update_min_a": -1.0}, {"pf_err": -1.0}):
        with pytest.raises(InvalidInputError, match=next(iter(values))):
            BelugaFilterParameters(**values)
