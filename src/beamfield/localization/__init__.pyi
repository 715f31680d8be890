"""The names of `beamfield.localization` for type checkers and editors."""

# ruff: noqa: I001 - several names a line, as in the front door's

from beamfield.localization.fitted_poses import cross_fit_poses as cross_fit_poses
from beamfield.localization.model_choice import choose_model as choose_model
from beamfield.localization.search_window import SearchWindow as SearchWindow
from beamfield.localization.particle_filter import FilterOptions as FilterOptions
from beamfield.localization.coarse_model import CoarseModel as CoarseModel
from beamfield.localization.distance_scale import DistanceScale as DistanceScale
from beamfield.localization.particles import belief_poses as belief_poses, free_poses as free_poses
from beamfield.localization.recovery import (
    FreePoses as FreePoses,
    PosesFromLandmarks as PosesFromLandmarks,
    PosesFromScan as PosesFromScan,
    Recovery as Recovery,
)
from beamfield.localization.relocalization import Relocalizer as Relocalizer
from beamfield.localization.replay import PoseBelief as PoseBelief, judge_replay as judge_replay
from beamfield.localization.replay_comparison import judge_change as judge_change
from beamfield.localization.replay_trials import run_trials as run_trials
from beamfield.localization.resampling import KldSampling as KldSampling
from beamfield.localization.short_readings import ShortReadings as ShortReadings
