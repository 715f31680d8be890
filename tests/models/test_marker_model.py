"""The density of ceiling markers in the image, and drawing from it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from beamfield.errors import InvalidInputError
from beamfield.geometry import wrap_angle
from beamfield.maps.markers import MarkerMap
from beamfield.models.ceiling_camera import CeilingCamera
from beamfield.models.marker import MarkerDetections, MarkerModel, MarkerParameters
from tests.reference.marker_exercise import image_by_projection, wrapped_normal_density

CAMERA = CeilingCamera(600.0, 2.6, (0.12, -0.05, np.pi / 2), (320.0, 240.0), (640.0, 480.0))
MARKERS = MarkerMap([4, 9, "door"], [[1.0, 2.0, 0.5], [2.1, 1.7, -3.0], [0.4, 1.1, 2.0]])


def build(**changes):
    noise = {name: changes.pop(name, value) for name, value in (("sigma_pixel", 3.0), ("sigma_angle", 0.04))}
    return MarkerModel(MARKERS, MarkerParameters(**noise), CAMERA, **changes)


def detect(model, pose, rng):
    """Return all markers with noise, in the image or not."""
    noise = rng.normal(0.0, [3.0, 3.0, 0.04], (len(MARKERS), 3))
    return MarkerDetections(MARKERS.ids, model.expected(pose) + noise)


@pytest.mark.parametrize("sigma_angle", [0.02, 0.3, 1.0, 2.0, np.pi])
def test_the_density_is_that_of_a_pinhole_with_normal_noise(rng, sigma_angle):
    model = build(sigma_angle=sigma_angle)
    truth = np.array([1.1, 1.4, 0.3])
    z = detect(model, truth, rng)
    for pose in truth + rng.normal(0.0, [0.03, 0.03, 0.5 * sigma_angle], (20, 3)):
        expected = 0.0
        for image, marker in zip(z.image, MARKERS.poses, strict=True):
            u, v, angle = image_by_projection(marker, pose, CAMERA.mount, 600.0, 2.6, CAMERA.principal_point)
            expected += stats.norm.logpdf(image[0], u, 3.0) + stats.norm.logpdf(image[1], v, 3.0)
            expected += np.log(wrapped_normal_density(image[2] - angle, sigma_angle))
        assert float(model.log_likelihood(z, pose)) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("sigma_angle", [0.02, 0.5, 3.0])
def test_the_density_of_the_angle_has_no_seam(sigma_angle):
    model = build(sigma_angle=sigma_angle)
    pose = np.array([1.1, 1.4, 0.3])
    image = model.expected(pose)[:1]
    half_turn = image + np.array([0.0, 0.0, np.pi])
    values = [
        float(model.log_likelihood(MarkerDetections([4], half_turn + np.array([0.0, 0.0, shift])), pose))
        for shift in (-1e-9, 1e-9, -2.0 * np.pi, 8.0 * np.pi)
    ]
    np.testing.assert_allclose(values, values[0], rtol=1e-6)


def test_an_unknown_angle_says_nothing(rng):
    model = build()
    pose = np.array([1.1, 1.4, 0.3])
    z = detect(model, pose, rng)
    no_angles = MarkerDetections(z.ids, np.column_stack([z.image[:, :2], np.full(3, np.nan)]))
    places = stats.norm.logpdf(z.image[:, :2], model.expected(pose)[:, :2], 3.0).sum()
    assert float(model.log_likelihood(no_angles, pose)) == pytest.approx(places, rel=1e-9)


def test_absurdly_far_poses_are_impossible_but_no_error(rng):
    model = build()
    z = detect(model, np.array([1.1, 1.4, 0.3]), rng)
    values = model.log_likelihood(z, [[1e200, -1e200, 1e200], [1.7e308, 1.7e308, 0.7], [0.0, 0.0, -1e15]])
    assert values[:2].tolist() == [-np.inf, -np.inf]
    assert np.isfinite(values[2])


def test_the_most_likely_pose_of_several_markers_is_near_the_truth(rng):
    model = build()
    truth = np.array([1.1, 1.4, 0.3])
    z = detect(model, truth, rng)
    poses = truth + rng.uniform(-1.0, 1.0, (200_000, 3)) * [0.1, 0.1, 0.1]
    best = poses[model.log_likelihood(z, poses).argmax()]
    # Three markers at 3 pixels of 230 per metre: about 8 mm.
    assert np.hypot(*(best - truth)[:2]) < 0.04
    assert abs(best[2] - truth[2]) < 0.06


def test_only_markers_in_view_are_drawn(rng):
    model = build()
    under, away = model.sample([[0.4, 1.1, 0.0], [30.0, 0.0, 0.0]], rng)
    assert "door" in under.ids
    assert away.ids == ()
    assert len(model.log_likelihood(away, np.zeros((3, 3)))) == 3


def test_drawn_angles_lie_in_one_turn(rng):
    model = MarkerModel(MARKERS, MarkerParameters(1.0, 3.0), CeilingCamera(600.0, 2.6))
    angles = np.concatenate([z.image[:, 2] for z in model.sample(np.zeros((500, 3)), rng)])
    assert angles.min() > -np.pi
    assert angles.max() <= np.pi


def test_drawn_poses_follow_the_posterior_on_a_fine_grid(rng):
    """Chi-square over bins of x, y, theta, with the model's own likelihood integrated over each bin."""
    model = build(sigma_pixel=25.0, sigma_angle=0.25)
    z = MarkerDetections([9], [[300.0, 150.0, 2.9]])
    poses = model.sample_poses(z, 20_000, rng)
    best = model.camera.robot_poses(z.image[0], MARKERS.poses[1])
    edges = [np.linspace(-0.6, 0.6, 7), np.linspace(-0.6, 0.6, 7), np.linspace(-1.0, 1.0, 7)]
    offsets = np.column_stack([poses[:, :2] - best[:2], wrap_angle(poses[:, 2] - best[2])])
    counts, _ = np.histogramdd(offsets, edges)

    fine = [np.linspace(e[0], e[-1], 121)[:-1] + (e[-1] - e[0]) / 240 for e in edges]
    grid = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1)
    density = np.exp(model.log_likelihood(z, best + grid))
    mass = density.reshape(6, 20, 6, 20, 6, 20).sum(axis=(1, 3, 5))
    expected = mass / mass.sum() * counts.sum()
    assert counts.sum() > 0.99 * len(poses)
    usable = expected > 10.0
    chi_square = ((counts - expected)[usable] ** 2 / expected[usable]).sum()
    assert stats.chi2.sf(chi_square, usable.sum() - 1) > 1e-3


