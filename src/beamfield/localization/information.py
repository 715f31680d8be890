"""How much of a scan its features keep: section 6.6.5, (6.42)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from beamfield.localization.pose_posterior import PoseLattice, PosePosterior, pose_posterior
from beamfield.models.base import MeasurementModel
from beamfield.sensors import Scan


@dataclass(frozen=True, eq=False)
class FeatureInformation:
    """Two posteriors over one lattice: given a scan, and given only its features.

    Parameters
    ----------
    scan, features
        The posteriors p(x | z, m) and p(x | f(z), m).
    """

    scan: PosePosterior
    features: PosePosterior

    @property
    def lost(self) -> float:
        """Entropy given the features minus entropy given the scan, nats.

        On average over measurements it cannot be negative if both models are true; for a single scan it can.
        """
        return self.features.entropy - self.scan.entropy

    @property
    def share_kept(self) -> float:
        """Information of the features over that of the scan, both in nats; NaN if the scan told nothing."""
        whole = self.scan.information
        return self.features.information / whole if whole > 0.0 else float("nan")

    @property
    def divergence(self) -> float:
        """Divergence of the scan's posterior from the features', nats: 0 only if (6.42) holds for this scan.

        Its mean over measurements is the information that the features lost, if both models are true. inf if the
        features exclude a pose that the scan allows.
        """
        return self.scan.divergence_from(self.features)


def information_of_features(
    scan_model: MeasurementModel[Scan],
    scan: Scan,
    feature_model: MeasurementModel[Any],
    features: Any,
    lattice: PoseLattice,
) -> FeatureInformation:
    """Compare what a whole scan and what its features say about the pose, to see whether they are sufficient (6.42).

    Features f are a sufficient statistic of the scan z if p(x | z, m) = p(x | f(z), m). Both posteriors are computed
    here under the same uniform prior.

    Parameters
    ----------
    scan_model
        For example a `BeamModel` or a `LikelihoodFieldModel`.
    scan
        The scan.
    feature_model
        For example a `LineModel` or a `LandmarkModel`.
    features
        What was extracted from the scan, as the feature model takes it.
    lattice
        The poses that are compared; its steps must be narrower than the peaks of both posteriors.

    Returns
    -------
    Both posteriors, and what they differ by.

    Raises
    ------
    TooLittleDataError
        If the scan or the features are impossible at every pose.

    Notes
    -----
    The comparison is as fair as its models. A scan model that takes dependent beams for independent ones is too sure,
    by far; so are covariances of features that were fitted to those beams. Give both the same `exponent` a, where the
    beams are not independent: the scan model takes it as it is, Gaussian features take covariances divided by a.

    References
    ----------
    Probabilistic Robotics, section 6.6.5, (6.42).

    Examples
    --------
    Of two landmarks, the features keep one:

    >>> from math import pi
    >>> from beamfield.detections import Detections
    >>> from beamfield.maps.landmarks import LandmarkMap
    >>> from beamfield.models.landmark import LandmarkModel
    >>> from beamfield.models.landmark_parameters import LandmarkParameters
    >>> noise = LandmarkParameters(sigma_range=0.2, sigma_bearing=0.1)
    >>> model = LandmarkModel(LandmarkMap([[3.0, 1.0], [1.0, 3.0]]), noise, correspondence="known")
    >>> both = Detections([2.0, 2.0], [0.0, pi / 2], ids=[1, 2])
    >>> lattice = PoseLattice.around([1.0, 1.0, 0.0], reach=0.6, resolution=0.1, heading_reach=0.4, heading_step=0.05)
    >>> kept = information_of_features(model, both, model, both.subset([0]), lattice)
    >>> kept.lost > 0.0, 0.0 < kept.share_kept < 1.0
    (True, True)
    """
    return FeatureInformation(
        pose_posterior(scan_model, scan, lattice), pose_posterior(feature_model, features, lattice)
    )
