"""A trajectory that fits both the odometry and the map, by least squares over the whole log at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, between, wrap_angle
from beamfield.kernels import chain
from beamfield.kernels import trajectory as kernels
from beamfield.kernels.trajectory import HitNoise, StepNoise, Walls
from beamfield.localization.drive import Drive
from beamfield.localization.hit_noise import fit_hits, painted_walls, stand_on_faces
from beamfield.localization.information_share import information_share

# Odometry's errors have the tails of Student's distribution with so many degrees of freedom: slips are no catastrophe.
# The first rounds have next to no such tails, or a first guess that is off for a while would be taken for two slips.
FREEDOM, FIRST_FREEDOM, FIRST_ROUNDS = 4.0, 100.0, 2
# What is taken to be known about odometry's systematic errors (standard deviations): scale of distances and turns, and
# radians turned per metre.
SYSTEMATIC_DEVIATIONS = np.array([0.05, 0.05, 0.02])
# First guesses: variances per metre and radian, and of a step; hits at worst about the walls.
FIRST_STEP_NOISE = StepNoise(0.03**2, 0.02**2, 0.02**2, 0.05**2, 0.01**2, 1e-7)
# Covariances reckon with at least this noise: along corridors, nothing shows how bad odometry is.
LEAST_STEP_NOISE = StepNoise(0.04**2, 0.01**2, 0.01**2, 0.03**2, 0.005**2, 1e-7)
FIRST_SIGMA, CLUTTER = 0.15, 0.1
# Poses across a broken step know next to nothing of each other: with less information, rounding makes the matrix of a
# log indefinite that stands without readings between two of them.
UNKNOWN_STEP = 1e-4
# Rounds of estimating the noise, steps of each, and when both end (metres or radians); a fit whose last round moved
# less than SETTLED has converged.
ROUNDS, STEPS, TOLERANCE, SETTLED = 10, 8, 1e-3, 0.05
# A sensor none of whose beams is further from their mean direction than this looks ahead only, radians.
AHEAD = np.radians(75.0)
# Its hits lie on faces if so many times as much of their information counts then: 3 to 18 times in plans, at most 0.4
# where real walls are painted thick (logs cut to 60 and 87 degrees).
LESS_TORN = 2.0
# Where walls stand somewhere in their painted cells, hits lie on average off the middle, by this standard deviation in
# cells.
OFFSET_DEVIATION = 0.35


@dataclass(frozen=True, eq=False)
class Noise:
    """How wrong both sensors are.

    Parameters
    ----------
    hits, steps
        Of the end points and of the odometry.
    share
        Share of the end points' information that counts, because their errors depend on each other.
    freedom
        Degrees of freedom of the odometry's errors.
    """

    hits: HitNoise
    steps: StepNoise
    share: float
    freedom: float


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The fitted trajectory.

    Parameters
    ----------
    poses, covariances
        (t, 3) and (t, 3, 3).
    systematic
        (3,) scale errors of odometry's distances and turns, and its radians per metre.
    noise
        As estimated.
    step_errors, step_variances
        (t - 1, 3) of odometry's steps: how far they are from the fitted ones, and what was expected of them.
    converged
        Whether the steps ended by themselves.
    """

    poses: FloatArray
    covariances: FloatArray
    systematic: FloatArray
    noise: Noise
    step_errors: FloatArray
    step_variances: FloatArray
    converged: bool


def smooth(drive: Drive, walls: Walls, poses: FloatArray, cut: NDArray[np.bool_],
           progress: Callable[[int, int], None]) -> Smoothed:  # fmt: skip
    """Fit a trajectory, from poses (t, 3) on, and the noise of its sensors, in turn.

    `cut` (t - 1,) are the steps over which odometry says nothing.

    The first round takes hits to lie anywhere in the walls. A sensor that looks ahead only then puts the robot too far
    ahead, where they seem to. So its drive is fitted to the walls' faces as well; the corrections that the beams on the
    left and on the right ask for agree where that is right.
    """
    fitted, on_faces = _smoothed(drive, walls, poses, cut, progress, on_faces=None)
    if on_faces or not _looks_ahead(drive):
        return fitted
    other, _ = _smoothed(drive, walls, fitted.poses, cut, progress, on_faces=True)
    return other if other.noise.share > LESS_TORN * fitted.noise.share else fitted


