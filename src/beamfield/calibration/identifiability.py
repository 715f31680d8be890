"""What the data cannot tell about the intrinsic parameters, by name."""

from __future__ import annotations

from dataclasses import dataclass

from beamfield.calibration.finding import Finding
from beamfield.calibration.intrinsic_likelihood import IntrinsicLikelihood
from beamfield.calibration.learning_problem import LearningProblem
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters


@dataclass(frozen=True)
class Mode:
    """A maximum of the likelihood.

    Parameters
    ----------
    parameters
        Where it is.
    log_likelihood
        Nats per beam.
    """

    parameters: BeamParameters
    log_likelihood: float


def identifiability_findings(
    likelihood: IntrinsicLikelihood, problem: LearningProblem, theta: FloatArray, modes: tuple[Mode, ...]
) -> tuple[Finding, ...]:
    """Name what these beams leave open at the maximum `theta`."""
    return ()
