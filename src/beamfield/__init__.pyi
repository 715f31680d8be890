"""The names of `beamfield` for type checkers and editors; `__init__.py` loads them when they are used."""

# ruff: noqa: I001 - in the order of __init__.py

from beamfield import (
    calibration as calibration,
    errors as errors,
    features as features,
    figures as figures,
    fleet as fleet,
    geometry as geometry,
    io as io,
    landmark_noise as landmark_noise,
    localization as localization,
    maps as maps,
    models as models,
    plot as plot,
    report as report,
    scan_fit as scan_fit,
    simulation as simulation,
    stacks as stacks,
)
from beamfield.explorer.widget import explore as explore
from beamfield.fleet.catalogue import open_catalogue as open_catalogue
from beamfield.io.read_map import read_map as read_map
from beamfield.io.read_log import read_log as read_log
from beamfield.io.trajectory import read_trajectory as read_trajectory, attach_poses as attach_poses
from beamfield.io.read_sightings_log import read_sightings_log as read_sightings_log
from beamfield.io.maps.ros_map_writer import write_map as write_map
from beamfield.io.maps.range_table_file import precompute_ranges as precompute_ranges
from beamfield.io.landmarks.landmark_files import read_landmarks as read_landmarks
from beamfield.io.landmarks.line_files import read_line_map as read_line_map
from beamfield.io.parameters.beam_model_file import read_beam_model as read_beam_model
from beamfield.io.parameters.likelihood_field_file import read_likelihood_field as read_likelihood_field
from beamfield.io.parameters.landmark_model_file import read_landmark_model as read_landmark_model
from beamfield.io.bags.laser_scan import scan_from_message as scan_from_message
from beamfield.io.bags.map_topic import grid_from_message as grid_from_message
from beamfield.sensors import RangeFinder as RangeFinder, Scan as Scan, SensorLog as SensorLog, ScanLog as ScanLog
from beamfield.detections import Detections as Detections
from beamfield.maps.occupancy import OccupancyGrid as OccupancyGrid
from beamfield.maps.landmarks import LandmarkMap as LandmarkMap
from beamfield.maps.lines import LineMap as LineMap
from beamfield.maps.markers import MarkerMap as MarkerMap
from beamfield.maps.raycast import RayCaster as RayCaster
from beamfield.maps.range_table import RangeTable as RangeTable
from beamfield.maps.cone import ConeCaster as ConeCaster
from beamfield.maps.scan_field import ScanField as ScanField
from beamfield.maps.mapping import build_map as build_map, local_map as local_map
from beamfield.models.base import MeasurementModel as MeasurementModel
from beamfield.models.motion import MotionModel as MotionModel
from beamfield.models.beam import BeamModel as BeamModel
from beamfield.models.beam_parameters import BeamParameters as BeamParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel as LikelihoodFieldModel
from beamfield.models.field_parameters import LikelihoodFieldParameters as LikelihoodFieldParameters
from beamfield.models.map_matching import MapMatchingModel as MapMatchingModel
from beamfield.models.sonar import SonarModel as SonarModel
from beamfield.models.landmark import LandmarkModel as LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters as LandmarkParameters
from beamfield.models.landmark_poses import sample_poses as sample_poses
from beamfield.models.line import LineModel as LineModel, LineParameters as LineParameters
from beamfield.models.line_detections import LineDetections as LineDetections
from beamfield.models.marker import (
    MarkerModel as MarkerModel,
    MarkerParameters as MarkerParameters,
    MarkerDetections as MarkerDetections,
)
from beamfield.models.ceiling_camera import CeilingCamera as CeilingCamera
from beamfield.models.differential_motion import DifferentialMotion as DifferentialMotion
from beamfield.models.omni_motion import OmniMotion as OmniMotion
from beamfield.models.gaussian_motion import GaussianMotion as GaussianMotion
from beamfield.models.velocity_motion import VelocityMotion as VelocityMotion
from beamfield.calibration.calibrate import calibrate as calibrate
from beamfield.calibration.options import CalibrationOptions as CalibrationOptions
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters as learn_intrinsic_parameters
from beamfield.calibration.field.learning import learn_field_parameters as learn_field_parameters
from beamfield.calibration.context.exponent import learn_exponent as learn_exponent
from beamfield.calibration.context.learning import learn_in_context as learn_in_context
from beamfield.calibration.odometry.learning import calibrate_odometry as calibrate_odometry
from beamfield.calibration.odometry.result import OdometryOptions as OdometryOptions
from beamfield.landmark_noise.learning import learn_landmark_parameters as learn_landmark_parameters
from beamfield.scan_fit.changed_places import find_changed_places as find_changed_places
from beamfield.scan_fit.reference import calibrate_scan_fit as calibrate_scan_fit
from beamfield.scan_fit.scan_fit import judge_scan as judge_scan, judge_log as judge_log
from beamfield.localization.likelihood_map import likelihood_map as likelihood_map
from beamfield.localization.alignment import align as align
from beamfield.localization.global_search import GlobalSearch as GlobalSearch
from beamfield.localization.particle_filter import ParticleFilter as ParticleFilter
from beamfield.localization.scan_localizer import ScanLocalizer as ScanLocalizer
from beamfield.localization.trajectory import fit_trajectory as fit_trajectory
from beamfield.features.lines import find_lines as find_lines
from beamfield.features.corners import find_corners as find_corners
from beamfield.features.poles import find_poles as find_poles
from beamfield.features.minima import find_local_minima as find_local_minima
from beamfield.features.sweep import RangeNoise as RangeNoise
from beamfield.simulation.log import simulate_log as simulate_log
from beamfield.simulation.floor_plan import draw_floor_plan as draw_floor_plan
from beamfield.kernels.threads import set_threads as set_threads

__version__: str
