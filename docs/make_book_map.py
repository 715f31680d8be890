"""Write docs/book_map.md: ``python docs/make_book_map.py``.

The subjects are listed here; what computes each is found by the citations in docstrings of ``src``, and its tests by
what ``tests`` import.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from beamfield.figures.gallery import PANELS

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "book_map.md"
SOURCE = ROOT / "src" / "beamfield"
TESTS = ROOT / "tests"
GALLERY_TEST = Path("tests/figures/test_gallery.py")

# What each section, equation, table and figure is about. A text in brackets says why nothing computes it.
SECTIONS = {
    "6.1": "Sonars and lasers, and how they err",
    "6.2": "Maps: grids of cells and lists of features",
    "6.3": "Beam models",
    "6.3.1": "The four causes of a range",
    "6.3.2": "Learning the intrinsic parameters",
    "6.3.3": "Why Table 6.2 maximises the likelihood",
    "6.3.4": "Fewer beams, weaker beams, learning in the context of localization, pre-cached ranges",
    "6.3.5": "(discussion) Why the beam model is not smooth",
    "6.4": "Likelihood fields",
    "6.4.1": "The basic algorithm",
    "6.4.2": "Unknown space, and the field of a single scan",
    "6.5": "Matching a local map with the map",
    "6.6.1": "Extracting features",
    "6.6.2": "Landmarks: range, bearing, signature",
    "6.6.3": "Landmarks of known correspondence",
    "6.6.4": "Sampling poses from a landmark",
    "6.6.5": "What features keep of a scan",
    "6.7": "(discussion) Which model for which purpose",
    "6.10": "The exercise: a marker on the ceiling",
}
EQUATIONS = {
    1: "A scan is a set of ranges",
    2: "Ranges are independent given the pose",
    3: "A map is a list of objects",
    4: "p_hit, cut to [0, z_max]",
    5: "The normal density",
    6: "The normaliser of p_hit",
    7: "p_short, cut to [0, z*]",
    8: "The mass of the exponential up to z*",
    9: "The normaliser of p_short",
    10: "p_max, a point mass",
    11: "p_rand, uniform",
    12: "The mixture of the four",
    13: "The likelihood of a data set",
    14: "Weights of beams whose causes are known",
    15: "The likelihood of the hits",
    16: "Its logarithm",
    17: "The same, simplified",
    18: "Its derivative",
    19: "sigma_hit of known hits",
    20: "The likelihood of the shorts",
    21: "Its logarithm",
    22: "Its derivative",
    23: "lambda_short of known shorts",
    24: "The likelihood with unknown causes",
    25: "The same with indicators of the causes",
    26: "Its expectation",
    27: "The E-step: probabilities of the causes",
    28: "Their normaliser",
    29: "The M-step: weights",
    30: "The M-step: sigma_hit",
    31: "The M-step: lambda_short",
    32: "The end point of a beam",
    33: "The density of a distance to the nearest obstacle",
    34: "The mixture of the likelihood field",
    35: "The correlation of two maps",
    36: "Their common mean",
    37: "The correlation taken as a likelihood",
    38: "A feature: range, bearing, signature",
    39: "Features are independent given the pose",
    40: "The noise of a landmark's range, bearing and signature",
    41: "The pose given a feature, under a uniform prior",
    42: "What a sufficient statistic is",
}
TABLES = {
    1: "The likelihood of a scan by beams",
    2: "Learning the intrinsic parameters",
    3: "The likelihood of a scan by its distance field",
    4: "The likelihood of a landmark",
    5: "Sampling poses from a landmark",
}
FIGURES = {
    1: "A sonar scan, and how sonars are misled",
    2: "A laser scan",
    3: "The four densities",
    4: "Their mixture",
    5: "Ranges of a sonar and of a laser",
    6: "Models fitted to them",
    7: "The likelihood of a scan over the map",
    8: "A likelihood field",
    9: "The density along a beam, by the field",
    10: "A map, and its likelihood field",
    11: "The likelihood field of one scan",
    12: "A local map of ten scans",
    13: "Where a landmark may be seen from",
}
EXERCISES = {"1": "A marker on the ceiling: expected place, image, and the robot's pose"}

_INTRODUCTION = """# The chapter, item by item