def test_without_an_angle_the_robot_is_on_a_circle_around_the_marker(rng):
    model = build(sigma_pixel=0.5)
    z = MarkerDetections([4], [[420.0, 240.0, np.nan]])
    poses = model.sample_poses(z, 4000, rng)
    lenses = CAMERA.map_from_camera(poses)
    distances = np.hypot(*(lenses - MARKERS.poses[0])[:, :2].T)
    np.testing.assert_allclose(distances, 100.0 / CAMERA.scale, atol=6 * 0.5 / CAMERA.scale)
    assert stats.kstest(poses[:, 2], stats.uniform(-np.pi, 2.0 * np.pi).cdf).pvalue > 1e-3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sigma_pixel": 0.0}, r"sigma_pixel: expected a positive number from 1e-12 to 1e\+09, got 0.0"),
        ({"sigma_pixel": np.inf}, r"sigma_pixel: expected a positive number from 1e-12 to 1e\+09, got inf"),
        ({"sigma_angle": -0.1}, r"sigma_angle: expected radians in \(0, pi\], got -0.1"),
        ({"sigma_angle": 3.2}, r"sigma_angle: expected radians in \(0, pi\], got 3.2"),
        ({"sigma_angle": np.nan}, r"sigma_angle: expected radians in \(0, pi\], got nan"),
    ],
)
def test_impossible_noise_is_refused_by_name_and_value(changes, message):
    with pytest.raises(InvalidInputError, match=message):
        build(**changes)


