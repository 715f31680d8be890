"""Parameter files: beamfield's own, and those of the stacks."""

from __future__ import annotations

import numpy as np

from beamfield.io.parameters.beam_model_file import beam_model_text
from beamfield.io.parameters.landmark_model_file import landmark_model_text
from beamfield.io.parameters.likelihood_field_file import likelihood_field_text
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.sensors import RangeFinder
from tests.fuzz.case import Case, one_file

NAV2 = """\
map_server:
  ros__parameters:
    yaml_filename: "lobby.yaml"
amcl:
  ros__parameters:
    z_hit: 0.5      # tuned by ear
    z_rand: 0.5
    sigma_hit: 0.2
    laser_model_type: "likelihood_field_prob"
    laser_max_range: 10.0
    max_beams: 60
    do_beamskip: false
    initial_pose: {x: 0.0, y: 1.0}
"""
NAV2_BEAM = """\
/robot1/amcl:
  ros__parameters: {laser_model_type: beam, z_hit: 0.5, z_short: 0.05, z_max: 0.05, z_rand: 0.4, lambda_short: 0.1,
    sigma_hit: 0.2, laser_max_range: 12.0}
"""
BELUGA = """\
amcl:
  ros__parameters:
    laser_model_type: likelihood_field
    model_unknown_space: true
    only_obstacle_boundaries: false
    z_hit: 0.9  # of a hit
    z_rand: 0.1
    sigma_hit: 0.2
    max_beams: 20
    laser_max_range: 10.0
    laser_likelihood_max_dist: 2.0
"""
ROS1 = "amcl:\n  laser_z_hit: 0.9\n  laser_z_rand: 0.1\n  laser_sigma_hit: 0.2\n  laser_model_type: likelihood_field\n"
F1TENTH = (
    "squash_factor: 2.2\nz_hit: 0.75\nz_short: 0.01\nsigma_hit: 8\nrange_method: rmgpu\nangle_step: 18\nmax_range: 9\n"
)
LAUNCH = """\
<?xml version="1.0"?>
<launch>
  <arg name="z" default="0.5"/>
  <arg name="big" default="false"/>
  <!-- amcl -->
  <node pkg="amcl" type="amcl" name="loc">
    <param name="laser_z_hit" value="0.95"/>
    <param value='$(arg z)' name='laser_z_rand'/> <!-- \u00e9 -->
    <param name="laser_sigma_hit" value="0.2" type="double" if="$(arg big)"/>
    <param name="laser_model_type" value="likelihood_field"/>
    <rosparam>
      laser_max_range: 12.0
    </rosparam>
  </node>
  <node pkg="map_server" type="map_server" name="maps"><param name="frame_id" value="map"/></node>
</launch>
"""
LAUNCH_2 = """\
<launch>
  <arg name="z" default="0.5"/>
  <include file="$(find-pkg-share a)/b.launch.xml"/>
  <group ns="robot">
    <node pkg="nav2_amcl" exec="amcl" name="amcl">
      <param name="z_hit" value="0.5"/>
      <param name="z_rand" value="$(var z)"/>
      <param name="laser_model_type" value="beam"/>
    </node>
  </group>
</launch>
"""
INI = """\
// localisation
[MetricMap_occupancyGrid_00_creationOpts]
resolution=0.05
[MetricMap_occupancyGrid_00_likelihoodOpts]
likelihoodMethod   = 4   // 4: Thrun
LF_stdHit=0.35
LF_zHit = 0.95
LF_zRandom   = 0.05  ; share
LF_maxRange = 30 # metres
LF_decimation = 5
"""
STACK_YAMLS = (NAV2, NAV2_BEAM, BELUGA, ROS1, F1TENTH)


def beam_models() -> list[Case]:
    parameters = BeamParameters(z_hit=0.7, z_short=0.1, z_max=0.1, z_rand=0.1, sigma_hit=0.05, lambda_short=0.5)
    finder = RangeFinder.from_bearings(np.zeros(3), max_range=10.0, min_range=0.1, opening_angle=0.2, name="laser")
    text = beam_model_text(parameters, finder, intervals={"z_hit": (0.6, 0.8), "sigma_hit": (0.0, np.inf)},
                           provenance={"log": "a.log", "options": {"seed": 3}})  # fmt: skip
    return [one_file("beam_model.yaml", text)]


def field_models() -> list[Case]:
    parameters = LikelihoodFieldParameters(0.9, 0.1, 0.05)
    finder = RangeFinder.from_bearings(np.zeros(3), max_range=10.0, min_range=0.1, name="laser")
    text = likelihood_field_text(parameters, finder, exponent=0.1, n_beams=30, intervals={"sigma_hit": (0.04, 0.06)})
    return [one_file("likelihood_field.yaml", text)]


def landmark_models() -> list[Case]:
    parameters = LandmarkParameters(sigma_range=0.1, sigma_bearing=0.02, spurious_rate=0.1, max_range=20.0)
    return [one_file("landmark_model.yaml", landmark_model_text(parameters))]


def stack_yamls() -> list[Case]:
    return [one_file("p.yaml", text) for text in STACK_YAMLS]


def launch_files() -> list[Case]:
    return [one_file("p.launch", LAUNCH), one_file("p.launch", LAUNCH_2)]


def ini_files() -> list[Case]:
    return [one_file("p.ini", INI), one_file("p.ini", INI.replace("= 4 ", "= lmRayTracing "))]


def patched_files() -> list[Case]:
    """A source whose values are translated, and a user's file that they are written into."""
    targets = {
        "mine.yaml": (NAV2, BELUGA, ROS1, F1TENTH, NAV2_BEAM),
        "mine.launch": (LAUNCH, LAUNCH_2),
        "mine.ini": (INI,),
    }
    sources = (BELUGA.replace("likelihood_field", "likelihood_field_prob"), NAV2_BEAM)
    return [
        Case({"source.yaml": source.encode(), name: text.encode()}, ".", frozenset(["source.yaml"]))
        for name, texts in targets.items()
        for text in texts
        for source in sources
    ]
