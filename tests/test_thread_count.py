"""Numbers of threads that are none are refused, by everything that takes a number of threads."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import pytest

import beamfield
from beamfield.errors import InvalidInputError
from beamfield.thread_count import check_threads

# Kernels and what models call with the number that they were made with.
UNCHECKED = {
    "beamfield.kernels.crew.run_together",
    "beamfield.kernels.threads.run_in_slices",
    "beamfield.kernels.threads.threads_that_pay",
    "beamfield.models.field_tables.FieldTables",
    "beamfield.models.local_map_cells.overlap_sums",
    "beamfield.stacks.emulation.field_table.FieldTable.look_up",
    "beamfield.stacks.emulation.stack_rays.bresenham_ranges",
    "beamfield.stacks.emulation.stack_rays.exact_ranges",
    "beamfield.stacks.fit.window_evidence.FieldCodes.log_weights",
    "beamfield.stacks.fit.window_evidence.WindowEvidence.log_weights",
}


def takers() -> Iterator[tuple[str, Callable[..., Any]]]:
    """All public functions, methods and classes with a parameter `threads`, by name, where they are defined."""
    for module_info in pkgutil.walk_packages(beamfield.__path__, "beamfield."):
        if "__main__" in module_info.name:
            continue
        module = importlib.import_module(module_info.name)
        for name, item in vars(module).items():
            if name.startswith("_") or getattr(item, "__module__", None) != module.__name__:
                continue
            if inspect.isclass(item):
                if Protocol not in item.__bases__ and not inspect.isabstract(item):
                    yield from methods(f"{module.__name__}.{name}", item)
            elif inspect.isfunction(item) and "threads" in inspect.signature(item).parameters:
                yield f"{module.__name__}.{name}", item


def methods(name: str, kind: type) -> Iterator[tuple[str, Callable[..., Any]]]:
    """The class itself, if its instances are made with `threads`, and its own public methods."""
    if inspect.isfunction(kind.__init__) and "threads" in inspect.signature(kind.__init__).parameters:
        yield name, kind
    for method_name, method in vars(kind).items():
        is_public = not method_name.startswith("_") and inspect.isfunction(method)
        if is_public and "threads" in inspect.signature(method).parameters:
            yield f"{name}.{method_name}", method


TAKERS = {name: taker for name, taker in sorted(takers()) if name not in UNCHECKED}


def test_the_search_finds_them():
    assert not UNCHECKED - {name for name, _ in takers()}
    assert {
        "beamfield.calibration.options.CalibrationOptions",
        "beamfield.localization.global_search.GlobalSearch",
        "beamfield.maps.raycast.RayCaster.expected_ranges",
        "beamfield.models.beam.BeamModel",
        "beamfield.models.landmark.LandmarkModel",
    } <= set(TAKERS)


@pytest.mark.parametrize("threads", [0, -1])
@pytest.mark.parametrize("name", TAKERS)
def test_fewer_than_one_thread_are_refused_before_anything_is_done(name, threads):
    taker = TAKERS[name]
    required = [p for p in inspect.signature(taker).parameters.values() if p.default is p.empty and p.name != "threads"]
    # None fits no other parameter: nothing may look at them before the number of threads is refused.
    positional = [None for p in required if p.kind is not p.KEYWORD_ONLY]
    named = {p.name: None for p in required if p.kind is p.KEYWORD_ONLY}
    with pytest.raises(InvalidInputError, match=f"^threads: expected at least 1 or None, got {threads}$"):
        taker(*positional, **named, threads=threads)


@pytest.mark.parametrize("threads", [None, 1, 7])
def test_one_or_more_threads_or_none_are_fine(threads):
    check_threads(threads)
