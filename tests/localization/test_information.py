"""Features are no sufficient statistics (6.42): an exact toy, and simulated rooms."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.rooms import drawn_room

from beamfield.detections import Detections
from beamfield.errors import TooLittleDataError
from beamfield.features.corners import find_corners
from beamfield.features.feature import stack_features
from beamfield.features.lines import find_lines
from beamfield.features.sweep import RangeNoise
from beamfield.localization.information import information_of_features
from beamfield.localization.pose_posterior import PoseLattice, pose_posterior
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.sensors import RangeFinder

SIGMA = 0.05
FINDER = RangeFinder.from_bearings(np.radians(np.arange(-180.0, 180.0, 5.0)), 9.0)
BEAMS = BeamParameters(z_hit=0.97, z_short=0.0, z_max=0.0, z_rand=0.03, sigma_hit=SIGMA, lambda_short=1.0)
BOX = {"reach": 0.16, "resolution": 0.01, "heading_reach": 0.06, "heading_step": 0.005}
NICHES = [(0, 0), (6, 0), (6, 4), (4, 4), (4, 5), (3, 5), (3, 4), (0, 4)]


class TableModel:
    """P(outcome | pose) from a table (cells, headings, outcomes)."""

    is_normalized = True

    def __init__(self, table: np.ndarray) -> None:
        self.table = table

    def log_likelihood(self, z: int, poses: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore"):
            return np.log(self.table[..., z]).reshape(poses.shape[:-1])


LATTICE = PoseLattice.around(np.zeros(3), reach=0.1, resolution=0.1, heading_reach=np.pi, heading_step=np.pi / 2)


def test_what_features_lose_is_exact_on_a_discrete_toy(rng):
    """36 poses, 7 outcomes, of which features tell 3 groups apart; all expectations are sums."""
    table = rng.dirichlet(np.full(7, 0.3), size=(9, 4))
    group = np.array([0, 0, 1, 1, 1, 2, 2])
    features = np.stack([table[..., group == g].sum(axis=-1) for g in range(3)], axis=-1)
    evidence = table.mean(axis=(0, 1))
    each = [
        information_of_features(TableModel(table), z, TableModel(features), int(group[z]), LATTICE) for z in range(7)
    ]
    lost = float(evidence @ [one.lost for one in each])
    divergence = float(evidence @ [one.divergence for one in each])

    def mutual_information(joint):
        return float((joint * np.log(joint / joint.mean(axis=(0, 1)))).sum() / 36.0)

    exact = mutual_information(table) - mutual_information(features)
    assert exact > 0.1
    assert lost == pytest.approx(exact, abs=1e-12)
    assert divergence == pytest.approx(exact, abs=1e-12)
    assert [one.scan.log_evidence for one in each] == pytest.approx(np.log(evidence))


def test_features_may_seem_surer_for_a_single_outcome():
    """A rare outcome that says nothing, merged with a common one that says much."""
    table = np.full((9, 4, 3), [0.01, 0.001, 0.989])
    table[4, 2] = [0.01, 0.9, 0.09]
    merged = np.stack([table[..., :2].sum(axis=-1), table[..., 2]], axis=-1)
    both = information_of_features(TableModel(table), 0, TableModel(merged), 0, LATTICE)
    assert both.scan.information == pytest.approx(0.0, abs=1e-12)
    assert both.lost < -0.5


def test_a_sufficient_statistic_loses_nothing(rng):
    """Outcomes whose likelihoods are proportional say the same about the pose."""
    coarse = rng.dirichlet(np.ones(3), size=(9, 4))
    split = np.array([0.2, 0.8, 0.5, 0.5, 1.0])
    group = np.array([0, 0, 1, 1, 2])
    table = coarse[..., group] * split
    for z in range(5):
        both = information_of_features(TableModel(table), z, TableModel(coarse), int(group[z]), LATTICE)
        assert both.lost == pytest.approx(0.0, abs=1e-12)
        assert both.divergence == pytest.approx(0.0, abs=1e-12)
        assert both.share_kept == pytest.approx(1.0)


def test_no_information_at_all():
    flat = TableModel(np.full((9, 4, 2), 0.5))
    both = information_of_features(flat, 0, flat, 1, LATTICE)
    assert both.scan.entropy == pytest.approx(np.log(36.0))
    assert np.isnan(both.share_kept) or both.scan.information < 1e-9
    with pytest.raises(TooLittleDataError, match="impossible at all 36 poses"):
        information_of_features(flat, 0, TableModel(np.zeros((9, 4, 1))), 0, LATTICE)


@pytest.fixture(scope="module")
def rooms():
    """Scans of a room with a niche, from 12 poses; what lines and what corners keep of each."""
    rng = np.random.default_rng(8)
    grid, walls, corners = drawn_room(NICHES)
    model = BeamModel(grid, BEAMS)
    of_lines = LineModel(walls, LineParameters(0.0, 0.0, 0.01, 9.0), correspondence="sum")
    noise = LandmarkParameters(0.03, 0.01, sigma_signature=0.1, spurious_rate=0.01, max_range=9.0)
    of_corners = LandmarkModel(corners, noise, correspondence="sum")
    result = []
    for _ in range(12):
        pose = rng.uniform([0.8, 0.8, -np.pi], [5.2, 3.2, np.pi])
        [scan] = model.sample(pose[None], FINDER, rng)
        lattice = PoseLattice.around(pose, **BOX)
        lines = find_lines(scan, RangeNoise(SIGMA))
        measured, _ = stack_features(find_corners(lines))
        seen = Detections(*measured.T)
        result.append(
            (
                information_of_features(model, scan, of_lines, LineDetections.from_lines(lines), lattice),
                information_of_features(model, scan, of_corners, seen, lattice),
            )
        )
    return result


def test_lines_and_corners_say_less_than_their_scan_on_average(rooms):
    for kind in (0, 1):
        lost = np.array([both[kind].lost for both in rooms])
        divergence = np.array([both[kind].divergence for both in rooms])
        assert lost.mean() > 2.0 * lost.std() / np.sqrt(len(lost)) > 0.0
        assert divergence.min() > 0.0


def test_steps_were_fine_enough_for_the_scan():
    """Half the steps add log 8 to the entropy of the cells, and leave what the scan tells nearly as it is."""
    rng = np.random.default_rng(2)
    model, pose = BeamModel(drawn_room(NICHES)[0], BEAMS), np.array([2.0, 1.5, 0.4])
    [scan] = model.sample(pose[None], FINDER, rng)
    box = {**BOX, "reach": 0.08, "heading_reach": 0.03}
    half = {**box, "resolution": BOX["resolution"] / 2.0, "heading_step": BOX["heading_step"] / 2.0}
    coarse, fine = (pose_posterior(model, scan, PoseLattice.around(pose, **each)) for each in (box, half))
    assert fine.entropy - coarse.entropy == pytest.approx(np.log(8.0), abs=0.05)


def test_the_empty_map_of_a_corridor_tells_nothing_along_it():
    """Two parallel walls, the ends out of reach: neither lines nor scan know where along it the robot is."""
    rng = np.random.default_rng(3)
    grid, walls, _ = drawn_room([(0, 0), (30, 0), (30, 2), (0, 2)])
    finder = RangeFinder.from_bearings(np.radians(np.arange(-180.0, 180.0, 5.0)), 5.0)
    model = BeamModel(grid, BeamParameters(0.95, 0.0, 0.03, 0.02, SIGMA, 1.0))
    pose = np.array([15.0, 1.2, 0.1])
    [scan] = model.sample(pose[None], finder, rng)
    lattice = PoseLattice.around(pose, **BOX)
    lines = LineDetections.from_lines(find_lines(scan, RangeNoise(SIGMA)))
    of_lines = LineModel(walls, LineParameters(0.0, 0.0, 0.01, 9.0), correspondence="sum")
    both = information_of_features(model, scan, of_lines, lines, lattice)
    mass = np.exp(both.features.log_mass).sum(axis=1).reshape(lattice.inside.shape)
    # The lattice is turned with the pose by 0.1 rad: rows and columns are nearly across and along the walls.
    assert mass.sum(axis=0).max() / mass.sum(axis=0).mean() < 1.5
    assert mass.sum(axis=1).max() / mass.sum(axis=1).mean() > 4.0
    assert 0.5 < both.share_kept < 1.02
