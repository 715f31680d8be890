"""Posteriors on a lattice: exact values on constructed cases, and convergence with the steps."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import compose, wrap_angle
from beamfield.localization.pose_posterior import PoseLattice, pose_posterior, posterior_of
from beamfield.maps.occupancy import OccupancyGrid

CENTRE = np.array([1.0, -2.0, 3.1])
COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, -0.003], [0.002, -0.003, 0.01]])


class GaussianModel:
    """A likelihood that is Gaussian in the pose, whatever is measured."""

    is_normalized = False

    def log_likelihood(self, z: object, poses: np.ndarray) -> np.ndarray:
        del z
        away = poses - CENTRE
        away[..., 2] = wrap_angle(away[..., 2])
        return -0.5 * np.einsum("...i,ij,...j->...", away, np.linalg.inv(COVARIANCE), away) - 1e4


def box(step: float = 0.1) -> PoseLattice:
    return PoseLattice.around(CENTRE, reach=1.4, resolution=step, heading_reach=0.75, heading_step=0.5 * step)


def test_a_measurement_that_says_nothing_leaves_the_prior():
    lattice = box()
    flat = posterior_of(np.full((lattice.inside.sum(), len(lattice.headings)), -700.0), lattice)
    assert flat.entropy == pytest.approx(flat.prior_entropy, rel=1e-12)
    assert flat.information == pytest.approx(0.0, abs=1e-9)
    assert flat.log_evidence == pytest.approx(-700.0)
    assert flat.prior_entropy == np.log(lattice.n_poses)


def test_certainty_has_no_entropy():
    lattice = box()
    values = np.full((lattice.inside.sum(), len(lattice.headings)), -np.inf)
    values[5, 3] = -1e5
    sure = posterior_of(values, lattice)
    assert sure.entropy == 0.0
    assert sure.information == np.log(lattice.n_poses)
    assert sure.best_pose().tolist() == [*lattice.centres()[5], lattice.headings[3]]
    values[9, 0] = -1e5
    assert posterior_of(values, lattice).entropy == pytest.approx(np.log(2.0))


def entropy_of_density(step: float) -> float:
    """Return the entropy of the cells plus the log of a cell's metres^2 radians."""
    return pose_posterior(GaussianModel(), None, box(step)).entropy + np.log(step**2 * 0.5 * step)


def test_the_entropy_of_the_density_is_a_gaussians_once_steps_are_finer_than_the_peak():
    exact = 0.5 * np.log(np.linalg.det(2.0 * np.pi * np.e * COVARIANCE))
    assert entropy_of_density(0.1) == pytest.approx(exact, abs=2e-4)
    assert entropy_of_density(0.05) == pytest.approx(exact, abs=2e-4)
    assert abs(entropy_of_density(0.35) - exact) > 1e-3


def test_divergence_is_that_of_gaussians_and_infinite_where_a_pose_is_excluded():
    lattice = box(0.1)
    p = pose_posterior(GaussianModel(), None, lattice)
    shape = p.log_mass.shape
    flat = posterior_of(np.zeros(shape), lattice)
    assert p.divergence_from(flat) == pytest.approx(p.information)
    assert p.divergence_from(p) == 0.0
    values = np.zeros(shape)
    values[0] = -np.inf
    without = posterior_of(values, lattice)
    assert flat.divergence_from(without) == np.inf
    assert without.divergence_from(flat) == pytest.approx(np.log(shape[0] / (shape[0] - 1)))
    with pytest.raises(InvalidInputError, match="posteriors on the same lattice"):
        p.divergence_from(pose_posterior(GaussianModel(), None, box(0.2)))


def test_a_map_is_covered_where_it_is_free():
    values = np.zeros((4, 6), dtype=np.int8)
    values[0], values[2, 2] = 100, -1
    origin = np.array([3.0, -1.0, 0.5])
    grid = OccupancyGrid.from_ros(values, 0.5, origin)
    lattice = PoseLattice.over_map(grid, resolution=0.25, headings=8)
    assert lattice.inside.shape == (8, 12)
    assert lattice.n_poses == 8 * 4 * (24 - 6 - 1)
    first = compose(origin, [0.125, 0.625, 0.0])
    np.testing.assert_allclose(lattice.centres()[0], first[:2])
    assert not lattice.inside[:2].any()


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (1e5, -1e5, 0.0), (3.1, -7.3, 0.4)])
def test_which_cells_are_free_does_not_depend_on_where_the_map_is(origin, rng):
    """At twice the map's resolution, every centre lies on borders of cells."""
    values = 100 * (rng.random((40, 60)) < 0.3).astype(np.int8)
    lattice = PoseLattice.over_map(OccupancyGrid.from_ros(values, 0.05, origin), resolution=0.1, headings=4)
    assert np.array_equal(lattice.inside, values[1::2, 1::2] == 0)


def test_a_full_turn_is_covered_once():
    lattice = PoseLattice.around(CENTRE, reach=0.1, resolution=0.1, heading_reach=np.pi, heading_step=0.4)
    assert len(lattice.headings) == 16
    assert lattice.heading_step * 16 == pytest.approx(2.0 * np.pi)
    np.testing.assert_allclose(np.diff(np.sort(lattice.headings)), np.pi / 8.0, atol=1e-12)


def test_the_headings_over_a_map_start_at_0_and_are_a_step_apart():
    grid = OccupancyGrid.from_ros(np.zeros((2, 2), dtype=np.int8), 0.5)
    lattice = PoseLattice.over_map(grid, headings=6)
    np.testing.assert_allclose(np.degrees(lattice.headings[[0, 1, 2, 4, 5]]), [0.0, 60.0, 120.0, -120.0, -60.0])
    assert abs(np.degrees(lattice.headings[3])) == pytest.approx(180.0)
    assert np.degrees(lattice.heading_step) == pytest.approx(60.0)


def test_an_impossible_measurement_has_no_posterior():
    lattice = box(0.7)
    shape = (int(lattice.inside.sum()), len(lattice.headings))
    with pytest.raises(TooLittleDataError, match=f"impossible at all {lattice.n_poses} poses"):
        posterior_of(np.full(shape, -np.inf), lattice)
    with pytest.raises(InvalidInputError, match="below infinity, got nan"):
        posterior_of(np.full(shape, np.nan), lattice)
    with pytest.raises(InvalidInputError, match="log_likelihood: expected shape"):
        posterior_of(np.zeros((1, 1)), lattice)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda grid: PoseLattice.over_map(grid, resolution=0.0), "expected a positive number .*, got 0"),
        (lambda grid: PoseLattice.over_map(grid), "expected a map with free cells"),
        (lambda grid: PoseLattice.over_map(grid, resolution=1e-3, headings=3600), "more than 55,555"),
        (
            lambda _: PoseLattice.around(CENTRE, reach=0.1, resolution=0.2, heading_reach=1.0, heading_step=0.1),
            "at least one positive step",
        ),
        (lambda grid: PoseLattice(grid.origin, 1.0, np.ones((1, 1), bool), np.zeros(9), 1.0), "more than a full turn"),
        (lambda grid: PoseLattice(grid.origin, -1.0, np.ones((1, 1), bool), np.zeros(1), 1.0), "resolution: expected"),
    ],
    ids=["resolution", "nothing free", "too many", "reach", "turn", "negative"],
)
def test_bad_lattices_are_refused(build, message):
    full = OccupancyGrid.from_ros(np.full((4, 4), 100), 0.5)
    with pytest.raises(InvalidInputError, match=message):
        build(full)
