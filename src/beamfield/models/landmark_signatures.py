"""What a feature's signature says about which landmark it is (6.6.2): numbers, vectors and types."""

from __future__ import annotations

import numpy as np

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark_parameters import LandmarkParameters

LOG_2PI = float(np.log(2.0 * np.pi))
NEEDED = {"number": "sigma_signature", "vector": "signature_covariance", "type": "confusion"}


def check_signature_noise(landmarks: LandmarkMap, parameters: LandmarkParameters) -> None:
    """Refuse parameters without noise for the map's kind of signature, or with noise of another size."""
    if landmarks.signatures is None:
        return
    name = NEEDED[landmarks.kind]
    noise = getattr(parameters, name)
    if noise is None:
        raise InvalidInputError(
            f"{name}: expected a value, as the map has signatures of kind {landmarks.kind!r}, got None"
        )
    if landmarks.kind == "vector" and len(noise) != landmarks.signatures.shape[1]:
        d = landmarks.signatures.shape[1]
        raise InvalidInputError(f"signature_covariance: expected shape ({d}, {d}), got {noise.shape}")
    if landmarks.kind == "type" and landmarks.signatures.max() >= len(noise):
        raise InvalidInputError(
            f"confusion: expected a row for type {landmarks.signatures.max():.0f}, got {len(noise)} rows"
        )


def signature_log_density(
    signatures: FloatArray | None, n: int, landmarks: LandmarkMap, parameters: LandmarkParameters
) -> FloatArray:
    """Return log p(s | landmark) of n features, (n, N + 1) nats; the last column is for features of no landmark.

    A feature of no landmark shows any type with the same probability. Its number or vector is normal with the mean of
    the map's signatures, and the covariance of the map's signatures plus the noise. A missing signature gives 0, a type
    that a landmark cannot show -inf.

    Signatures are (n,) numbers or types, or (n, d) vectors, NaN where none was measured; None if no feature has one.
    The noise is as `check_signature_noise` allows it. InvalidInputError if features have signatures that the map has
    not, or of another shape, or a type that `confusion` has not.
    """
    result: FloatArray = np.zeros((n, len(landmarks) + 1))
    # Without any measured signature there is no shape to speak of.
    if signatures is None or np.isnan(signatures).all():
        return result
    if landmarks.signatures is None:
        raise InvalidInputError("signatures: the map's landmarks have none, the features do")
    if signatures.shape[1:] != landmarks.signatures.shape[1:]:
        raise InvalidInputError(
            f"signatures: expected shape {(n, *landmarks.signatures.shape[1:])}, got {signatures.shape}"
        )
    seen = ~np.isnan(signatures.reshape(n, -1)).any(axis=1)
    if landmarks.kind == "type":
        result[seen] = _type_log_mass(signatures[seen], landmarks.signatures, np.asarray(parameters.confusion))
        return result
    shown, of_map = signatures[seen].reshape(int(seen.sum()), -1), landmarks.signatures.reshape(len(landmarks), -1)
    noise = _signature_noise(parameters, landmarks)
    mean = of_map.mean(axis=0)
    spread = (of_map - mean).T @ (of_map - mean) / len(of_map)
    result[seen, :-1] = _normal_log_density(shown[:, None] - of_map, noise)
    result[seen, -1] = _normal_log_density(shown - mean, noise + spread)
    return result


def _signature_noise(parameters: LandmarkParameters, landmarks: LandmarkMap) -> FloatArray:
    """Return the covariance of a number, (1, 1), or vector, (d, d)."""
    if landmarks.kind == "number":
        return np.array([[float(parameters.sigma_signature or np.nan) ** 2]])
    return np.asarray(parameters.signature_covariance)


def sample_signatures(
    which: FloatArray, landmarks: LandmarkMap, parameters: LandmarkParameters, rng: np.random.Generator
) -> FloatArray | None:
    """Draw what landmarks, by index (...), look like: numbers or types, or (..., d) vectors; None if none do."""
    if landmarks.signatures is None:
        return None
    true = landmarks.signatures[which]
    if landmarks.kind == "type":
        edges = np.cumsum(np.asarray(parameters.confusion), axis=1)[:, :-1][true.astype(np.int64)]
        return np.asarray((rng.random(true.shape)[..., None] >= edges).sum(axis=-1), dtype=np.float64)
    noise = np.linalg.cholesky(_signature_noise(parameters, landmarks))
    flat = true.reshape(-1, len(noise))
    return np.asarray((flat + rng.standard_normal(flat.shape) @ noise.T).reshape(true.shape))


def _type_log_mass(seen: FloatArray, true: FloatArray, confusion: FloatArray) -> FloatArray:
    wrong = (seen < 0) | (seen != np.floor(seen)) | (seen >= len(confusion))
    if wrong.any():
        raise InvalidInputError(f"signatures: expected types 0 to {len(confusion) - 1}, got {seen[wrong][0]}")
    with np.errstate(divide="ignore"):
        mass = np.log(confusion[true.astype(np.int64)][:, seen.astype(np.int64)]).T
    return np.column_stack([mass, np.full(len(seen), -np.log(len(confusion)))])


def _normal_log_density(residuals: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the log density of residuals (..., d)."""
    factor = np.linalg.cholesky(covariance)
    whitened = np.linalg.solve(factor, residuals.reshape(-1, len(factor)).T)
    constant = np.log(np.diag(factor)).sum() + 0.5 * len(factor) * LOG_2PI
    return np.asarray((-0.5 * np.square(whitened).sum(axis=0) - constant).reshape(residuals.shape[:-1]))
