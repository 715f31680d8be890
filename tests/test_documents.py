"""The Python in README.md and docs/ runs, the commands there are commands, and links lead to files.

Notebooks run where the site is built (`make site`), which stops at their first error.

Blocks of one document run one after the other, as a reader would type them. Most begin with things a user has: a log, a
map, particles. `STAND_INS` gives them small ones and thereby says what a document takes for granted; a document that is
not in it must run as it stands.
"""

from __future__ import annotations

import ast
import re
import runpy
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

import beamfield as bf
from beamfield.cli.main import build_parser
from beamfield.detection_log import DetectionLog
from beamfield.detections import Detections
from beamfield.io.landmarks.landmark_files import write_landmarks
from beamfield.io.landmarks.line_files import write_line_map
from beamfield.io.logs.carmen_writer import write_carmen
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.lines import LineMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.line import LineModel, LineParameters
from beamfield.sensors import RangeFinder, Scan, ScanLog, SensorLog
from beamfield.stacks.nav2.parameters import Nav2Parameters
from tests.io.mini_bag import MiniBag, quaternion
from tests.io.test_fiducial_detections import CameraBag
from tests.sightings_file import write_sightings

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.md"))
DOCUMENTS = [ROOT / "README.md", *sorted(DOCS.glob("*.md")), *sorted((DOCS / "evidence").glob("*.md")), *NOTEBOOKS]
PYTHON = re.compile(r"^```(?:python|\{code-cell\}[^\n]*)\n(?::tags:[^\n]*\n)?(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^(?: {4}|\$ )?(beamfield [a-z].*?)(?:\s+#.*)?$", re.MULTILINE)

# What docs and examples may import besides `import beamfield as bf`, because few programs need it.
DEEP = {
    "beamfield.calibration.pose_windows",
    "beamfield.features.feature",
    "beamfield.io.bags.fiducial_detections",
    "beamfield.io.logs.carmen_writer",
    "beamfield.features.map_features",
    "beamfield.localization.information",
    "beamfield.localization.pose_posterior",
    "beamfield.maps.end_points",
    "beamfield.models.marker",
    "beamfield.simulation.dependence",
    "beamfield.simulation.sonar",
}
# What a document needs besides beamfield; without, its Python does not run.
NEEDS = {"fleet": ("distributed", "pyarrow", "fsspec", "polars", "duckdb", "pandas")}
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


class World:
    """A room of 6 x 4 m with a box in it, and a robot that drives round the box."""

    def __init__(self) -> None:
        cells = np.zeros((40, 60))
        cells[[0, -1]] = cells[:, [0, -1]] = cells[16:24, 24:36] = 100
        self.grid = OccupancyGrid.from_ros(cells, resolution=0.1)
        self.parameters = BeamParameters(0.85, 0.05, 0.05, 0.05, sigma_hit=0.03, lambda_short=0.5)
        self.finder = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 91), max_range=8.0, name="/scan")
        self.model = BeamModel(self.grid, self.parameters, finder=self.finder)
        corners = [(0.1, 0.1), (5.9, 0.1), (5.9, 3.9), (0.1, 3.9)]
        self.walls = LineMap.from_segments([[*a, *b] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)])
        self.rng = np.random.default_rng(20260101)

    @cached_property
    def log(self) -> SensorLog:
        angle = np.linspace(0.0, 4.0 * np.pi, 200)
        poses = np.column_stack([3.0 + 1.9 * np.cos(angle), 2.0 + 1.3 * np.sin(angle), angle + 0.5 * np.pi])
        ranges = np.array([scan.ranges for scan in self.model.sample(poses, rng=self.rng)])
        return SensorLog(self.finder, 0.2 * np.arange(len(poses)), ranges, poses, poses)

    @property
    def scan(self) -> Scan:
        return self.log.scan(10)

    @property
    def particles(self) -> np.ndarray:
        return self.log.poses[10] + self.rng.normal(0.0, 0.05, (50, 3))

    def write_map(self) -> None:
        write_map(self.grid, "map.yaml")

    def write_log(self) -> None:
        bag = MiniBag("ros1").tf("base_link", "laser", 0.0, static=True)
        first, step = float(self.finder.bearings[0]), float(np.diff(self.finder.bearings)[0])
        for scan, (x, y, theta) in zip(self.log, self.log.poses.tolist(), strict=True):
            bag.scan(scan.stamp, scan.ranges, angle_min=first, increment=step, range_max=self.finder.max_range)
            bag.tf("map", "base_link", scan.stamp, (x, y, 0.0), quaternion(yaw=theta))
        bag.write(Path.cwd(), "run")