What computes every section, equation, table, figure and exercise of chapter 6 of *Probabilistic Robotics*, and a test.
Written by `python docs/make_book_map.py` from the citations in the docstrings; names are within `beamfield`.
"""
_ORDER = ("sensors", "detections", "models", "maps", "features", "calibration", "localization", "simulation")
_RANGE = re.compile(r"\(6\.(\d+)\)\s+to\s+\(6\.(\d+)\)")
_EQUATION = re.compile(r"\(6\.(\d+)\)")
_TABLE = re.compile(r"Tables?\s+6\.(\d+)")
_FIGURE = re.compile(r"Figures?\s+6\.(\d+)")
_SECTION = re.compile(r"\b6\.(?:[1-5]|10)(?:\.[1-5])?\b|\b6\.6\.[1-5]\b|\b6\.7\b")
_EXERCISE = re.compile(r"[Ee]xercises? (\d)")


@dataclass(frozen=True)
class Definition:
    """A public function or class, or a module, and what its docstring cites."""

    module: str
    name: str
    cites: frozenset[str] = field(compare=False)

    @property
    def shown(self) -> str:
        return f"`{self.module}{'.' if self.name else ''}{self.name}`"


def cited(text: str) -> frozenset[str]:
    """Return what a docstring cites, such as "(6.12)", "Table 6.1", "Figure 6.7", "6.3.2" and "Exercise 1"."""
    found = {f"({number})" for a, b in _RANGE.findall(text) for number in map("6.{}".format, range(int(a), int(b) + 1))}
    found |= {f"(6.{number})" for number in _EQUATION.findall(text)}
    found |= {f"Table 6.{number}" for number in _TABLE.findall(text)}
    found |= {f"Figure 6.{number}" for number in _FIGURE.findall(text)}
    found |= {f"Exercise {number}" for number in _EXERCISE.findall(text)}
    rest = re.sub(r"\(6\.\d+\)|(?:Tables?|Figures?)\s+6\.\d+(?:(?:,| and| to)\s+6\.\d+)*", "", text)
    return frozenset(found | set(_SECTION.findall(rest)))


def definitions() -> Iterator[Definition]:
    """Walk through the modules, public functions and classes of the package, the kernels' last."""
    for path in sorted(SOURCE.rglob("*.py"), key=lambda path: ("kernels" in path.parts, path)):
        module = ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
        tree = ast.parse(path.read_text())
        yield Definition(module, "", cited(ast.get_docstring(tree) or ""))
        for node in tree.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                yield Definition(module, node.name, cited(" ".join(_docstrings(node))))


def _docstrings(node: ast.FunctionDef | ast.ClassDef) -> Iterator[str]:
    for inner in (node, *node.body):
        if isinstance(inner, (ast.FunctionDef, ast.ClassDef)):
            yield ast.get_docstring(inner) or ""


def imports() -> dict[str, list[Path]]:
    """Return which test files import a module or one of its names."""
    users: dict[str, list[Path]] = {}
    for path in sorted(TESTS.rglob("test_*.py")):
        # Imports come before the first two blank lines.
        for node in ast.parse(path.read_text().partition("\n\n\n")[0]).body:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("beamfield."):
                module = (node.module or "").removeprefix("beamfield.")
                for name in {module, *(f"{module}.{alias.name}" for alias in node.names)}:
                    users.setdefault(name, []).append(path)
    return users


def tests_of(definition: Definition, users: dict[str, list[Path]]) -> list[Path]:
    """Return the tests of a definition: those that import it, the one named after its module first."""
    paths = users.get(f"{definition.module}.{definition.name}" if definition.name else definition.module, [])
    package, _, own = definition.module.rpartition(".")
    return sorted(
        dict.fromkeys(paths), key=lambda path: (path.parent.name != package.partition(".")[0], own not in path.stem)
    )


def rows(subjects: dict[str, str], known: list[Definition], users: dict[str, list[Path]]) -> Iterator[str]:
    """Yield a line of a table for each subject."""
    for label, subject in subjects.items():
        # What is tested by name; a definition says more than its module, and what cites little is about it.
        found = [item for item in known if label in item.cites and tests_of(item, users)]
        found = [item for item in found if item.name] or found
        found.sort(key=lambda item: (_rank(item.module, label), len(item.cites)))
        n = max(3, subject.count(",") + 1)
        if n > 3:
            # Several subjects: the first of each package.
            found = [item for i, item in enumerate(found) if _package(item) not in map(_package, found[:i])]
        names = [item.shown for item in found[:n]]
        tests = [tests_of(item, users)[0].relative_to(ROOT) for item in found[:n]]
        if label.startswith("Figure"):
            names, tests = [_command(label), *names[:2]], [GALLERY_TEST, *tests[:2]]
        names, tests = list(dict.fromkeys(names)), list(dict.fromkeys(tests))
        yield f"| {label} | {subject} | {', '.join(names)} | {', '.join(f'`{path}`' for path in tests)} |"


def _package(item: Definition) -> str:
    return item.module.partition(".")[0]


def _command(figure: str) -> str:
    """Return the command that draws a figure; some are a panel of another."""
    number = figure.removeprefix("Figure ")
    panel, _, whole = PANELS.get(number, "").rpartition(" of ")
    return f"`beamfield figures --only {whole or number}`{f', panel {panel}' if panel else ''}"


def _rank(module: str, label: str) -> int:
    """Return where to look for an item first: a figure among the figures, all else among models and maps."""
    order = ("figures", *_ORDER) if label.startswith("Figure") else _ORDER
    package = module.partition(".")[0]
    return order.index(package) if package in order else len(order)


def page() -> str:
    """Return the whole page."""
    known, users = list(definitions()), imports()
    parts = [_INTRODUCTION]
    for title, subjects in (
        ("Sections", SECTIONS),
        ("Equations", {f"(6.{number})": subject for number, subject in EQUATIONS.items()}),
        ("Tables", {f"Table 6.{number}": subject for number, subject in TABLES.items()}),
        ("Figures", {f"Figure 6.{number}": subject for number, subject in FIGURES.items()}),
        ("Exercises", {f"Exercise {number}": subject for number, subject in EXERCISES.items()}),
    ):
        parts.append(f"\n## {title}\n\n| | subject | computed by | tested by |\n|---|---|---|---|\n")
        parts.append("\n".join(rows(subjects, known, users)) + "\n")
    return "".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page())
