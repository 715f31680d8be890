"""What the explorer answers: the map, the log, and what models say of a scan at a pose."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from PIL import Image

from beamfield.errors import InvalidInputError
from beamfield.explorer.parameter_set import ParameterSet
from beamfield.explorer.requests import Request
from beamfield.geometry import FloatArray
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.localization.particle_filter import FilterOptions, Update
from beamfield.localization.replay import PoseBelief
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_density import beam_components, beam_responsibilities
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.gaussian_motion import GaussianMotion
from beamfield.sensors import Scan, SensorLog, usable_ranges

# Pixels of the map's picture along its longer side, at most.
LARGEST_PICTURE = 4000
# Beams of a scan that a heat map looks at.
HEAT_BEAMS, MOST_BEAMS = 20, 720
# Scans by which values are judged live.
JUDGED_SCANS = 60
# Of a heat map over the whole building: metres between places, headings, beams.
BUILDING_STEP, BUILDING_HEADINGS = 0.25, 36
# Nats below the best at which a heat map is empty.
DEPTH = 12.0
CURVE_POINTS = 300
MODELS_KEPT = 12
# Of a filter: particles, and how many of them are shown; standard deviations of its odometry, as in `localize`.
PARTICLES, DRAWN_PARTICLES = 2000, 150
ODOMETRY_NOISE = {"forward": 0.06, "sideways": 0.02, "shift": 0.02, "drift": 0.04, "turn": 0.08}

Numbers = Mapping[str, FloatArray]


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
    ) -> None:
        if len(log) == 0 or not sets:
            raise InvalidInputError("log, sets: expected scans, and at least one set of parameters")
        self.log, self.grid, self.sets = log, grid, list(sets)
        self.numbers = dict(numbers or {})
        self._models: dict[Any, Any] = {}
        self._answers: dict[str, Callable[[Request], dict[str, Any]]] = {
            "start": self._start,
            "scan": self._scan,
            "heat": self._heat,
            "building": self._building,
            "density": self._density,
            "filter": self._filter,
            "judge": self._judge,
            "file": self._file,
        }

    def answer(self, message: Any) -> dict[str, Any]:
        """Answer a message of the page.

        Parameters
        ----------
        message
            Decoded JSON: an object with `name` (start, scan, heat, building, density, filter, judge, file) and what
            that needs.

        Returns
        -------
        What JSON can hold.

        Raises
        ------
        InvalidInputError
            If the message is not one that the page can send.
        """
        request = Request.parsed(message)
        if request.name not in self._answers:
            raise InvalidInputError(f"name: expected one of {', '.join(self._answers)}")
        return self._answers[request.name](request)

    def _start(self, _: Request) -> dict[str, Any]:
        """Return what the page shows first: the map, the scans' times and poses, the sets."""
        log, finder = self.log, _thinned(self.log[0], MOST_BEAMS).finder
        known = np.asarray(np.isfinite(log.poses).all(axis=1))
        rows, cols = self.grid.shape
        return {
            "map": {
                "picture": self._picture,
                "width_m": cols * self.grid.resolution,
                "height_m": rows * self.grid.resolution,
                "origin": self.grid.origin,
            },
            "times": log.stamps - log.stamps[0],
            "poses": [pose if ok else None for pose, ok in zip(log.poses.tolist(), known.tolist(), strict=True)],
            "mounts": finder.mounts,
            "max_range": finder.max_range,
            "sets": [
                {
                    "label": one.label,
                    "kind": one.kind,
                    "values": one.values,
                    "sliders": [vars(slider) for slider in one.sliders],
                }
                for one in self.sets
            ],
            "numbers": {name: _with_gaps(values) for name, values in self.numbers.items()},
            "here": self._first_pose(),
        }

    @cached_property
    def _picture(self) -> str:
        """The map as a PNG in base64: white is free, black occupied, transparent unknown."""
        step = -(-max(self.grid.shape) // LARGEST_PICTURE)
        pixels = np.zeros((*self.grid.shape, 2), np.uint8)
        pixels[self.grid.free] = (255, 255)
        pixels[self.grid.occupied] = (0, 255)
        return _png(Image.fromarray(pixels[::-step, ::step], "LA"))

    def _first_pose(self) -> list[float]:
        known = self.log.poses[np.isfinite(self.log.poses).all(axis=1)]
        if len(known):
            return [float(value) for value in known[0]]
        middle = np.argwhere(self.grid.free)
        row, col = middle[len(middle) // 2] if len(middle) else (0, 0)
        x, y = self.grid.to_map(np.array([[col + 0.5, row + 0.5]]))[0]
        return [float(x), float(y), 0.0]

    def _scan(self, request: Request) -> dict[str, Any]:
        """Return a scan at a pose: ranges, expected ranges, what a set thinks of each reading, every set's score."""
        scan, i = self._scan_of(request)
        pose = np.array(request.pose())
        chosen, values = self._set_of(request)
        usable = usable_ranges(scan.ranges, scan.finder)
        expected = self._caster.expected_ranges(pose, scan.finder)
        return {
            "ranges": _with_gaps(usable),
            "expected": expected,
            "shares": self._shares(scan, usable, expected, chosen, values, pose),
            "scores": [self._score(number, one, request, scan, i, pose) for number, one in enumerate(self.sets)],
            "values": values,
        }

    def _score(
        self, number: int, one: ParameterSet, request: Request, scan: Scan, i: int, pose: FloatArray
    ) -> dict[str, float | None]:
        """Return log p(z | x, m) at the pose, and how much more that is than at the reference pose."""
        values = one.checked(request.parameters()) if number == request.fields.get("set", 0) else one.values
        model = self._model(one, values)
        reference = self.log.poses[i]
        poses = np.stack([pose, reference]) if np.isfinite(reference).all() else pose[None]
        scores = np.asarray(model.log_likelihood(scan, poses))
        over = float(scores[0] - scores[1]) if len(scores) == 2 and np.isfinite(scores).all() else None
        return {"log": _finite(scores[0]), "over_reference": over}

    def _shares(
        self,
        scan: Scan,
        usable: FloatArray,
        expected: FloatArray,
        one: ParameterSet,
        values: Mapping[str, float],
        pose: FloatArray,
    ) -> list[Any] | None:
        """Return for each reading the shares of its causes (beam model) or of a hit (field); None for other models."""
        finder = scan.finder
        if one.kind == "beam":
            parameters = _beam_parameters(values)
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
        """Return how likely the scan is at 60 x 60 places around a pose, each with the best of 36 headings."""
        scan, _ = self._scan_of(request)
        x, y, heading = request.pose()
        one, values = self._set_of(request)
        width = request.number("width_m", 0.1, 50.0, 3.0)
        turn = np.radians(request.number("turn_deg", 1.0, 360.0, 60.0))
        n = int(request.number("places", 4, 60, 60))
        n_headings = int(request.number("headings", 1, 36, 36))
        steps = (np.arange(n) + 0.5) / n - 0.5
        headings = heading + turn * (np.arange(n_headings) - (n_headings - 1) / 2) / max(1, n_headings)
        poses = np.empty((n, n, n_headings, 3))
        poses[..., 0] = x + width * steps[None, :, None]
        poses[..., 1] = y + width * steps[:, None, None]
        poses[..., 2] = headings
        values_at = self._model(one, values).log_likelihood(_thinned(scan, HEAT_BEAMS), poses.reshape(-1, 3))
        log = np.asarray(values_at).reshape(n, n, n_headings)
        best = np.unravel_index(int(np.argmax(log)), log.shape)
        return {
            "heat": _shades(log.max(axis=2)),
            "places": n,
            "width_m": width,
            "centre": [x, y],
            "best": poses[best].tolist(),
            "best_log": _finite(log[best]),
        }

    def _building(self, request: Request) -> dict[str, Any]:
        """Return how likely the scan is over the whole map."""
        scan, _ = self._scan_of(request)
        one, values = self._set_of(request)
        step = max(BUILDING_STEP, np.sqrt(self.grid.free.sum() * self.grid.resolution**2 / 60_000))
        found = likelihood_map(
            self._model(one, values), _thinned(scan, HEAT_BEAMS), self.grid, resolution=step, headings=BUILDING_HEADINGS
        )
        log = np.where(found.evaluated, found.log_likelihood, -np.inf)
        return {
            "heat": _shades(log),
            "rows": log.shape[0],
            "cols": log.shape[1],
            "step_m": step,
            "origin": found.origin,
            "best": found.best_pose,
        }

    def _density(self, request: Request) -> dict[str, Any]:
        """Return the density of one beam's range at a pose, and what its reading is worth."""
        scan, _ = self._scan_of(request)
        pose = np.array(request.pose())
        one, values = self._set_of(request)
        beam = request.integer("beam", scan.finder.n_beams)
        finder = scan.finder.subset([beam])
        expected = float(self._caster.expected_ranges(pose, finder)[0])
        measured = float(usable_ranges(scan.ranges, scan.finder)[beam])
        answer = {"measured": _finite(measured), "expected": expected, "curves": None}
        if one.kind != "beam":
            return answer
        parameters = _beam_parameters(values)
        ranges = np.linspace(max(finder.min_range, 0.0), finder.max_range, CURVE_POINTS, endpoint=False)
        # The peak of hits is often narrower than the step.
        near = expected + parameters.sigma_hit * np.linspace(-4.0, 4.0, 81)
        ranges = np.unique(np.concatenate([ranges, near[(near >= finder.min_range) & (near < finder.max_range)]]))
        parts = beam_components(ranges, expected, finder.max_range, parameters, min_range=finder.min_range)
        weighted = parts * np.array(parameters.weights)
        return {
            **answer,
            "ranges": ranges,
            "curves": {"hit": weighted[:, 0], "short": weighted[:, 1], "rand": weighted[:, 3]},
            "max_share": parameters.z_max,
            "shares": beam_responsibilities(
                measured, expected, finder.max_range, parameters, min_range=finder.min_range
            ).tolist(),
        }

    def _filter(self, request: Request) -> dict[str, Any]:
        """Return the way of a particle filter from a scan and a pose on, and some of its particles."""
        i = request.integer("i", len(self.log))
        one, values = self._set_of(request)
        if not self.log.has_odometry:
            raise InvalidInputError("filter: the log has no odometry, which moves the particles")
        particles: dict[int, list[Any]] = {}

        def watch(at: int, update: Update) -> None:
            poses = update.belief.poses
            particles[i + at] = poses[:: max(1, len(poses) // DRAWN_PARTICLES)].round(3).tolist()

        localizer = ScanLocalizer(
            self.grid, self._model(one, values), GaussianMotion(**ODOMETRY_NOISE), FilterOptions(n_particles=PARTICLES)
        )
        start = PoseBelief.around(request.pose())
        found = localizer.run(self.log[i:], start, np.random.default_rng(0), watch=watch)
        return {"first": i, "poses": [_with_gaps(pose) for pose in found.poses], "particles": particles}

    def _judge(self, request: Request) -> dict[str, Any]:
        """Return the mean log likelihood of a beam over scans of the whole log, as it is and as the set was."""
        one, values = self._set_of(request)
        return {"now": self._mean(one, values), "before": self._mean(one, one.values), "scans": len(self._judged)}

    def _mean(self, one: ParameterSet, values: Mapping[str, float]) -> float | None:
        if not self._judged:
            return None
        # With exponent 1: how well the values describe the readings does not depend on how much readings count.
        model = self._model(one, {**values, "exponent": 1.0} if one.kind != "stack" else values)
        total = [float(model.log_likelihood(scan, pose)) / max(1, n) for scan, pose, n in self._judged]
        return _finite(float(np.mean(total)))

    @cached_property
    def _judged(self) -> list[tuple[Scan, FloatArray, int]]:
        known = np.flatnonzero(np.isfinite(self.log.poses).all(axis=1))
        chosen = known[np.unique(np.linspace(0, len(known) - 1, JUDGED_SCANS).astype(int))] if len(known) else []
        scans = [(_thinned(self.log[int(i)], HEAT_BEAMS), self.log.poses[i]) for i in chosen]
        return [(scan, pose, int(np.isfinite(usable_ranges(scan.ranges, scan.finder)).sum())) for scan, pose in scans]

    def _file(self, request: Request) -> dict[str, Any]:
        """Return name and content of a file with the values."""
        one, values = self._set_of(request)
        name, text = one.write(values)
        return {"file": name, "text": text}

    def _scan_of(self, request: Request) -> tuple[Scan, int]:
        i = request.integer("i", len(self.log))
        return _thinned(self.log[i], MOST_BEAMS), i

    def _set_of(self, request: Request) -> tuple[ParameterSet, dict[str, float]]:
        one = self.sets[request.integer("set", len(self.sets))]
        return one, one.checked(request.parameters())

    def _model(self, one: ParameterSet, values: Mapping[str, float]) -> Any:
        """Return a model, one of the last few if it is among them: a field has tables of the map's size."""
        key = (one.label, tuple(values.items()))
        if key not in self._models:
            if len(self._models) >= MODELS_KEPT:
                del self._models[next(iter(self._models))]
            self._models[key] = one.make(values)
        self._models[key] = self._models.pop(key)
        return self._models[key]

    @cached_property
    def _caster(self) -> RayCaster:
        return RayCaster(self.grid)


def _beam_parameters(values: Mapping[str, float]) -> BeamParameters:
    return BeamParameters(**{name: value for name, value in values.items() if name != "exponent"})


def _thinned(scan: Scan, n: int) -> Scan:
    if scan.finder.n_beams <= n:
        return scan
    return scan.subset(np.unique(np.round(np.linspace(0, scan.finder.n_beams - 1, n)).astype(np.int64)))


def _shades(log: FloatArray) -> str:
    """Return values as bytes in base64, row 0 first: 255 is the best, 0 is `DEPTH` nats below it and less."""
    best = log.max()
    with np.errstate(invalid="ignore"):
        shade = np.where(np.isfinite(log), 255.0 * (1.0 + (log - best) / DEPTH), 0.0)
    return base64.b64encode(np.clip(shade, 0.0, 255.0).astype(np.uint8).tobytes()).decode()


def _png(picture: Image.Image) -> str:
    out = io.BytesIO()
    picture.save(out, "PNG")
    return base64.b64encode(out.getvalue()).decode()


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _with_gaps(values: FloatArray) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values.tolist()]