@pytest.fixture(scope="module")
def world() -> World:
    return World()


def readme(world: World) -> dict[str, Any]:
    world.write_map()
    return {"ranges": np.full(180, 1.0), "particles": world.particles}


def alignment(world: World) -> dict[str, Any]:
    return {"log": world.log}


def calibrate(world: World) -> dict[str, Any]:
    world.write_map()
    world.write_log()
    return {}


def calibrate_stack(world: World) -> dict[str, Any]:
    return {"log": world.log, "grid": world.grid}


def features(world: World) -> dict[str, Any]:
    parameters = LineParameters(0.03, 0.02, spurious_rate=0.1, max_range=8.0)
    line_model = LineModel(world.walls, parameters, correspondence="sum")
    return {
        "scan": world.scan,
        "pose": world.log.poses[10],
        "beam_model": world.model,
        "line_model": line_model,
    }


def features_measured(world: World) -> dict[str, Any]:
    return {"scan": world.scan, "log": world.log, "grid": world.grid, "parameters": world.model.parameters}


def landmark_learning(world: World) -> dict[str, Any]:
    landmarks = LandmarkMap([[0.0, 0.0], [6.0, 0.0], [3.0, 4.0]])
    noise = LandmarkParameters(sigma_range=0.1, sigma_bearing=0.02)
    model = LandmarkModel(landmarks, noise, correspondence="known", mount=(0.2, 0.0, 0.0))
    seen = model.sample(world.log.poses, world.rng)
    stamps = world.log.stamps.tolist()
    log = DetectionLog(
        world.log.poses,
        tuple(Detections(z.ranges, z.bearings, ids=z.ids, stamp=t) for z, t in zip(seen, stamps, strict=True)),
    )
    write_landmarks("tags.csv", landmarks)
    write_sightings("seen.csv", log)
    return {}


def landmarks(world: World) -> dict[str, Any]:
    write_landmarks("tags.csv", LandmarkMap([[3.0, 1.0], [1.0, 4.0]], ids=[7, 9]))
    return {"particles": world.particles, "rng": world.rng}


def likelihood_field(world: World) -> dict[str, Any]:
    return {"grid": world.grid, "log": world.log, "scan": world.scan, "poses": world.particles}


def likelihood_map(world: World) -> dict[str, Any]:
    return {"grid": world.grid, "model": world.model, "scan": world.scan}


def lines(world: World) -> dict[str, Any]:
    write_line_map("walls.csv", world.walls)
    return {"scan": world.scan, "particles": world.particles}


def marker(world: World) -> dict[str, Any]:
    del world
    bag = CameraBag().camera().corners(1.0, (7, [300.0, 200.0, 340.0, 200.0, 340.0, 240.0, 300.0, 240.0]))
    bag.write(Path.cwd(), "both").rename("camera.bag")
    Path("markers.bag").write_bytes(Path("camera.bag").read_bytes())
    return {}


def localization(world: World) -> dict[str, Any]:
    return {"grid": world.grid, "log": world.log[:20]}


def odometry(world: World) -> dict[str, Any]:
    return {"log": world.log}


def range_table(world: World) -> dict[str, Any]:
    return {"grid": world.grid, "poses": world.particles, "finder": world.finder}


def fleet(world: World) -> dict[str, Any]:
    Path("fleet").mkdir()
    write_map(world.grid, "fleet/room.yaml")
    write_carmen("fleet/run.log", ScanLog({"FLASER": world.log}, source="run.log"))
    Path("fleet.csv").write_text("log,map,robot,site\nfleet/run.log,fleet/room.yaml,ann,hall\n")
    return {}


def raycasting(world: World) -> dict[str, Any]:
    return {"grid": world.grid, "poses": world.particles, "finder": world.finder, "origins": world.particles}


def changed_places(world: World) -> dict[str, Any]:
    return {"log": world.log, "grid": world.grid, "parameters": world.parameters}


