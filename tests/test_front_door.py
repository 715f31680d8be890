"""The names of `import beamfield as bf`: there when used, not before, and the same for type checkers."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import beamfield as bf
from beamfield.errors import BeamfieldError, InvalidInputError
from beamfield.localization.particles import Particles

both = pytest.mark.parametrize("package", [bf, bf.fleet, bf.localization], ids=lambda package: package.__name__)


@both
def test_type_checkers_and_programs_see_the_same_names_from_the_same_places(package):
    declared = {
        alias.asname: (node.module, alias.name)
        for node in ast.walk(ast.parse(Path(package.__file__).with_suffix(".pyi").read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert sorted(declared) == sorted(set(package.__all__) - {"__version__"})
    assert len(package.__all__) == len(set(package.__all__))
    for name, (module, original) in declared.items():
        assert name == original
        home = importlib.import_module(module)
        expected = importlib.import_module(f"beamfield.{name}") if home is bf else getattr(home, name)
        assert getattr(package, name) is expected


@both
def test_names_are_listed_and_others_are_missed_as_of_any_module(package):
    assert dir(package) == sorted(package.__all__)
    with pytest.raises(AttributeError, match=f"module {package.__name__!r} has no attribute 'BeamModle'"):
        _ = package.BeamModle


@pytest.mark.parametrize(
    ("package", "name", "home"),
    [
        (bf, "Relocalizer", "beamfield.localization"),
        (bf, "scan_fleet", "beamfield.fleet"),
        (bf.localization, "ParticleFilter", "beamfield"),
        (bf.fleet, "open_catalogue", "beamfield"),
    ],
)
def test_a_name_that_another_door_offers_is_sent_there(package, name, home):
    with pytest.raises(AttributeError, match=f"has no attribute '{name}'; it is {home}.{name}$") as refused:
        getattr(package, name)
    # From these Python finds the name that was meant.
    assert (refused.value.name, refused.value.obj) == (name, package)


def test_what_is_made_by_another_function_names_it():
    grid = bf.OccupancyGrid([[0.0, 1.0]], 0.1)
    parameters = bf.BeamParameters(0.7, 0.1, 0.1, 0.1, 0.1, 0.5)
    table = bf.RangeTable.build(grid)
    scan = bf.Scan([1.0, 1.0], bf.RangeFinder.from_bearings([0.0, 0.1], 5.0))
    for call, maker in (
        (lambda: bf.RangeTable(grid), "plan: expected a RangeTablePlan, got an OccupancyGrid: RangeTable.build(grid) "),
        (lambda: bf.RangeTable(table.plan), "codes: expected an array, got None: RangeTable.build(grid) makes a table"),
        (lambda: bf.BeamModel(table, parameters), "got a RangeTable: the table is BeamModel's caster="),
        (lambda: bf.OccupancyGrid([[0.0, 100.0]], 0.1), "OccupancyGrid.from_ros(data, resolution) takes percent"),
        (lambda: bf.RangeFinder([0.0, 0.1], 5.0), "RangeFinder.from_bearings(bearings, max_range) takes bearings"),
        (lambda: bf.LineMap([[0.0, 0.0, 1.0, 1.0]]), "LineMap.from_segments(segments) takes end points"),
        (lambda: bf.find_lines(scan, 0.02), "RangeNoise(sigma_range) makes one"),
    ):
        with pytest.raises(InvalidInputError) as refused:
            call()
        assert maker in str(refused.value)


@pytest.mark.parametrize(
    "name",
    [
        name
        for name in bf.__all__
        if (inspect.isfunction(getattr(bf, name)) and not name.startswith("read_")) or name == "ParticleFilter"
    ],
)
def test_what_belongs_nowhere_is_named_with_what_does(name):
    if name == "explore":
        pytest.importorskip("anywidget")
    function = getattr(bf, name)
    required = [one.name for one in inspect.signature(function).parameters.values() if one.default is one.empty]
    if not required:
        pytest.skip("takes nothing that it must have")
    with pytest.raises(BeamfieldError, match=f"^({'|'.join(required)}).*: expected |no catalogue"):
        function(**dict.fromkeys(required, object()))


def test_no_name_is_offered_at_two_doors():
    assert not set(bf.__all__) & (set(bf.fleet.__all__) | set(bf.localization.__all__))


def test_the_import_loads_nothing_and_a_name_what_it_needs():
    program = (
        "import sys; import beamfield as bf; before = set(sys.modules);\n"
        "assert not {'numpy', 'numba', 'scipy'} & before, before\n"
        "assert [m for m in before if m.startswith('beamfield.')] == ['beamfield.lazy_names']\n"
        "bf.RangeFinder; assert 'numpy' in sys.modules and 'numba' not in sys.modules and 'scipy' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def array_fields(kind):
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    return [one.name for one in fields if one.init and "Array" in one.type and "ArrayLike" not in one.type]


BUILT_OF_ARRAYS = [kind for kind in (getattr(bf, name) for name in bf.__all__) if array_fields(kind)] + [
    Particles, bf.localization.PoseBelief, bf.localization.SearchWindow
]  # fmt: skip


@pytest.mark.parametrize("kind", BUILT_OF_ARRAYS)
def test_type_checkers_let_lists_pass_where_a_constructor_makes_arrays_of_them(kind):
    said = ast.walk(ast.parse(textwrap.dedent(inspect.getsource(kind))))
    (declared,) = (one for one in said if isinstance(one, ast.FunctionDef) and one.name == "__init__")
    args, made = declared.args, inspect.signature(kind).parameters.values()
    hints = {one.arg: ast.unparse(one.annotation) for one in (*args.args[1:], *args.kwonlyargs)}
    assert list(hints) == [one.name for one in made]
    assert [one.arg for one in args.kwonlyargs] == [one.name for one in made if one.kind is one.KEYWORD_ONLY]
    assert all(hints[name].startswith("ArrayLike") for name in array_fields(kind))
    defaults = [eval(ast.unparse(one), {"np": np}) for one in (*args.defaults, *filter(None, args.kw_defaults))]
    factories = {one.name for one in dataclasses.fields(kind) if one.default_factory is not dataclasses.MISSING}
    assert defaults == [... if one.name in factories else one.default for one in made if one.default is not one.empty]
