"""A sixth stack takes a folder and a line in the registry: nothing else names a stack."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.own_stack import TOY, ToyParameters

import beamfield
from beamfield.cli.main import main
from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.parameters.beam_model_file import beam_model_text
from beamfield.localization.replay import PoseBelief
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder
from beamfield.stacks.doctor.examine import examine
from beamfield.stacks.emulation.stack_map import read_as_stack
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.new_file import new_file_text
from beamfield.stacks.files.parameter_file import read_stack_file, write_values
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.filters.amcl_filter import AmclFilter, AmclFilterParameters
from beamfield.stacks.fit.fit_space import fit_space
from beamfield.stacks.nav2.motion import Nav2Motion
from beamfield.stacks.registry import STACKS, build_model
from beamfield.stacks.stack import StackFilter
from beamfield.stacks.translation.translate import translate
from beamfield.stacks.translation.translate_beam_model import translate_beam_model
from tests.stacks.small_room import small_room, small_scan
from tests.stacks.test_filters import drive

FILE = "toy_localizer:\n  toy_peak: 0.8   # mine\n  toy_floor: 0.2\n  toy_width: 0.15\n"
SOURCES = Path(beamfield.__file__).parent


@pytest.fixture(autouse=True)
def _registered(monkeypatch):
    monkeypatch.setitem(STACKS, "toy", TOY)


@pytest.fixture
def path(tmp_path):
    written = tmp_path / "toy.yaml"
    written.write_text(FILE)
    return written


def test_its_file_is_recognised_and_its_values_weigh_poses(path):
    file = read_stack_file(path)
    assert (file.stack, file.model, file.possible) == ("toy", "toy_field", ("toy",))
    values = checked_values(file)
    assert values == ToyParameters(toy_peak=0.8, toy_floor=0.2, toy_width=0.15)
    model = build_model("toy", file.model, small_room(), values)
    weights = model.log_likelihood(small_scan(), [[1.0, 1.0, 0.0], [0.5, 0.7, 1.0]])
    assert np.isfinite(weights).all()
    assert weights[0] != weights[1]


def test_its_filter_is_a_field_of_its_description(path, monkeypatch):
    with pytest.raises(FormatError, match="the particle filter of the toy is not emulated"):
        read_filter_settings(read_stack_file(path))

    def build(model, motion, particles):
        return AmclFilter(model, read_as_stack(model.grid), motion, particles)

    described = StackFilter(motion=Nav2Motion, parameters=AmclFilterParameters, build=build)
    monkeypatch.setitem(STACKS, "toy", replace(TOY, filter=described))
    path.write_text(FILE + "  alpha3: 0.02\n  max_particles: 700\n")
    settings = read_filter_settings(read_stack_file(path))
    assert settings.sensor.toy_width == 0.15
    assert (settings.motion.alpha3, settings.motion.alpha1) == (0.02, 0.2)
    assert (settings.particles.max_particles, settings.particles.min_particles) == (700, 500)
    start = PoseBelief.around([1.0, 1.0, 0.0])
    replay = settings.filter(small_room()).run(drive(4), start, np.random.default_rng(1))
    assert len(replay.updates) == 2


def test_it_is_fitted_by_its_own_coordinates():
    finder = RangeFinder.from_bearings(np.linspace(-1.0, 1.0, 60), 8.0)
    space = fit_space("toy", "toy_field", ToyParameters(), finder, small_room(), None)
    assert [next(iter(setting)) for setting in space.settings] == ["toy_step"] * len(space.settings)
    moved = space.parameters(space.first_guess, space.point(space.first_guess) + 0.1)
    assert moved.toy_width > ToyParameters().toy_width


@pytest.mark.parametrize("to", ["nav2", "ros1", "beluga", "mrpt"])
def test_its_values_translate_there_and_back(path, tmp_path, to):
    there = translate(read_stack_file(path), to, max_range=8.0, n_beams=120)
    assert there.comparison.spread > 1.0
    written = tmp_path / f"other{'.ini' if to == 'mrpt' else '.yaml'}"
    written.write_text(new_file_text(to, there.values))
    back = translate(read_stack_file(written, stack=to), "toy", max_range=8.0, n_beams=120)
    assert back.values["toy_peak"] == pytest.approx(0.8, rel=1e-4)
    assert back.values["toy_width"] == pytest.approx(0.15, rel=1e-4)
    assert back.values["toy_step"] == 2


def test_models_with_other_weights_are_refused(tmp_path):
    path = tmp_path / "nav2.yaml"
    path.write_text("amcl:\n  ros__parameters:\n    laser_model_type: beam\n")
    with pytest.raises(InvalidInputError, match=r"toy has no model that weighs as nav2's beam does"):
        translate(read_stack_file(path, stack="nav2"), "toy")


def test_beamfields_own_beam_model_becomes_its_field(tmp_path):
    path = tmp_path / "beam_model.yaml"
    path.write_text(
        beam_model_text(BeamParameters(0.7, 0.1, 0.05, 0.15, 0.04, 0.5), RangeFinder(np.zeros((3, 3)), 8.0))
    )
    result = translate_beam_model(path, "toy")
    assert result.values["toy_width"] == pytest.approx(0.04)
    assert result.values["toy_range"] == 8.0


def test_the_doctor_examines_it_under_its_own_names(path):
    path.write_text(FILE.replace("toy_floor: 0.2", "toy_floor: 0.0").replace("0.15", "0.9") + "  z_hit: 0.5\n")
    found = {item.name: item for item in examine(read_stack_file(path), grid=small_room())}
    assert found["no-random-readings"].text == "toy_floor is 0"
    assert found["sigma-huge"].parameter == "toy_width"
    assert found["foreign-name"].text == "z_hit is a parameter of nav2, not of toy"
    assert "half-cell-shift" not in found


def test_its_findings_are_asked_for(path, monkeypatch):
    def own(subject):
        yield subject.finding("toy-finding", "info", "seen", "why", "do", parameter="z_hit")

    monkeypatch.setitem(STACKS, "toy", replace(TOY, checks=(own,)))
    found = {item.name: item for item in examine(read_stack_file(path))}
    assert (found["toy-finding"].parameter, found["toy-finding"].line) == ("toy_peak", 2)


def test_its_file_is_written_anew_and_changed(path, tmp_path, capsys):
    write_values(read_stack_file(path).section, {"toy_peak": 0.7, "toy_step": 3})
    assert path.read_text() == FILE.replace("0.8", "0.7") + "  toy_step: 3\n"
    source = tmp_path / "nav2.yaml"
    source.write_text("amcl:\n  ros__parameters:\n    laser_model_type: likelihood_field_prob\n    z_hit: 0.5\n")
    assert main(["translate", str(source), "--to", "toy", "--out", str(tmp_path / "new.yaml")]) == 0
    written = (tmp_path / "new.yaml").read_text().split("toy_localizer:\n")
    assert written[0].startswith("# toy toy_field, from nav2 likelihood_field_prob by beamfield")
    assert "  toy_width: 0.2\n" in written[1]
    assert main(["doctor", str(tmp_path / "new.yaml")]) == 0
    assert "toy, toy_field, section toy_localizer" in capsys.readouterr().out


def test_no_stack_is_named_outside_its_folder():
    named = re.compile(rf"""(["'])({"|".join(name for name in STACKS if name != "toy")})\1""")
    # The demo shows one program's filter.
    own = {*(SOURCES / "stacks" / name for name in STACKS), SOURCES / "cli" / "demo.py"}
    found = [
        f"{path.relative_to(SOURCES)}:{number}: {line.strip()}"
        for path in sorted(SOURCES.rglob("*.py"))
        if not own & {path, *path.parents}
        for number, line in enumerate(_code(path), start=1)
        if named.search(line)
    ]
    assert found == []


def _code(path: Path) -> list[str]:
    """Return the lines of a source file with its docstrings blanked."""
    text = path.read_text()
    blank = lambda found: "\n" * found.group().count("\n")  # noqa: E731
    return re.sub(r'""".*?"""', blank, text, flags=re.DOTALL).splitlines()
