"""MRPT's particle filter against slow transcriptions, the compiled program's numbers, and by its consequences."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import wrap_angle
from beamfield.localization.replay import PoseBelief
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.filters.histogram import BinSizes
from beamfield.stacks.mrpt.field import MrptField
from beamfield.stacks.mrpt.filter import MrptFilterParameters
from beamfield.stacks.mrpt.motion import MrptMotion
from beamfield.stacks.mrpt.resampling import METHODS, fast_draws, resampled
from beamfield.stacks.mrpt.sample_size import enough_particles
from beamfield.stacks.mrpt.start import initial_poses
from beamfield.stacks.registry import build_filter
from tests.stacks.small_room import small_room
from tests.stacks.test_emulators_contract import MRPT_FIELD
from tests.stacks.test_filters import START, drive

WEIGHTS = np.array([0.12, 0.30, 0.05, 0.03, 0.22, 0.01, 0.17, 0.10])
STILL = MrptMotion(a1=0.0, a2=0.0, a3=0.0, a4=0.0, minStdXY=0.0, minStdPHI=0.0)
FIXED = MrptFilterParameters(adaptiveSampleSize=False, particles_count=60)


def mrpt_filter(sensor=MRPT_FIELD, **changes):
    return build_filter("mrpt", MrptField(small_room(), sensor), parameters=MrptFilterParameters(**changes))


def slow_resampled(method: str, weights: list[float], rng: np.random.Generator) -> list[int]:
    """computeResampling, one particle at a time, with the numbers drawn in one go."""
    n = len(weights)
    copies, left = [0] * n, list(weights)
    if method == "prResidual":
        copies = [int(n * w) for w in weights]
        left = [n * w - c for w, c in zip(weights, copies, strict=True)]
        left = [w / sum(left) for w in left]
    if method in ("prMultinomial", "prResidual"):
        points = rng.random(n).tolist()
        points = sorted(points) if method == "prResidual" else points
    elif method == "prStratified":
        points = [(i + u) / n for i, u in enumerate(rng.random(n))]
    else:
        first = rng.random(1)[0] / n
        points = [first + i / n for i in range(n)]
    found = [i for i, count in enumerate(copies) for _ in range(count)]
    for point in points[: n - len(found)]:
        j = 0
        while point >= sum(left[: j + 1]):
            j += 1
        found.append(j)
    return found


@pytest.mark.parametrize("method", METHODS)
def test_particles_are_drawn_as_a_slow_transcription_draws_them(method):
    for seed in range(20):
        weights = np.random.default_rng(seed).dirichlet(np.full(9, 0.5))
        found = resampled(method, weights, np.random.default_rng(seed))
        assert found.tolist() == slow_resampled(method, weights.tolist(), np.random.default_rng(seed))


def test_draws_come_as_often_as_from_the_compiled_program(rng):
    """Frequencies of MRPT 2.5.8: of fastDrawSample in 400 000 draws, of the residual ones in 20 000 times 5."""
    seen = np.bincount(fast_draws(WEIGHTS, 100_000, rng), minlength=8) / 100_000
    program = [0.1517, 0.3016, 0.0491, 0.0013, 0.2502, 0.0, 0.1490, 0.0972]
    np.testing.assert_allclose(seen, program, atol=0.005)
    weights = np.array([0.05, 0.3, 0.12, 0.28, 0.25])
    drawn = np.concatenate([resampled("prResidual", weights, rng) for _ in range(4000)])
    np.testing.assert_allclose(np.bincount(drawn) / 4000, [0.602, 1.916, 0.439, 1.042, 1.001], atol=0.03)


def slow_fast_draw(weights: list[float], draw: float) -> int:
    """prepareFastDrawSample and fastDrawSample, one threshold and one particle at a time."""
    starts, sum_, j = [0] * 20, 0.0, 0
    for i, weight in enumerate(weights):
        after = 1.0 if i == len(weights) - 1 else sum_ + weight
        while j < 20 and j / 20 < after:
            starts[j] = i
            j += 1
        sum_ = after
    j = math.floor(draw * 19.95)
    sum_, i = j / 20, starts[j]
    while draw > sum_ + weights[i]:
        sum_ += weights[i]
        i += 1
    return i


def test_fast_draws_are_those_of_a_slow_transcription():
    for seed in range(20):
        weights = np.random.default_rng(seed).dirichlet(np.full(30, 0.3))
        draws = np.random.default_rng(seed).random(50)
        found = fast_draws(weights, 50, np.random.default_rng(seed))
        assert found.tolist() == [slow_fast_draw(weights.tolist(), draw) for draw in draws.tolist()]


@pytest.mark.parametrize(("spread", "enough"), [(0.001, True), (0.05, True), (3.0, False)])
def test_the_number_of_particles_is_that_of_a_loop_over_them(rng, spread, enough):
    poses = rng.normal(0.05, spread, (1500, 3))
    bins, needed, n = set(), 100, 0
    for n, (x, y, heading) in enumerate(poses.tolist(), 1):
        key = round(x / 0.2), round(y / 0.2), round(heading / 0.1)
        if key not in bins:
            bins.add(key)
            k = len(bins) - 1
            if k:
                share = 2.0 / (9.0 * k)  # Wilson and Hilferty's 99% quantile of chi-square
                needed = round(0.5 / 0.02 * k * (1.0 - share + math.sqrt(share) * 2.3263478740408408) ** 3)
        if n >= max(needed, 100):
            break
    found = enough_particles(poses, BinSizes(0.2, 0.2, 0.1), 100, 0.02, 0.01)
    assert found == (n if enough else None)
    assert enough == (n < 1500)


def test_weights_multiply_and_survive_the_resampling():
    """Without noise the particles stay where they started; each update takes the likelihood to its power."""
    log = drive(3, 0.0)
    values = replace(FIXED, powFactor=0.3, BETA=0.0)
    filtered = build_filter("mrpt", MrptField(small_room(), MRPT_FIELD), STILL, values)
    replay = filtered.run(log, START, np.random.default_rng(4))
    poses = initial_poses(filtered.seen, START, 3.0, 60, 10, np.random.default_rng(4))
    gains = 0.3 * filtered.model.log_likelihood(log.scan(0), poses)
    for i in range(3):
        weights = np.exp((i + 1) * (gains - gains.max()))
        np.testing.assert_allclose(replay.means[i, :2], weights @ poses[:, :2] / weights.sum(), atol=1e-9)
    # Where every update resamples, the particles' weights still count: those of the program are not reset.
    often = build_filter("mrpt", MrptField(small_room(), MRPT_FIELD), STILL, replace(values, BETA=2.0))
    spread = [one.run(log, START, np.random.default_rng(4)).covariances[-1] for one in (filtered, often)]
    assert np.trace(spread[1][:2, :2]) < np.trace(spread[0][:2, :2])


def test_of_thrun_all_particles_take_the_same_step():
    wide = MrptMotion("mmThrun", alfa3_trans_trans=0.5, additional_std_XY=0.0, additional_std_phi=0.0)
    log, start = drive(4), PoseBelief.around(START.mean, sd_position=1e-6, sd_heading=1e-6)
    room = small_room()
    flat = replace(MRPT_FIELD, LF_stdHit=50.0)  # says nothing
    thrun, gaussian = (
        build_filter("mrpt", MrptField(room, flat), motion, replace(FIXED, BETA=0.0)).run(
            log, start, np.random.default_rng(1)
        )
        for motion in (wide, MrptMotion(a1=0.5))
    )
    # All but for the cell in which each began.
    np.testing.assert_allclose(thrun.covariances[1:, 0, 0], thrun.covariances[0, 0, 0], rtol=1e-3)
    assert gaussian.covariances[-1, 0, 0] > 1.5 * gaussian.covariances[0, 0, 0]


def test_particles_start_evenly_over_the_free_cells_of_a_box(rng):
    grid = small_room()
    start = PoseBelief.around([1.0, 1.0, 3.0], sd_position=0.1, sd_heading=0.2)
    poses = initial_poses(grid, start, 3.0, 4000, 10, rng)
    assert np.abs(poses[:, :2] - 1.0).max() < 0.3 + 0.1 + 0.1
    assert poses[:, 2].min() == pytest.approx(2.4, abs=0.01)
    assert poses[:, 2].max() == pytest.approx(math.pi, abs=0.01)  # cut off, not wrapped
    turned = PoseBelief.around([1.0, 1.0, 3.0 - 2.0 * math.pi], sd_position=0.1, sd_heading=0.2)
    again = initial_poses(grid, turned, 3.0, 4000, 10, rng)
    assert (again[:, 2].min(), again[:, 2].max()) == pytest.approx((2.4, math.pi), abs=0.01)
    cells = grid.look_up(grid.free, poses[:, :2])
    assert 0.9 < cells.mean() < 1.0  # up to a cell off a free one
    assert len(initial_poses(grid, start, 3.0, 0, 10, rng)) == 100  # of 10 square metres at least
    everywhere = initial_poses(grid, None, 3.0, 0, 100, rng)
    assert len(everywhere) == 1000
    assert np.ptp(everywhere[:, 0]) > 2.0
    walls = OccupancyGrid.from_ros([[100, 0]] + [[100] * 2] * 9, resolution=1.0)
    box = initial_poses(walls, PoseBelief.around([0.0, 5.0, 0.0], sd_position=0.1), 3.0, 500, 1, rng)
    assert np.abs(box[:, :2] - [0.0, 5.0]).max() < 0.3
    with pytest.raises(InvalidInputError, match="initial_particles_per_m2: expected at most"):
        initial_poses(grid, None, 3.0, 0, 10**7, rng)


def test_the_clock_says_which_scans_update():
    log = drive(12)
    log = replace(log, stamps=log.stamps * 0.3)
    assert mrpt_filter().update_scans(log) == list(range(12))
    # Ticks at 0, 1, 2 ... s: the newest scan before each, and the last one.
    assert mrpt_filter(rate_hz=1.0).update_scans(log) == [0, 3, 6, 10, 11]


def test_a_seed_gives_the_same_run_and_the_truth_is_followed():
    log = drive(10)
    first, second = (mrpt_filter().run(log, START, np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first.poses, second.poses)
    assert np.isfinite(first.poses).all()
    assert np.abs(wrap_angle(first.poses[:, 2])).max() <= math.pi
    assert first.particles.min() >= 250


def test_where_all_weights_are_zero_particles_become_equal():
    nothing = replace(MRPT_FIELD, LF_zRandom=0.0, LF_stdHit=1e-6)
    replay = mrpt_filter(sensor=nothing).run(drive(3), START, np.random.default_rng(1))
    assert np.isfinite(replay.poses).all()
    assert replay.covariances[-1, 0, 0] > 1e-3


INI = """\
[KLD_options]
KLD_binSize_PHI=10   // degrees
KLD_maxSampleSize=1000
[PF_options]
PF_algorithm=0
resamplingMethod=3
adaptiveSampleSize=0
BETA=0.7
[LocalizationExperiment]
particles_count=100 500
[MetricMap_occupancyGrid_00_likelihoodOpts]
likelihoodMethod=4
LF_stdHit=0.20
"""
YAML = """\
/**:
  ros__parameters:
    rate_hz: 4.0
    motion_model_2d:
      modelSelection: mmGaussian
      minStdPHI: 3.0
      gaussianModel:
        minStdXY: 0.7
    motion_model_no_odom_2d:
      modelSelection: mmThrun
      gaussianModel:
        minStdXY: 0.4
    pf_options:
      BETA: 0.4
      PF_algorithm: pfStandardProposal
    kld_options:
      KLD_binSize_PHI: 0.17
    override_likelihood_gridmaps:
      likelihoodMethod: 'lmLikelihoodField_Thrun'
      LF_stdHit: 2.0
"""


def test_files_hold_the_filter_in_sections_of_its_own(tmp_path):
    path = tmp_path / "pf.ini"
    path.write_text(INI)
    settings = read_filter_settings(read_stack_file(path))
    assert settings.sensor.LF_stdHit == 0.2
    assert settings.motion == MrptMotion()
    assert settings.particles == MrptFilterParameters(
        adaptiveSampleSize=False, BETA=0.7, resamplingMethod="prSystematic", KLD_binSize_PHI=math.radians(10.0),
        KLD_maxSampleSize=1000, particles_count=100,
    )  # fmt: skip
    path = tmp_path / "pf.yaml"
    path.write_text(YAML)
    settings = read_filter_settings(read_stack_file(path))
    assert settings.sensor.LF_stdHit == 2.0
    # What stands under gaussianModel is not read, and the model for no odometry overwrites the other.
    assert settings.motion == MrptMotion("mmThrun", minStdPHI=3.0)
    assert settings.particles == MrptFilterParameters(BETA=0.4, KLD_binSize_PHI=0.17, rate_hz=4.0)
    # The core takes the file without its two outer levels, too.
    inner = "".join(line[4:] + "\n" for line in YAML.splitlines()[2:])
    path.write_text(inner.replace("rate_hz: 4.0\n", ""))
    again = read_filter_settings(read_stack_file(path))
    assert (again.motion, again.particles) == (settings.motion, replace(settings.particles, rate_hz=2.0))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("PF_algorithm=0", "PF_algorithm=3", r"ini:5: PF_algorithm: expected one of 'pfStandardProposal', got 'pfAux"),
        ("BETA=0.7", "BETA=-1", r"ini:8: BETA: expected a number >= 0"),
        ("adaptiveSampleSize=0", "adaptiveSampleSize=1", r"ini:6: resamplingMethod: expected 'prMultinomial', w"),
        ("100 500", "many", r"ini:10: particles_count: expected a number, got 'many'"),
    ],
)  # fmt: skip
def test_values_that_the_filter_cannot_run_with_are_refused(tmp_path, old, new, message):
    path = tmp_path / "pf.ini"
    path.write_text(INI.replace(old, new))
    with pytest.raises(FormatError, match=message):
        read_filter_settings(read_stack_file(path))
