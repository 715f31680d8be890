"""What the explorer answers: the map, the log, and what models say of a scan at a pose."""

from __future__ import annotations

import base64
import io
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from beamfield.errors import InvalidInputError
from beamfield.explorer.heat_maps import finite, heat_around, heat_over, quick_weights
from beamfield.explorer.parameter_set import ParameterSet, with_common_ends
from beamfield.explorer.reading import beam_parameters, reading_density, reading_score
from beamfield.explorer.requests import Request
from beamfield.explorer.scores import PoseScores
from beamfield.explorer.shown_run import AGREEMENT, ShownRun, run_from
from beamfield.geometry import FloatArray
from beamfield.kernels.threads import n_threads, set_threads
from beamfield.maps.occupancy import BoolArray, OccupancyGrid
from beamfield.maps.ray_agreement import LEAST_AGREEMENT
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_density import beam_responsibilities
from beamfield.sensors import Scan, SensorLog, usable_ranges

# Pixels of the map's picture along its longer side, at most.
LARGEST_PICTURE = 4000
MOST_BEAMS = 720
# Scans by which values are judged live; scans that are scored together.
JUDGED_SCANS, SCORED_SCANS = 24, 20
MODELS_KEPT = 12

Numbers = Mapping[str, FloatArray]
Values = Mapping[str, float]


