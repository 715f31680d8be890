"""AMCL as nav2 and ROS 1 have it: all that their descriptions share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from beamfield.stacks.amcl.chapter import amcl_chapter_notes, amcl_fit_space, amcl_from_chapter
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.stack import FIELD_CUBES, FIELD_PRODUCT, RAY_CUBES, Model, Stack, models

_FIELD = "p = z_hit exp(-d² / 2 sigma_hit²) + z_rand / range_max, d from a beam's end to the nearest obstacle"
_BEAM_SKIPPING = {"do_beamskip": "beam skipping is left out: only nav2 and ROS 1 have it"}
_Z_MAX = (
    (
        "z_max counts only readings that are exactly the sensor's limit or laser_max_range, whichever is less, and too "
        "short ones, which amcl turns into it; +inf scores 0 and readings beyond laser_max_range nearly so"
    ),
    "have the driver report range_max where nothing comes back, with laser_max_range at that limit or above",
)


def amcl_stack(
    name: str,
    title: str,
    emulators: tuple[type[StackModel[Any, Any]], type[StackModel[Any, Any]], type[StackModel[Any, Any]]],
    parameters: type[Any],
    names: Mapping[str, str],
    **facts: Any,
) -> Stack:
    """Return the description of a program that runs AMCL, with facts of its own.

    The emulators are of its two fields and its beam model; `names` is as for `Model`.
    """
    field, product, beam = emulators

    def described(emulator: type[StackModel[Any, Any]], **facts: Any) -> Model:
        return Model(
            emulator=emulator, parameters=parameters, names=names, in_file=(emulator.model,), adds_one=True,
            fit_space=amcl_fit_space, **facts,
        )  # fmt: skip

    return Stack(
        name=name, title=title, nodes=("amcl",), **facts,
        models=models(
            described(field, weight=FIELD_CUBES, left_out=_BEAM_SKIPPING, formula=f"1 + Σ p³ over beams; {_FIELD}"),
            described(product, weight=FIELD_PRODUCT, left_out=_BEAM_SKIPPING, formula=f"Π p over beams; {_FIELD}"),
            described(
                beam, weight=RAY_CUBES, unknown_cells="stop", z_max_needs=_Z_MAX,
                from_chapter=amcl_from_chapter, chapter_notes=amcl_chapter_notes,
                formula="1 + Σ p³ over beams; p has the four causes of the chapter without normalisers",
            ),
        ),
        model_key="laser_model_type", formulas="amcl",
        too_few_beams="with fewer than two beams amcl ignores scans",
        turned_map=f"{name} takes only the origin's x and y: every pose is matched against a rotated map",
        half_cell_low=True, wants_extremes=True, takes_lesser_limit=True, short_is_longest=True, cuts_at_cells=True,
        asserts_p=True, averages_scans=True, beams_taken="every n-th beam",
    )  # fmt: skip