def _looks_ahead(drive: Drive) -> bool:
    directions = drive.points[:, 2:]
    if not len(directions):
        return False
    middle = directions.mean(axis=0)
    return bool((directions @ middle).min() > math.cos(AHEAD) * math.hypot(*middle))


def _smoothed(drive: Drive, walls: Walls, poses: FloatArray, cut: NDArray[np.bool_],
              progress: Callable[[int, int], None], *, on_faces: bool | None) -> tuple[Smoothed, bool]:  # fmt: skip
    """Fit a trajectory to hits on the walls' faces, or not; None lets the first round tell. Return that, too."""
    noise = Noise(painted_walls(FIRST_SIGMA, CLUTTER, walls), FIRST_STEP_NOISE, 0.2, FIRST_FREEDOM)
    state, faces = _State(poses.copy(), np.zeros(3)), bool(on_faces)
    for done in range(ROUNDS):
        progress(done, ROUNDS)
        solved = _climb(drive, walls, state, cut, noise)
        moved = np.abs(solved.state.poses - state.poses).max()
        state, converged = solved.state, bool(moved < SETTLED)
        if done == 0 and on_faces is None:
            faces = stand_on_faces(_signed(drive, walls, state, False), walls)
        previous, noise = noise, _estimated(drive, walls, solved, cut, noise, faces)
        if done + 1 == FIRST_ROUNDS:
            noise = replace(noise, freedom=FREEDOM)
        elif moved < TOLERANCE and _alike(previous, noise):
            break
    poses = state.poses.copy()
    poses[:, 2] = wrap_angle(poses[:, 2])
    # Where scans say little, the odometry's noise was estimated from little.
    wheels = StepNoise(*(max(pair) for pair in zip(noise.steps, LEAST_STEP_NOISE, strict=True)))
    cautious = replace(noise, steps=wheels)
    solved = _Solved(state, *_linearised(drive, walls, state, cut, cautious).solve(0.0)[2:])
    progress(ROUNDS, ROUNDS)
    fitted = Smoothed(poses, solved.honest_covariances(walls, faces), state.systematic, noise,
                      _step_errors(drive, state), _variances(drive, noise, cut), converged)  # fmt: skip
    return fitted, faces


@dataclass(frozen=True, eq=False)
class _State:
    poses: FloatArray
    systematic: FloatArray


@dataclass(frozen=True, eq=False)
class _Solved:
    state: _State
    covariances: FloatArray
    cross: FloatArray
    shifts: FloatArray

    def honest_covariances(self, walls: Walls, on_faces: bool) -> FloatArray:
        """Return the poses' covariances with what the linearised fit does not know of."""
        offset = 0.0 if on_faces else OFFSET_DEVIATION * walls.resolution
        return np.asarray(self.covariances + offset**2 * self.shifts[:, :, None] * self.shifts[:, None, :])


def _climb(drive: Drive, walls: Walls, state: _State, cut: NDArray[np.bool_], noise: Noise) -> _Solved:
    """Take damped Gauss-Newton steps; return where they end, with marginals."""
    damping = 1e-6
    cost = _cost(drive, walls, state, cut, noise)
    for _ in range(STEPS):
        system = _linearised(drive, walls, state, cut, noise)
        while True:
            move, systematic, *_ = system.solve(damping)
            trial = _State(state.poses + move, state.systematic + systematic)
            trial_cost = _cost(drive, walls, trial, cut, noise)
            if trial_cost <= cost or damping > 1e6:
                break
            damping = max(100.0 * damping, 1e-3)
        if trial_cost > cost:
            break
        damping = max(damping * 1e-2, 1e-9)
        state, cost = trial, trial_cost
        if np.abs(move).max() < TOLERANCE:
            break
    return _Solved(state, *_linearised(drive, walls, state, cut, noise).solve(0.0)[2:])


