"""Finding the robot's pose with the measurement models.

``bf.localization`` offers the parts of the particle filter and of the searches that fewer programs need than those of
``import beamfield as bf``; a name is loaded when it is first used (PEP 562).
"""

from importlib import import_module

_NAMES = {
    "fitted_poses": ("cross_fit_poses",),
    "global_search": ("SearchWindow",),
    "particle_filter": ("FilterOptions",),
    "particles": ("belief_poses", "free_poses"),
    "recovery": ("FreePoses", "PosesFromLandmarks", "PosesFromScan", "Recovery"),
    "replay": ("PoseBelief", "judge_replay"),
    "replay_comparison": ("judge_change",),
    "replay_trials": ("run_trials",),
    "resampling": ("KldSampling",),
    "short_readings": ("ShortReadings",),
    "trajectory_options": ("TrajectoryOptions",),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [*_HOMES]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
