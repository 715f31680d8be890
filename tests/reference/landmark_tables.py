"""Section 6.6 transcribed slowly, one feature, one landmark, one pose at a time; nothing of beamfield is used."""

from __future__ import annotations

import itertools
import math


def prob(a: float, b: float) -> float:
    """The normal density of a with mean 0 and standard deviation b."""
    return math.exp(-0.5 * (a / b) ** 2) / (math.sqrt(2.0 * math.pi) * b)


def wrapped(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle))


def landmark_model_known_correspondence(feature, j, pose, positions, sigmas, signatures=None) -> float:
    """Table 6.4 with the "- theta" of (6.40); a value of None in the feature was not measured."""
    (r, phi, s), (x, y, theta) = feature, pose
    r_hat = math.sqrt((positions[j][0] - x) ** 2 + (positions[j][1] - y) ** 2)
    phi_hat = math.atan2(positions[j][1] - y, positions[j][0] - x) - theta
    q = 1.0
    if r is not None:
        q *= prob(r - r_hat, sigmas[0])
    if phi is not None:
        q *= prob(wrapped(phi - phi_hat), sigmas[1])
    if s is not None:
        q *= prob(s - signatures[j], sigmas[2])
    return q


def table_6_4_to_the_letter(feature, j, pose, positions, sigmas) -> float:
    """Lines 3 to 6 as printed: line 4 has no "- theta"."""
    return landmark_model_known_correspondence(feature, j, (pose[0], pose[1], 0.0), positions, sigmas)


def spurious_density(feature, max_range) -> float:
    """Range uniform on [0, max_range], any bearing; no signatures here."""
    r, phi, _ = feature
    q = 1.0
    if r is not None:
        q *= 1.0 / max_range if 0.0 <= r <= max_range else 0.0
    if phi is not None:
        q *= 1.0 / (2.0 * math.pi)
    return q


def sum_over_correspondences(feature, pose, positions, sigmas, rate, max_range) -> float:
    n = len(positions)
    each = [landmark_model_known_correspondence(feature, j, pose, positions, sigmas) / n for j in range(n)]
    return rate * spurious_density(feature, max_range) + (1.0 - rate) * sum(each)


def best_exclusive(features, pose, positions, sigmas, rate, max_range) -> tuple[float, tuple]:
    """Try every assignment in which no landmark has two features; None is no landmark."""
    best, best_choice = -1.0, ()
    choices = [*range(len(positions)), None]
    for choice in itertools.product(choices, repeat=len(features)):
        landmarks = [j for j in choice if j is not None]
        if len(set(landmarks)) < len(landmarks):
            continue
        q = 1.0
        for feature, j in zip(features, choice, strict=True):
            if j is None:
                q *= rate * spurious_density(feature, max_range)
            else:
                prior = (1.0 - rate) / len(positions)
                q *= prior * landmark_model_known_correspondence(feature, j, pose, positions, sigmas)
        if q > best:
            best, best_choice = q, choice
    return best, best_choice