def scan_fit(world: World) -> dict[str, Any]:
    return {"model": world.model, "good_log": world.log, "scan": world.scan, "pose": world.log.poses[10],
            "log": world.log}  # fmt: skip


def stacks(world: World) -> dict[str, Any]:
    candidates = [Nav2Parameters(sigma_hit=sigma, max_beams=90) for sigma in (0.05, 0.2)]
    return {"grid": world.grid, "scan": world.scan, "poses": world.particles, "candidates": candidates}


STAND_INS: dict[str, Callable[[World], dict[str, Any]]] = {
    "README": readme,
    "alignment": alignment,
    "calibrate": calibrate,
    "calibrate_stack": calibrate_stack,
    "changed_places": changed_places,
    "evidence/features": features_measured,
    "features": features,
    "fleet": fleet,
    "in_context": calibrate_stack,
    "landmark_learning": landmark_learning,
    "landmarks": landmarks,
    "likelihood_field": likelihood_field,
    "likelihood_map": likelihood_map,
    "lines": lines,
    "localization": localization,
    "marker": marker,
    "odometry": odometry,
    "range_table": range_table,
    "raycasting": raycasting,
    "scan_fit": scan_fit,
    "stacks": stacks,
}


@dataclass(frozen=True)
class Block:
    """Python of a document, from a line on."""

    path: Path
    line: int
    text: str

    def run(self, names: dict[str, Any]) -> None:
        # Blank lines in front, so that a traceback shows the line of the document.
        exec(compile("\n" * (self.line - 1) + self.text, str(self.path), "exec"), names)
        plt.close("all")


def blocks_of(path: Path) -> list[Block]:
    text = path.read_text(encoding="utf-8")
    return [Block(path, text.count("\n", 0, found.start(1)) + 1, found[1]) for found in PYTHON.finditer(text)]


def commands_of(path: Path) -> list[str]:
    """Return the command lines of a document, those that go on in the next line as one."""
    return COMMAND.findall(path.read_text(encoding="utf-8").replace("\\\n", " "))


def name_of(path: Path) -> str:
    """Return the name of a document within docs, which tells a page from the evidence for it."""
    return path.stem if path.parent in (ROOT, DOCS) else f"{path.parent.name}/{path.stem}"


WITH_PYTHON = [path for path in DOCUMENTS if blocks_of(path)]
COMMANDS = sorted({command for path in DOCUMENTS for command in commands_of(path)})


EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("path", [*WITH_PYTHON, *EXAMPLES], ids=lambda path: path.name)
def test_documents_and_examples_come_in_by_the_front_door(path: Path):
    whole = path.read_text(encoding="utf-8")
    text = "\n".join(block.text for block in blocks_of(path)) if path.suffix == ".md" else whole
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names = [(alias.name, alias.asname) for alias in node.names if alias.name.startswith("beamfield")]
            assert names in ([], [("beamfield", "bf")])
        elif isinstance(node, ast.ImportFrom) and str(node.module).startswith("beamfield"):
            assert node.module in DEEP or str(node.module).startswith("beamfield.stacks."), node.module
            assert [alias.name for alias in node.names if alias.name in bf.__all__] == []
    # Names in prose and tables, too.
    assert [name for name in re.findall(r"\bbf\.(\w+)", whole) if name not in bf.__all__] == []


@pytest.mark.parametrize("path", [path for path in WITH_PYTHON if path not in NOTEBOOKS], ids=name_of)
def test_the_python_of_a_document_runs(path: Path, world: World, tmp_path, monkeypatch):
    for package in NEEDS.get(name_of(path), ()):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    names = STAND_INS[name_of(path)](world) if name_of(path) in STAND_INS else {}
    for block in blocks_of(path):
        block.run(names)


@pytest.mark.real
def test_the_particle_filter_follows_the_robot_of_wean_hall(data: Path, monkeypatch):
    monkeypatch.setenv("WEAN_HALL", str(data / "wean_hall"))
    names: dict[str, Any] = {}
    for block in blocks_of(DOCS / "notebooks/particle_filter.md"):
        block.run(names)
    assert len(names["log"]) == 713


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_checks_what_it_shows_and_says_where_the_book_is_not_literal(path: Path):
    text = path.read_text(encoding="utf-8")
    assert text.startswith("---\njupytext:\n")
    assert f"{{nb-download}}`Download as a notebook <{path.stem}.ipynb>`" in text
    assert sum(block.text.count("assert ") for block in blocks_of(path)) >= 2
    assert ("## Where the book must not be taken literally" in text) == path.stem.startswith("chapter")


