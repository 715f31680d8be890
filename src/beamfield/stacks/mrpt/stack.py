"""MRPT's particle filter."""

from __future__ import annotations

from functools import partial

from beamfield.models.beam_parameters import BeamParameters
from beamfield.stacks.coordinates import SIGMAS, Coordinate, FitInputs, FitSpace, log_of, share
from beamfield.stacks.mrpt.field import MrptField
from beamfield.stacks.mrpt.filter import MrptFilterParameters, mrpt_filter
from beamfield.stacks.mrpt.filter_section import filter_section
from beamfield.stacks.mrpt.learned_motion import scaled_values
from beamfield.stacks.mrpt.motion import GAUSSIAN, THRUN, MrptMotion
from beamfield.stacks.mrpt.parameters import LF_THRUN, RAY_TRACING, MrptFieldParameters, MrptRayParameters
from beamfield.stacks.mrpt.rays import MrptRays
from beamfield.stacks.stack import FIELD_PRODUCT, RAY_LOGS, SURE, Model, Stack, StackFilter, models
from beamfield.stacks.syntax.parameter_text import ParameterSection

SIGNS = frozenset(
    ("likelihoodMethod", "LF_stdHit", "LF_zHit", "LF_zRandom", "LF_maxRange", "LF_decimation", "LF_maxCorrsDistance",
     "LF_useSquareDist", "LF_alternateAverageMethod", "rayTracing_stdHit", "rayTracing_decimation",
     "rayTracing_useDistanceFilter", "enableLikelihoodCache")
)  # fmt: skip
# Where the search looks first, metres: rayTracing's weights are sharp.
WIDE_SIGMAS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)


def _likeness(section: ParameterSection) -> float:
    if section.syntax == "ini":
        return SURE
    found = section.count(SIGNS)
    return found - 0.25 if found and section.syntax == "yaml" and not section.is_ros_2 else 0.0


def _field_space(model: Model, inputs: FitInputs) -> FitSpace:
    width = log_of("LF_stdHit", 0.4, inputs.narrowest, 1.0, SIGMAS)
    return _space(model, inputs, share(("LF_zHit", "LF_zRandom"), "LF_zRandom"), width)


def _ray_space(model: Model, inputs: FitInputs) -> FitSpace:
    return _space(model, inputs, log_of("rayTracing_stdHit", 0.4, inputs.narrowest, 3.0, WIDE_SIGMAS))


def _space(model: Model, inputs: FitInputs, *coordinates: Coordinate) -> FitSpace:
    settings = tuple({model.own_name("beam_step"): step} for step in inputs.steps(inputs.counts))
    return FitSpace(coordinates, settings, inputs.start, inputs.start)


def _from_chapter(learned: BeamParameters, typical_range: float, cell: float) -> dict[str, float]:  # noqa: ARG001
    return {"sigma_hit": learned.sigma_hit}


def _chapter_notes(*_: object) -> list[str]:
    return ["z_hit, z_short, z_max and z_rand are lost: MRPT's weights are fixed, 0.9 of them for hits"]


MRPT = Stack(
    name="mrpt",
    title="MRPT",
    models=models(
        Model(
            emulator=MrptField,
            parameters=MrptFieldParameters,
            formula="Π p over points; p = LF_zHit exp(-d² / 2 LF_stdHit²) + LF_zRandom / LF_maxRange",
            weight=FIELD_PRODUCT,
            fit_space=_field_space,
            names={
                "z_hit": "LF_zHit", "z_rand": "LF_zRandom", "sigma_hit": "LF_stdHit", "laser_max_range": "LF_maxRange",
                "laser_likelihood_max_dist": "LF_maxCorrsDistance", "beam_step": "LF_decimation",
            },
            in_file=(LF_THRUN, "lmLikelihoodField_Thrun", "LF_Thrun"),
            averages="LF_alternateAverageMethod",
            refused={
                "LF_useSquareDist": "the exponent takes the fourth power of the distance",
                "LF_alternateAverageMethod": "the weight is the mean over beams",
            },
            notes=(
                ("MRPT leaves out the first reading after one that is not valid, and points within half a cell of the "
                 "last"),
            ),
        ),
        Model(
            emulator=MrptRays,
            parameters=MrptRayParameters,
            formula="exp(1 + Σ log p); p = 0.1 / max_range + 0.9 exp(-(z - z*)² / 2 rayTracing_stdHit²)",
            weight=RAY_LOGS,
            fit_space=_ray_space,
            names={"sigma_hit": "rayTracing_stdHit", "beam_step": "rayTracing_decimation"},
            in_file=(RAY_TRACING, "lmRayTracing", "rayTracing"),
            unknown_cells="longest",
            from_chapter=_from_chapter,
            chapter_notes=_chapter_notes,
        ),
    ),
    likeness=_likeness,
    signs=SIGNS,
    syntax="ini",
    # MRPT's name for the first occupancy grid of a map.
    layout=("[MetricMap_occupancyGrid_00_likelihoodOpts]",),
    model_key="likelihoodMethod",
    turned_map="MRPT's bridge from ROS takes no map with a turned origin",
    drops_beyond=False,
    flatter="a larger decimation or a wider stdHit",
    filter=StackFilter(
        motion=MrptMotion, parameters=MrptFilterParameters, build=mrpt_filter, section=filter_section
    ),
    motion_key="modelSelection",
    motions={kind: partial(scaled_values, kind) for kind in (GAUSSIAN, THRUN)},
    motion_elsewhere="motion_model_2d of mrpt_pf_localization, beside modelSelection",
)  # fmt: skip
