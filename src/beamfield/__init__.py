"""Measurement models of probabilistic robotics: p(z | x, m) in a map, calibrated and fast.

``import beamfield as bf`` offers what most programs need; a name is loaded when it is first used (PEP 562), so that the
import itself costs next to nothing. Type checkers and editors read ``__init__.pyi``, and a test compares the two.
"""

from beamfield.lazy_names import lazy_names

__version__ = "0.1.0"

_NAMES = {
    # Files and messages
    "io.read_map": ("read_map",),
    "io.read_log": ("read_log",),
    "io.trajectory": ("read_trajectory", "attach_poses"),
    "io.read_sightings_log": ("read_sightings_log",),
    "io.maps.ros_map_writer": ("write_map",),
    "io.maps.range_table_file": ("precompute_ranges",),
    "io.landmarks.landmark_files": ("read_landmarks",),
    "io.landmarks.line_files": ("read_line_map",),
    "io.parameters.beam_model_file": ("read_beam_model",),
    "io.parameters.likelihood_field_file": ("read_likelihood_field",),
    "io.parameters.landmark_model_file": ("read_landmark_model",),
    "io.bags.laser_scan": ("scan_from_message",),
    "io.bags.map_topic": ("grid_from_message",),
    # Sensors, measurements and maps
    "sensors": ("RangeFinder", "Scan", "SensorLog", "ScanLog"),
    "detections": ("Detections",),
    "maps.occupancy": ("OccupancyGrid",),
    "maps.landmarks": ("LandmarkMap",),
    "maps.lines": ("LineMap",),
    "maps.markers": ("MarkerMap",),
    "maps.raycast": ("RayCaster",),
    "maps.range_table": ("RangeTable",),
    "maps.cone": ("ConeCaster",),
    "maps.scan_field": ("ScanField",),
    "maps.mapping": ("build_map", "local_map"),
    # Models
    "models.base": ("MeasurementModel",),
    "models.motion": ("MotionModel",),
    "models.beam": ("BeamModel",),
    "models.beam_parameters": ("BeamParameters",),
    "models.likelihood_field": ("LikelihoodFieldModel",),
    "models.field_parameters": ("LikelihoodFieldParameters",),
    "models.map_matching": ("MapMatchingModel",),
    "models.sonar": ("SonarModel",),
    "models.landmark": ("LandmarkModel",),
    "models.landmark_parameters": ("LandmarkParameters",),
    "models.landmark_poses": ("sample_poses",),
    "models.line": ("LineModel", "LineParameters"),
    "models.line_detections": ("LineDetections",),
    "models.marker": ("MarkerModel", "MarkerParameters", "MarkerDetections"),
    "models.ceiling_camera": ("CeilingCamera",),
    "models.differential_motion": ("DifferentialMotion",),
    "models.omni_motion": ("OmniMotion",),
    "models.gaussian_motion": ("GaussianMotion",),
    "models.velocity_motion": ("VelocityMotion",),
    # Learning and judging
    "calibration.calibrate": ("calibrate",),
    "calibration.options": ("CalibrationOptions",),
    "calibration.intrinsic.em": ("learn_intrinsic_parameters",),
    "calibration.field.learning": ("learn_field_parameters",),
    "explorer.widget": ("explore",),
    "calibration.context.exponent": ("learn_exponent",),
    "calibration.context.learning": ("learn_in_context",),
    "calibration.odometry.learning": ("calibrate_odometry",),
    "calibration.odometry.result": ("OdometryOptions",),
    "landmark_noise.learning": ("learn_landmark_parameters",),
    "scan_fit.reference": ("calibrate_scan_fit",),
    "scan_fit.scan_fit": ("judge_scan", "judge_log"),
    "scan_fit.changed_places": ("find_changed_places",),
    # Many robots; more in `fleet`
    "fleet.catalogue": ("open_catalogue",),
    # Where the robot is; more in `localization`
    "localization.likelihood_map": ("likelihood_map",),
    "localization.alignment": ("align",),
    "localization.global_search": ("GlobalSearch",),
    "localization.particle_filter": ("ParticleFilter",),
    "localization.scan_localizer": ("ScanLocalizer",),
    "localization.trajectory": ("fit_trajectory",),
    "features.lines": ("find_lines",),
    "features.corners": ("find_corners",),
    "features.poles": ("find_poles",),
    "features.minima": ("find_local_minima",),
    "features.sweep": ("RangeNoise",),
    # Simulation, and the process
    "simulation.log": ("simulate_log",),
    "simulation.floor_plan": ("draw_floor_plan",),
    "kernels.threads": ("set_threads",),
}
_MODULES = (
    "calibration", "errors", "features", "figures", "fleet", "geometry", "io", "landmark_noise", "localization", "maps",
    "models", "plot", "report", "scan_fit", "simulation", "stacks",
)  # fmt: skip

_OFFERED, __getattr__, __dir__ = lazy_names(
    __name__, _NAMES, _MODULES, doors=("beamfield.fleet", "beamfield.localization")
)
__all__ = ["__version__", *_OFFERED]