def test_the_site_lists_its_versions_and_leads_to_the_newest(tmp_path: Path):
    for version in ("0.9.0", "0.10.0"):
        (tmp_path / version).mkdir()
        (tmp_path / version / "index.html").touch()
    runpy.run_path(str(DOCS / "make_versions.py"))["main"](tmp_path)
    assert '["0.10.0", "0.9.0"]' in (tmp_path / "versions.js").read_text(encoding="utf-8")
    assert 'url=0.10.0/index.html"' in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_the_filter_in_a_ros_node_weighs_its_particles(world: World):
    names: dict[str, Any] = {"bf": bf, "np": np}
    path = ROOT / "docs" / "likelihood_field.md"
    next(block for block in blocks_of(path) if "class Filter" in block.text).run(names)
    node, scan = names["Filter"](), world.scan
    first, step = float(world.finder.bearings[0]), float(np.diff(world.finder.bearings)[0])
    header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0), frame_id="laser")
    info = SimpleNamespace(width=60, height=40, resolution=0.1, origin=SimpleNamespace(
        position=SimpleNamespace(x=0.0, y=0.0), orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)))  # fmt: skip
    node.on_map(SimpleNamespace(info=info, data=(100 * world.grid.probability).astype(np.int8).ravel()))
    # The node's laser is 0.2 m before the robot's centre.
    right = bf.geometry.compose(world.log.poses[10], [-0.2, 0.0, 0.0])
    node.particles = np.stack([right, right + np.array([1.0, 0.3, 1.0])])
    node.on_scan(SimpleNamespace(header=header, angle_min=first, angle_increment=step, range_min=0.0, range_max=8.0,
                                 ranges=scan.ranges))  # fmt: skip
    assert node.weights[0] > 0.99


@pytest.mark.parametrize("name", STAND_INS)
def test_a_document_gets_nothing_that_it_does_not_use(name: str, world: World, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = STAND_INS[name](world)
    text = "\n".join(block.text for path in WITH_PYTHON if name_of(path) == name for block in blocks_of(path))
    files = [path.name for path in tmp_path.iterdir() if path.suffix in {".yaml", ".csv", ".bag"}]
    assert given or files
    assert [word for word in given if not re.search(rf"\b{word}\b", text)] == []
    assert [file for file in files if f'"{file}"' not in text] == []


def test_documents_have_commands_and_python():
    assert len(WITH_PYTHON) >= 16
    assert len(COMMANDS) >= 25


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_a_document_is_one(command: str, capsys):
    # What may be left out is there, of alternatives the first; letters stand for numbers.
    whole = re.sub(r"\s\|[^\]]*", "", command).replace("[", "").replace("]", "")
    words = [{"M": "5", "N": "5", "STACK": "nav2"}.get(word, word) for word in shlex.split(whole)[1:]]
    try:
        build_parser().parse_args(words)
    except SystemExit:
        pytest.fail(f"{command}: {capsys.readouterr().err}")


@pytest.mark.parametrize("path", [*DOCUMENTS, ROOT / "CONTRIBUTING.md"], ids=name_of)
def test_links_of_a_document_lead_to_files(path: Path):
    links = [link for link in LINK.findall(path.read_text(encoding="utf-8")) if "://" not in link]
    assert [link for link in links if not (path.parent / link).exists()] == []


def findings() -> dict[str, str]:
    """Return where each finding is made, by its name in backquotes, as pages have it."""
    source = ROOT / "src" / "beamfield"
    return {
        f"`{name.value}`": f"{path.relative_to(source)}:{node.lineno}"
        for path in sorted(source.rglob("*.py"))
        if "Finding(" in (text := path.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Finding" and node.args
        for name in ast.walk(node.args[0])
        if isinstance(name, ast.Constant) and re.fullmatch(r"[a-z]+(-[a-z]+)*", str(name.value))
    }


def test_every_finding_is_on_a_page():
    pages = "".join(path.read_text(encoding="utf-8") for path in DOCS.glob("*.md"))
    found = findings()
    assert len(found) > 60
    assert {name: where for name, where in found.items() if name not in pages} == {}