@pytest.mark.parametrize(
    ("ids", "poses", "message"),
    [
        ([4, 4], np.zeros((2, 3)), "ids: expected each once, got 4 at 0 and at 1"),
        ([4, 2.5], np.zeros((2, 3)), "ids: expected integers or strings, got 2.5"),
        ([4, True], np.zeros((2, 3)), "ids: expected integers or strings, got True"),
        ([4], np.zeros((2, 3)), r"poses: expected shape \(1, 3\) for 1 ids, got \(2, 3\)"),
        ([4], [[0.0, np.nan, 0.0]], "poses: expected finite numbers, got nan"),
    ],
)
def test_impossible_maps_are_refused_by_name_and_value(ids, poses, message):
    with pytest.raises(InvalidInputError, match=message):
        MarkerMap(ids, poses)


@pytest.mark.parametrize(
    ("ids", "image", "message"),
    [
        ([4, 9], [[1.0, 2.0, 0.0]], r"image: expected shape \(2, 3\) for 2 ids, got \(1, 3\)"),
        ([4], [[np.nan, 2.0, 0.0]], r"image: expected finite u and v, got \[nan, 2.0\] for marker 4"),
        (["door"], [[1.0, 2.0, np.inf]], "image: expected a finite angle or NaN, got inf for marker 'door'"),
        ([None], [[1.0, 2.0, 0.0]], "ids: expected integers or strings, got None"),
    ],
)
def test_impossible_detections_are_refused_by_name_and_value(ids, image, message):
    with pytest.raises(InvalidInputError, match=message):
        MarkerDetections(ids, image)


def test_a_marker_that_is_not_in_the_map_is_refused_by_its_id():
    with pytest.raises(InvalidInputError, match="ids: the map has no marker 5; it has 4, 9, 'door'"):
        build().log_likelihood(MarkerDetections([5], [[1.0, 2.0, 0.0]]), np.zeros(3))
    many = MarkerMap(range(10), np.zeros((10, 3)))
    with pytest.raises(InvalidInputError, match="no marker '3'; it has 0, 1, 2, 3, 4, 5, 6, 7 and 2 more"):
        many.index_of(["3"])


def test_poses_are_drawn_for_at_least_one_detection(rng):
    with pytest.raises(InvalidInputError, match="z: expected at least one detection, got none"):
        build().sample_poses(MarkerDetections([], []), 3, rng)
    with pytest.raises(InvalidInputError, match="n: expected at least 0, got -1"):
        build().sample_poses(MarkerDetections([4], [[1.0, 2.0, 0.0]]), -1, rng)


@pytest.mark.parametrize("answer", ["image_of", "marker_poses", "robot_poses"])
def test_shapes_that_do_not_broadcast_are_refused(answer):
    with pytest.raises(InvalidInputError, match=r"expected shapes that broadcast, got \([23], 3\) and \([23], 3\)"):
        getattr(CAMERA, answer)(np.zeros((3, 3)), np.ones((2, 3)))


def test_a_mount_in_degrees_is_refused():
    with pytest.raises(InvalidInputError, match=r"heading of mount: expected radians, at most a full turn, got 90"):
        CeilingCamera(600.0, 2.4, mount=(0.2, 0.0, 90.0))


SEVERAL = {
    "two with angles": ([4, 9], [0.3, 0.35], 25.0, 0.25),
    "three with angles": ([4, 9, "door"], [0.0, 0.1, -0.1], 25.0, 0.25),
    "two without angles": ([4, 9], [np.nan, np.nan], 20.0, 0.1),
    "one angle of two": ([4, "door"], [0.2, np.nan], 25.0, 0.4),
    "the same one twice": ([4, 4], [0.1, -0.1], 25.0, 0.4),
    "angles that hardly agree": ([4, 9], [1.0, -1.0], 60.0, 0.5),
}