@dataclass(frozen=True, eq=False)
class _System:
    diagonal: FloatArray
    upper: FloatArray
    right: FloatArray
    shift: FloatArray
    border: FloatArray
    corner: FloatArray
    corner_right: FloatArray

    def solve(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return moves of the poses and the systematic errors, the marginals, and the poses' moves if hits shift."""
        n = len(self.diagonal)
        diagonal = self.diagonal.copy()
        index = np.arange(3)
        diagonal[:, index, index] *= 1.0 + damping
        diagonal[:, index, index] += 1e-9
        columns = np.concatenate([self.right[..., None], self.shift[..., None], self.border], axis=2)
        solution, covariances, cross = np.empty_like(columns), np.empty((n, 3, 3)), np.empty((n - 1, 3, 3))
        if not chain.solve_chain(diagonal, self.upper, columns, solution, covariances, cross):
            raise FloatingPointError("the chain's matrix is not positive definite")
        onto = solution[..., 2:]
        schur = self.corner - np.einsum("nip,niq->pq", self.border, onto)
        inverse = np.linalg.inv(0.5 * (schur + schur.T))
        systematic = inverse @ (self.corner_right - np.einsum("nip,ni->p", self.border, solution[..., 0]))
        covariances += np.einsum("nip,pq,njq->nij", onto, inverse, onto)
        cross += np.einsum("nip,pq,njq->nij", onto[:-1], inverse, onto[1:])
        shifted = inverse @ np.einsum("nip,ni->p", self.border, solution[..., 1])
        moves = solution[..., 0] - onto @ systematic
        return moves, systematic, covariances, cross, solution[..., 1] + onto @ shifted


def _linearised(drive: Drive, walls: Walls, state: _State, cut: NDArray[np.bool_], noise: Noise) -> _System:
    t = len(state.poses)
    error, before, after, by_systematic = _step_jacobians(drive, state)
    variances = _variances(drive, noise, cut)
    surprise = np.sum(error**2 / variances, axis=1)
    weight = ((noise.freedom + 3.0) / (noise.freedom + surprise))[:, None] / variances
    weight[cut] = UNKNOWN_STEP
    diagonal, right, border = np.zeros((t, 3, 3)), np.zeros((t, 3)), np.zeros((t, 3, 3))
    for place, jacobian in ((slice(None, -1), before), (slice(1, None), after)):
        weighted = jacobian * weight[..., None]
        diagonal[place] += np.einsum("nki,nkj->nij", weighted, jacobian)
        right[place] -= np.einsum("nki,nk->ni", weighted, error)
        border[place] += np.einsum("nki,nkp->nip", weighted, by_systematic)
    upper = np.einsum("nki,nkj->nij", before * weight[..., None], after)
    weighted = by_systematic * weight[..., None]
    corner = np.einsum("nkp,nkq->pq", weighted, by_systematic) + np.diag(SYSTEMATIC_DEVIATIONS**-2)
    corner_right = -np.einsum("nkp,nk->p", weighted, error) - state.systematic / SYSTEMATIC_DEVIATIONS**2
    gradients, infos, _ = _scan_sums(drive, walls, state, noise)
    diagonal[drive.scans] += noise.share * infos
    right[drive.scans] -= noise.share * gradients[:, :3]
    shift = np.zeros((t, 3))
    shift[drive.scans] = noise.share * gradients[:, 3:]
    return _System(diagonal, np.ascontiguousarray(upper), right, shift, border, corner, corner_right)


def _cost(drive: Drive, walls: Walls, state: _State, cut: NDArray[np.bool_], noise: Noise) -> float:
    surprise = np.sum(_step_errors(drive, state) ** 2 / _variances(drive, noise, cut), axis=1)[~cut]
    costs = _scan_sums(drive, walls, state, noise)[2]
    known = np.sum((state.systematic / SYSTEMATIC_DEVIATIONS) ** 2)
    wheels = 0.5 * (noise.freedom + 3.0) * np.sum(np.log1p(surprise / noise.freedom))
    return float(wheels + noise.share * costs.sum() + 0.5 * known)


def _scan_sums(drive: Drive, walls: Walls, state: _State, noise: Noise
               ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    n = len(drive.scans)
    gradients, infos, costs = np.empty((n, 6)), np.empty((n, 3, 3)), np.empty(n)
    kernels.sum_scans(drive.points, drive.first, state.poses[drive.scans], walls, noise.hits, gradients, infos, costs)
    return gradients, infos, costs


def _corrected_steps(drive: Drive, systematic: FloatArray) -> FloatArray:
    steps = drive.steps.copy()
    steps[:, :2] *= 1.0 + systematic[0]
    steps[:, 2] = (1.0 + systematic[1]) * steps[:, 2] + systematic[2] * drive.steps[:, 0]
    return steps


def _step_errors(drive: Drive, state: _State) -> FloatArray:
    error = between(state.poses[:-1], state.poses[1:]) - _corrected_steps(drive, state.systematic)
    error[:, 2] = wrap_angle(error[:, 2])
    return error


def _step_jacobians(drive: Drive, state: _State) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the steps' errors (n, 3), and derivatives by the poses before and after and the systematic errors."""
    error = _step_errors(drive, state)
    local = between(state.poses[:-1], state.poses[1:])
    cos, sin = np.cos(state.poses[:-1, 2]), np.sin(state.poses[:-1, 2])
    before, after, by_systematic = (np.zeros((len(error), 3, 3)) for _ in range(3))
    after[:, 0, 0], after[:, 0, 1], after[:, 1, 0], after[:, 1, 1], after[:, 2, 2] = cos, sin, -sin, cos, 1.0
    before[:] = -after
    before[:, 0, 2], before[:, 1, 2] = local[:, 1], -local[:, 0]
    by_systematic[:, 0, 0], by_systematic[:, 1, 0] = -drive.steps[:, 0], -drive.steps[:, 1]
    by_systematic[:, 2, 1], by_systematic[:, 2, 2] = -drive.steps[:, 2], -drive.steps[:, 0]
    return error, before, after, by_systematic


def _variances(drive: Drive, noise: Noise, cut: NDArray[np.bool_]) -> FloatArray:
    """(t - 1, 3) of odometry's steps."""
    q = noise.steps
    distance, turn = np.hypot(drive.steps[:, 0], drive.steps[:, 1]), np.abs(drive.steps[:, 2])
    variances = np.stack([q.along * distance + q.turn_aside * turn, q.aside * distance + q.turn_aside * turn,
                          q.drift * distance + q.turn * turn], axis=1) + q.floor  # fmt: skip
    variances[cut] = 1.0 / UNKNOWN_STEP
    return np.asarray(variances)


def _estimated(drive: Drive, walls: Walls, solved: _Solved, cut: NDArray[np.bool_], noise: Noise, on_faces: bool
               ) -> Noise:  # fmt: skip
    """Estimate the noise from what the fitted trajectory leaves."""
    hits = fit_hits(_signed(drive, walls, solved.state, on_faces), walls, on_faces)
    share = information_share(drive, walls, solved.state.poses, hits)
    return Noise(hits, _estimated_steps(drive, solved, cut, noise), share, noise.freedom)


def _signed(drive: Drive, walls: Walls, state: _State, on_faces: bool) -> FloatArray:
    """Return signed distances to the walls (m,), NaN off the map."""
    signed = np.empty(len(drive.points))
    kernels.fill_residuals(drive.points, drive.first, state.poses[drive.scans], walls, on_faces, signed)
    return signed


def _estimated_steps(drive: Drive, solved: _Solved, cut: NDArray[np.bool_], noise: Noise) -> StepNoise:
    """One step of expectation maximisation for the variances per metre and per radian, with Student's weights."""
    error, before, after, _ = _step_jacobians(drive, solved.state)
    p, c = solved.covariances, solved.cross
    mixed = np.einsum("nki,nij,nkj->nk", before, c, after)
    spread = (np.einsum("nki,nij,nkj->nk", before, p[:-1], before) + 2.0 * mixed
              + np.einsum("nki,nij,nkj->nk", after, p[1:], after))  # fmt: skip
    variances = _variances(drive, noise, cut)
    weight = (noise.freedom + 3.0) / (noise.freedom + np.sum(error**2 / variances, axis=1))
    squares = weight[:, None] * error**2 + np.maximum(spread, 0.0)
    distance, turn = np.hypot(drive.steps[:, 0], drive.steps[:, 1]), np.abs(drive.steps[:, 2])
    used = ~cut
    q = noise.steps

    def component(rate: float, size: FloatArray, axes: tuple[int, ...]) -> float:
        top = bottom = 0.0
        for axis in axes:
            ratio = rate * size[used] / variances[used, axis]
            top += float(np.sum(rate * size[used] * (1.0 - ratio) + ratio**2 * squares[used, axis]))
            bottom += float(np.sum(size[used]))
        return max(top / bottom, 1e-10) if bottom > 0.0 else rate

    return StepNoise(
        component(q.along, distance, (0,)), component(q.aside, distance, (1,)), component(q.drift, distance, (2,)),
        component(q.turn, turn, (2,)), component(q.turn_aside, turn, (0, 1)), q.floor,
    )  # fmt: skip


def _alike(a: Noise, b: Noise) -> bool:
    return abs(a.hits.sigma / b.hits.sigma - 1.0) < 0.01 and abs(a.share / b.share - 1.0) < 0.02