class Session:
    """A log in its map with sets of parameters; knows nothing of pages and servers.

    Parameters
    ----------
    log
        The scans; reference poses are where the robot is shown first.
    grid
        The map.
    sets
        What is shown side by side; at least one.
    numbers
        Values (t,) at the scans, for the timeline, by name.
    run
        What a filter did on the log.
    held_out
        (n,) indices of scans that no set was learned from, by which values are judged; None takes all.

    Raises
    ------
    InvalidInputError
        If the log has no scans, or there is no set.
    """

    def __init__(
        self,
        log: SensorLog,
        grid: OccupancyGrid,
        sets: Sequence[ParameterSet],
        *,
        numbers: Numbers | None = None,
        run: ShownRun | None = None,
        held_out: NDArray[np.integer[Any]] | None = None,
    ) -> None:
        if len(log) == 0 or not sets:
            raise InvalidInputError("log, sets: expected scans, and at least one set of parameters")
        self.log, self.grid, self.sets, self.run = log, grid, with_common_ends(sets), run
        self.numbers = {**(numbers or {}), **(run.numbers if run else {})}
        self._held_out = held_out
        self._models: dict[Any, Any] = {}
        self._weights: dict[Any, Any] = {}
        self._means: dict[Any, dict[str, float | None]] = {}
        self._lock = threading.Lock()
        self._answers: dict[str, Callable[[Request], dict[str, Any]]] = {
            "start": self._start,
            "scan": self._scan,
            "heat": self._heat,
            "building": self._building,
            "density": self._density,
            "scores": self._scores,
            "judge": self._judge,
            "filter": self._filter,
            "file": self._file,
        }

    def answer(self, message: Any) -> dict[str, Any]:
        """Answer a message of the page with what JSON can hold.

        The message is decoded JSON: an object with `name` (start, scan, heat, building, density, scores, judge, filter,
        file) and what that needs. InvalidInputError if it is not one that the page can send.
        """
        request = Request.parsed(message)
        if request.name not in self._answers:
            raise InvalidInputError(f"name: expected one of {', '.join(self._answers)}")
        return self._answers[request.name](request)

    def _start(self, _: Request) -> dict[str, Any]:
        """Return what the page shows first: the map, the scans' times and poses, the sets."""
        log, finder = self.log, _thinned(self.log[0]).finder
        known = np.asarray(np.isfinite(log.poses).all(axis=1))
        rows, cols = self.grid.shape
        return {
            "map": {
                "picture": self._picture,
                "width_m": cols * self.grid.resolution,
                "height_m": rows * self.grid.resolution,
                "origin": self.grid.origin,
                "free": self._extent,
            },
            "times": log.stamps - log.stamps[0],
            "poses": [pose if ok else None for pose, ok in zip(log.poses.tolist(), known.tolist(), strict=True)],
            "mounts": finder.mounts,
            "max_range": finder.max_range,
            "sets": [
                {
                    "label": one.label,
                    "kind": one.kind,
                    "family": one.family,
                    "values": one.values,
                    "sliders": [vars(slider) for slider in one.sliders],
                }
                for one in self.sets
            ],
            "numbers": {name: _with_gaps(values) for name, values in self.numbers.items()},
            "levels": {AGREEMENT: LEAST_AGREEMENT} if AGREEMENT in self.numbers else {},
            "here": self._first_pose(),
            "run": None if self.run is None else _shown(self.run),
        }

    @cached_property
    def _picture(self) -> str:
        """The map as a PNG in base64: white is free, black occupied, transparent unknown."""
        step = -(-max(self.grid.shape) // LARGEST_PICTURE)
        free, occupied = _any_in_blocks(self.grid.free, step), _any_in_blocks(self.grid.occupied, step)
        pixels = np.zeros((*free.shape, 2), np.uint8)
        pixels[free] = (255, 255)
        pixels[occupied] = (0, 255)
        return _png(Image.fromarray(pixels[::-1], "LA"))

    @property
    def _extent(self) -> list[float]:
        """The least and the largest x, then y, of the free cells; of all cells if none is free."""
        rows, cols = np.nonzero(self.grid.free if self.grid.free.any() else np.ones(self.grid.shape, np.bool_))
        corners = np.array([[c, r] for c in (cols.min(), cols.max() + 1) for r in (rows.min(), rows.max() + 1)])
        x, y = self.grid.to_map(corners.astype(np.float64)).T
        return [float(value) for value in (x.min(), x.max(), y.min(), y.max())]

    def _first_pose(self) -> list[float]:
        known = self.log.poses[np.isfinite(self.log.poses).all(axis=1)]
        if len(known):
            return [float(value) for value in known[0]]
        middle = np.argwhere(self.grid.free)
        row, col = middle[len(middle) // 2] if len(middle) else (0, 0)
        x, y = self.grid.to_map(np.array([[col + 0.5, row + 0.5]]))[0]
        return [float(x), float(y), 0.0]

    def _scan(self, request: Request) -> dict[str, Any]:
        """Return a scan at a pose: ranges, expected ranges, what sets think of each reading, every set's score."""
        scan, i = self._scan_of(request)
        pose = np.array(request.pose())
        usable = usable_ranges(scan.ranges, scan.finder)
        expected = self._caster.expected_ranges(pose, scan.finder)
        reference = self.log.poses[i]
        poses = np.stack([pose, reference]) if np.isfinite(reference).all() else pose[None]
        values = [one.checked(request.parameters(number)) for number, one in enumerate(self.sets)]
        models = [self._model(one, own) for one, own in zip(self.sets, values, strict=True)]
        return {
            "ranges": _with_gaps(usable),
            "expected": expected,
            "shares": {
                number: self._shares(scan, usable, expected, self.sets[number], values[number], pose)
                for number in request.integers("shown", len(self.sets), 2)
            },
            "scores": [_score(model.log_likelihood(scan, poses)) for model in models],
            "values": values,
        }

    def _shares(
        self, scan: Scan, usable: FloatArray, expected: FloatArray, one: ParameterSet, values: Values, pose: FloatArray
    ) -> list[Any] | None:
        """Return for each reading the shares of its causes (beam model) or of a hit (field); None for other models."""
        finder = scan.finder
        if one.kind == "beam":
            parameters = beam_parameters(values)
            shares = beam_responsibilities(usable, expected, finder.max_range, parameters, min_range=finder.min_range)
            return [None if not row.any() else row.tolist() for row in shares]
        if one.kind == "field":
            off = self._model(one, values).distances_to_obstacles(scan, pose) / values["sigma_hit"]
            # (6.34): the part of the hit in the value of each reading.
            near = values["z_hit"] * np.exp(-0.5 * off**2) / (values["sigma_hit"] * np.sqrt(2.0 * np.pi))
            hit = near / (near + max(values["z_rand"], 1e-12) / finder.max_range)
            return [
                None if np.isnan(share) or z >= finder.max_range else [float(share)]
                for z, share in zip(usable, hit, strict=True)
            ]
        return None

    def _heat(self, request: Request) -> dict[str, Any]:
        scan, _ = self._scan_of(request)
        one, values = self._set_of(request)
        width, dragged = request.number("width_m", 0.1, 50.0), request.flag("dragged")
        model = self._model(one, values)
        # One processor is left to the scores and the browser.
        with set_threads(max(1, n_threads() - 1)):
            return heat_around(one, model, self._weigh(one, model), scan, request.pose(), width, dragged=dragged)

    def _building(self, request: Request) -> dict[str, Any]:
        scan, _ = self._scan_of(request)
        one, values = self._set_of(request)
        return heat_over(one, values, self._model(one, values), scan, self.grid)

    def _density(self, request: Request) -> dict[str, Any]:
        """Return the density of one beam's range at a pose, and what its reading is worth."""
        scan, _ = self._scan_of(request)
        pose = np.array(request.pose())
        one, values = self._set_of(request)
        beam = request.integer("beam", scan.finder.n_beams)
        return reading_density(one, values, scan, pose, beam, self._caster)

    def _scores(self, request: Request) -> dict[str, Any]:
        """Return by which sets scans are explained better; None for scans without a reference pose."""
        scans = request.integers("scans", len(self.log), SCORED_SCANS)
        numbers = request.integers("sets", len(self.sets), len(self.sets))
        if not numbers:
            raise InvalidInputError("sets: expected at least one")
        chosen = [(self.sets[k], self.sets[k].checked(request.parameters(k))) for k in numbers]
        return {"scores": [self._scores_at(i, chosen) for i in scans]}

    def _scores_at(self, i: int, chosen: Sequence[tuple[ParameterSet, Values]]) -> dict[str, Any] | None:
        """Return `PoseScores`, and the mean log density of a reading by each beam model, None by others."""
        pose = self.log.poses[i]
        if not np.isfinite(pose).all():
            return None
        scan = _thinned(self.log[i])
        return {
            "pose": self._pose_scores([self._model(one, values) for one, values in chosen], scan, pose),
            "reading": [reading_score(one, values, scan, pose, self._caster) for one, values in chosen],
        }

    def _judge(self, request: Request) -> dict[str, Any]:
        """Return the mean scores over scans of the whole log, of the set's values as they are and as they were."""
        one, values = self._set_of(request)
        now, before = self._mean_scores(one, values), self._mean_scores(one, one.values)
        return {"now": now, "before": before, "scans": len(self._judged), "held_out": self._held_out is not None}

    def _mean_scores(self, one: ParameterSet, values: Values) -> dict[str, float | None]:
        key = (one.label, tuple(values.items()))
        if key not in self._means:
            scores = [self._scores_at(i, [(one, values)]) for i in self._judged]
            self._means = dict(list(self._means.items())[-MODELS_KEPT:])
            self._means[key] = {
                name: _mean([score[name][0] for score in scores if score]) for name in ("pose", "reading")
            }
        return self._means[key]

    @cached_property
    def _judged(self) -> list[int]:
        known = np.flatnonzero(np.isfinite(self.log.poses).all(axis=1))
        if self._held_out is not None:
            known = np.intersect1d(known, self._held_out)
        return known[np.unique(np.linspace(0, len(known) - 1, JUDGED_SCANS).astype(int))].tolist() if len(known) else []

    def _filter(self, request: Request) -> dict[str, Any]:
        """Return the path of a particle filter from a scan and a pose on, and some of its particles."""
        i = request.integer("i", len(self.log))
        one, values = self._set_of(request)
        return _shown(run_from(self.log, self.grid, one.make_for_filter(values), i, request.pose()))

    def _file(self, request: Request) -> dict[str, Any]:
        """Return name and content of a file with the values."""
        one, values = self._set_of(request)
        name, text = one.write(values)
        return {"file": name, "text": text}

    def _scan_of(self, request: Request) -> tuple[Scan, int]:
        i = request.integer("i", len(self.log))
        return _thinned(self.log[i]), i

    def _set_of(self, request: Request) -> tuple[ParameterSet, dict[str, float]]:
        number = request.integer("set", len(self.sets))
        one = self.sets[number]
        return one, one.checked(request.parameters(number))

    def _model(self, one: ParameterSet, values: Values) -> Any:
        """Return a model, one of the last few if it is among them: a field has tables of the map's size."""
        key = (one.label, tuple(values.items()))
        with self._lock:
            if key not in self._models:
                if len(self._models) >= MODELS_KEPT + len(self.sets):
                    del self._models[next(iter(self._models))]
                self._models[key] = one.make(values)
            self._models[key] = self._models.pop(key)
            return self._models[key]

    def _weigh(self, one: ParameterSet, model: Any) -> Any:
        """Return the model's `quick_weights`, of the last two models: they have a table of the map's size."""
        if model not in self._weights:
            self._weights = dict([*self._weights.items()][-1:])
            self._weights[model] = quick_weights(one, model)
        return self._weights[model]

    @cached_property
    def _pose_scores(self) -> PoseScores:
        return PoseScores(self.grid)

    @cached_property
    def _caster(self) -> RayCaster:
        return RayCaster(self.grid)


def _thinned(scan: Scan) -> Scan:
    if scan.finder.n_beams <= MOST_BEAMS:
        return scan
    return scan.subset(np.unique(np.round(np.linspace(0, scan.finder.n_beams - 1, MOST_BEAMS)).astype(np.int64)))


def _any_in_blocks(mask: BoolArray, step: int) -> BoolArray:
    """Return which blocks of step x step cells hold any: walls of one cell must not vanish from a smaller picture."""
    for axis, n in enumerate(mask.shape):
        mask = np.logical_or.reduceat(mask, np.arange(0, n, step), axis=axis)
    return mask


def _png(picture: Image.Image) -> str:
    out = io.BytesIO()
    picture.save(out, "PNG")
    return base64.b64encode(out.getvalue()).decode()


def _score(log: FloatArray) -> dict[str, float | None]:
    """Return log p(z | x, m) at a pose, and how much more that is than at the reference pose, if there is one."""
    over = float(log[0] - log[1]) if len(log) == 2 and np.isfinite(log).all() else None
    return {"log": finite(log[0]), "over_reference": over}


def _shown(run: ShownRun) -> dict[str, Any]:
    """Return what the page draws of a run."""
    known: list[bool] = np.asarray(np.isfinite(run.poses).all(axis=1)).tolist()
    return {
        "poses": [pose if ok else None for pose, ok in zip(run.poses.round(4).tolist(), known, strict=True)],
        "particles": {i: cloud.round(3).tolist() for i, cloud in run.particles.items()},
        "lost": None if run.lost is None else run.lost.full_text,
    }


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _with_gaps(values: FloatArray) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values.tolist()]