@pytest.mark.parametrize("case", SEVERAL)
def test_poses_drawn_from_several_detections_follow_the_posterior_on_a_fine_grid(rng, case):
    """Chi-square over bins of x, y, theta, with the model's own likelihood integrated over each bin."""
    ids, off, sigma_pixel, sigma_angle = SEVERAL[case]
    model = build(sigma_pixel=sigma_pixel, sigma_angle=sigma_angle)
    truth = np.array([1.1, 1.4, 0.3])
    image = model.expected(truth)[MARKERS.index_of(ids)]
    image[:, 0] += 10.0 * np.arange(len(ids))
    image[:, 2] += off
    z = MarkerDetections(ids, image)
    poses = model.sample_poses(z, 20_000, rng)

    spread = np.column_stack([poses[:, :2] - poses[:, :2].mean(axis=0), wrap_angle(poses[:, 2] - truth[2])])
    middle = np.array([*poses[:, :2].mean(axis=0), truth[2] + np.median(spread[:, 2])])
    half = 5.0 * np.std(spread, axis=0)
    offsets = np.column_stack([poses[:, :2] - middle[:2], wrap_angle(poses[:, 2] - middle[2])])
    edges = [np.linspace(-reach, reach, 9) for reach in half]
    counts, _ = np.histogramdd(offsets, edges)
    fine = [edge[0] + (np.arange(80) + 0.5) / 80 * (edge[-1] - edge[0]) for edge in edges]
    grid = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1)
    log_density = model.log_likelihood(z, middle + grid)
    mass = np.exp(log_density - log_density.max()).reshape(8, 10, 8, 10, 8, 10).sum(axis=(1, 3, 5))
    expected = mass / mass.sum() * counts.sum()
    assert counts.sum() > 0.99 * len(poses)
    usable = expected > 10.0
    assert usable.sum() > 20
    chi_square = ((counts - expected)[usable] ** 2 / expected[usable]).sum()
    assert stats.chi2.sf(chi_square, usable.sum() - 1) > 1e-3


def test_sharp_noise_does_not_slip_between_the_cells_of_the_histogram(rng):
    """A micropixel and a microradian: the heading's density is 1e-7 wide."""
    model = build(sigma_pixel=1e-6, sigma_angle=1e-6)
    truth = np.array([1.1, 1.4, 0.3])
    z = MarkerDetections(MARKERS.ids, model.expected(truth))
    poses = model.sample_poses(z, 4000, rng)
    lever = np.linalg.norm(MARKERS.poses[:, :2] - MARKERS.poses[:, :2].mean(axis=0))
    information = 3.0 / 1e-12 + (lever * CAMERA.scale / 1e-6) ** 2
    assert np.std(poses[:, 2]) == pytest.approx(1.0 / np.sqrt(information), rel=0.05)
    np.testing.assert_allclose(poses.mean(axis=0), truth, atol=1e-8)


@pytest.mark.parametrize("sigma_angle", [1e-12, 1e-9])
def test_markers_that_contradict_each_other_are_drawn_from_however_sharp_the_noise(rng, sigma_angle):
    model = build(sigma_angle=sigma_angle)
    for turn in (0.5, 1.0, 2.0):
        image = model.expected([1.0, 1.5, 0.3])
        image[:, 2] += [0.0, turn, 1.1 * turn]
        poses = model.sample_poses(MarkerDetections(MARKERS.ids, image), 50, rng)
        assert np.isfinite(poses).all()


def test_any_number_of_poses_is_drawn(rng):
    z = MarkerDetections([4], [[300.0, 150.0, 2.9]])
    assert build().sample_poses(z, 0, rng).shape == (0, 3)
    assert build().sample_poses(z, 1, rng).shape == (1, 3)
