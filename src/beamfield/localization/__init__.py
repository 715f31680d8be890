"""Finding the robot's pose with the measurement models.

``bf.localization`` offers the parts of the particle filter and of the searches that fewer programs need than those of
``import beamfield as bf``; a name is loaded when it is first used (PEP 562).
"""

from beamfield.lazy_names import lazy_names

_NAMES = {
    "coarse_model": ("CoarseModel",),
    "distance_scale": ("DistanceScale",),
    "fitted_poses": ("cross_fit_poses",),
    "model_choice": ("choose_model",),
    "search_window": ("SearchWindow",),
    "particle_filter": ("FilterOptions",),
    "particles": ("belief_poses", "free_poses"),
    "recovery": ("FreePoses", "PosesFromLandmarks", "PosesFromScan", "Recovery"),
    "relocalization": ("Relocalizer",),
    "replay": ("PoseBelief", "judge_replay"),
    "replay_comparison": ("judge_change",),
    "replay_trials": ("run_trials",),
    "resampling": ("KldSampling",),
    "short_readings": ("ShortReadings",),
}
__all__, __getattr__, __dir__ = lazy_names(__name__, _NAMES, doors=("beamfield",))
