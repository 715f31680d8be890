"""The particle filter of ROS 1's amcl, with its names and defaults."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

from beamfield.stacks.amcl.filter import amcl_filter
from beamfield.stacks.emulation.parameter_checks import check_switches
from beamfield.stacks.filters.amcl_filter import AmclFilter, AmclFilterParameters, check_filter
from beamfield.stacks.ros1.motion import Ros1Motion

# What nav2 calls otherwise.
_NAMES = {"pf_err": "kld_err", "pf_z": "kld_z"}


@dataclass(frozen=True)
class Ros1FilterParameters:
    """The node's private parameters about the particles.

    Parameters
    ----------
    min_particles, max_particles
        Bounds of the number of particles; the maximum holds where it is below the minimum.
    resample_interval, update_min_d, update_min_a
        As for `AmclFilterParameters`.
    recovery_alpha_slow, recovery_alpha_fast
        As for `AmclFilterParameters`.
    kld_err, kld_z
        What nav2 calls pf_err and pf_z.
    selective_resampling
        Whether particles are kept while the effective number of them is above half their number.

    Raises
    ------
    InvalidInputError
        As for `AmclFilterParameters`.
    """

    min_particles: int = 100
    max_particles: int = 5000
    kld_err: float = 0.01
    kld_z: float = 0.99
    resample_interval: int = 2
    update_min_d: float = field(default=0.2, metadata={"unit": "m"})
    update_min_a: float = field(default=math.pi / 6.0, metadata={"unit": "rad"})
    recovery_alpha_slow: float = 0.001
    recovery_alpha_fast: float = 0.1
    selective_resampling: bool = False

    def __post_init__(self) -> None:
        check_filter(self, _NAMES)
        check_switches(self, "selective_resampling")


def ros1_filter(model: Any, motion: Ros1Motion, parameters: Ros1FilterParameters) -> AmclFilter:
    """Return the filter that runs one of ROS 1 amcl's models."""
    names = (item.name for item in fields(AmclFilterParameters))
    values = {name: getattr(parameters, _NAMES.get(name, name)) for name in names}
    # Only a later change of the parameters raises the maximum to the minimum.
    values["min_particles"] = min(parameters.min_particles, parameters.max_particles)
    selective = parameters.selective_resampling
    return amcl_filter(model, motion, AmclFilterParameters(**values), selective_resampling=selective)
