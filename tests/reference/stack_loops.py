"""The measurement models of other programs as plain loops: one pose, one beam, one cell at a time.

Written from what docs/stacks.md says about the programs. Nothing here is fast, and nothing is shared with the library:
each end point searches all obstacles, each ray walks its own cells. Maps are lists of rows of message values (-1, 0 to
100).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace
from typing import Any

Pose = tuple[float, float, float]
NEVER_RETURNS = "never returns"


@dataclass(frozen=True)
class Input:
    """What a program gets: a map's message, a scan, a sensor on a robot, and parameters by the program's names.

    ROS 1's are under nav2's.
    """

    cells: list[list[int]]
    resolution: float
    origin: Pose
    ranges: list[float]
    bearings: list[float]
    mount: Pose
    range_min: float
    range_max: float
    values: dict[str, Any]

    @property
    def rows(self) -> int:
        return len(self.cells)

    @property
    def cols(self) -> int:
        return len(self.cells[0])

    @property
    def cell(self) -> float:
        """Metres per cell in the message, in single precision."""
        return single(self.resolution)

    def sensor(self, pose: Pose) -> Pose:
        x, y, theta = pose
        mx, my, turn = self.mount
        c, s = math.cos(theta), math.sin(theta)
        return x + c * mx - s * my, y + s * mx + c * my, theta + turn

    def in_grid(self, x: float, y: float, *, yaw: bool, shift: float = 0.0) -> tuple[float, float]:
        """Return coordinates in cells, along the columns and the rows."""
        x0, y0, turn = self.origin
        c, s = (math.cos(turn), math.sin(turn)) if yaw else (1.0, 0.0)
        dx, dy = x - x0, y - y0
        return (c * dx + s * dy) / self.cell + shift, (c * dy - s * dx) / self.cell + shift

    def has(self, col: int, row: int) -> bool:
        return 0 <= col < self.cols and 0 <= row < self.rows

    def nearest(self, col: int, row: int, obstacles: list[tuple[int, int]]) -> int | None:
        """Return the squared distance in cells to the nearest of the obstacles (col, row)."""
        return min(((col - c) ** 2 + (row - r) ** 2 for c, r in obstacles), default=None)


def single(x: float) -> float:
    """Return the nearest number of single precision."""
    return float(struct.unpack("f", struct.pack("f", x))[0])


def occupied_cells(given: Input) -> list[tuple[int, int]]:
    return [(c, r) for r in range(given.rows) for c in range(given.cols) if given.cells[r][c] == 100]


# AMCL: nav2 and ROS 1


def amcl_weights(given: Input, poses: list[Pose], program: str, *, converged: bool = True) -> list[float] | str:
    """Return log-weights by nav2's or ROS 1's amcl, or say that it never returns."""
    v = given.values
    high = min(given.range_max, v["laser_max_range"]) if v["laser_max_range"] > 0.0 else given.range_max
    low = max(given.range_min, v["laser_min_range"]) if v["laser_min_range"] > 0.0 else given.range_min
    readings = [high if z <= low else z for z in given.ranges]
    if v["laser_model_type"] == "likelihood_field":
        return [amcl_field(given, pose, readings, high) for pose in poses]
    if v["laser_model_type"] == "likelihood_field_prob":
        return amcl_field_prob(given, poses, readings, high, skips=v["do_beamskip"] and converged)
    step = (len(readings) - 1) // (v["max_beams"] - 1)
    if step == 0:
        return NEVER_RETURNS
    if program == "ros1":
        readings = [math.inf if z > high else z for z in readings]
    return [amcl_beam(given, pose, readings[::step], given.bearings[::step], high, program) for pose in poses]


def amcl_field(given: Input, pose: Pose, readings: list[float], high: float) -> float:
    step = max(1, (len(readings) - 1) // (given.values["max_beams"] - 1))
    w = 1.0
    for i in range(0, len(readings), step):
        if readings[i] < high:  # which NaN is not
            w += amcl_field_value(given, pose, readings[i], given.bearings[i], high)[0] ** 3
    return math.log(w)


def amcl_field_prob(given: Input, poses: list[Pose], readings: list[float], high: float, *, skips: bool) -> list[float]:
    v = given.values
    places = v["max_beams"]
    step = max(1, math.ceil(len(readings) / places))
    held = []  # for each pose: place -> (p, whether the beam agrees with the map)
    for pose in poses:
        held.append({})
        for place, i in enumerate(range(0, len(readings), step)):
            if readings[i] < high:
                p, d, on_map = amcl_field_value(given, pose, readings[i], given.bearings[i], high)
                held[-1][place] = p, on_map and d < v["beam_skip_distance"]
    if not skips:
        return [sum(math.log(p) for p, _ in beams.values()) for beams in held]
    counts = []
    for place in range(places):
        agreeing = sum(1 for beams in held if place in beams and beams[place][1])
        if agreeing / len(poses) > v["beam_skip_threshold"]:
            counts.append(place)
    if places - len(counts) >= places * v["beam_skip_error_threshold"]:
        counts = list(range(places))
    return [sum(math.log(b[place][0]) if place in b else -math.inf for place in counts) for b in held]


def amcl_field_value(given: Input, pose: Pose, z: float, bearing: float, high: float) -> tuple[float, float, bool]:
    """Return p, the distance behind it, and whether the end point is on the map."""
    v = given.values
    x, y, theta = given.sensor(pose)
    u, w = given.in_grid(x + z * math.cos(theta + bearing), y + z * math.sin(theta + bearing), yaw=False, shift=0.5)
    col, row = math.floor(u), math.floor(w)
    d = limit = v["laser_likelihood_max_dist"]
    on_map = given.has(col, row)
    if on_map:
        squared = given.nearest(col, row, occupied_cells(given))
        if squared is not None and math.sqrt(squared) <= int(limit / given.cell):
            d = math.sqrt(squared) * given.cell
    return v["z_hit"] * math.exp(-(d**2) / (2.0 * v["sigma_hit"] ** 2)) + v["z_rand"] / high, d, on_map


def amcl_beam(
    given: Input, pose: Pose, readings: list[float], bearings: list[float], high: float, program: str
) -> float:
    v = given.values
    x, y, theta = given.sensor(pose)
    w = 1.0
    for z, bearing in zip(readings, bearings, strict=True):
        if math.isnan(z):
            if program == "ros1":
                return -math.inf  # NaN, which the filter treats as no weight at all
            continue
        along = theta + bearing
        first = [math.floor(t) for t in given.in_grid(x, y, yaw=False, shift=0.5)]
        end = given.in_grid(x + high * math.cos(along), y + high * math.sin(along), yaw=False, shift=0.5)
        last = [math.floor(t) for t in end]
        expected = high
        # One cell more than there are up to the last one.
        for col, row in line(first, last, longer=1, ties_turn=True):
            if not given.has(col, row) or given.cells[row][col] != 0:
                expected = math.hypot(col - first[0], row - first[1]) * given.cell
                break
        p = v["z_hit"] * math.exp(-((z - expected) ** 2) / (2.0 * v["sigma_hit"] ** 2))
        if z < expected:
            p += v["z_short"] * v["lambda_short"] * math.exp(-v["lambda_short"] * z)
        if z == high:
            p += v["z_max"]
        if z < high:
            p += v["z_rand"] / high
        w += p**3
    return math.log(w)


def line(first: list[int], last: list[int], *, longer: int, ties_turn: bool) -> list[tuple[int, int]]:
    """Return the cells (col, row) of the straight line from cell to cell: of each column (or row) the nearest one."""
    across, up = last[0] - first[0], last[1] - first[1]
    long, short = max(abs(across), abs(up)), min(abs(across), abs(up))
    cells = []
    for t in range(long + 1 + longer):
        twice = 2 * t * short
        # t short / long, rounded; midway to the next cell or not.
        aside = (twice + long) // (2 * long) if ties_turn else -((long - twice) // (2 * long))
        a, b = (t, aside) if abs(across) >= abs(up) else (aside, t)
        cells.append((first[0] + (a if across > 0 else -a), first[1] + (b if up > 0 else -b)))
    return cells


# Beluga


def beluga_weights(given: Input, poses: list[Pose]) -> list[float]:
    """Return log-weights by Beluga's AMCL; -inf where the weight is 0."""
    v = given.values
    low, high = max(given.range_min, v["laser_min_range"]), min(given.range_max, v["laser_max_range"])
    n, count = len(given.ranges), v["max_beams"]
    chosen = (
        list(range(n)) if count >= n else [0] if count == 1 else [-(-i * (n - 1) // (count - 1)) for i in range(count)]
    )
    points = []
    for i in chosen:
        if low <= given.ranges[i] <= high:
            x, y, along = given.mount[0], given.mount[1], given.mount[2] + given.bearings[i]
            points.append((x + given.ranges[i] * math.cos(along), y + given.ranges[i] * math.sin(along)))
    result = []
    for pose in poses:
        if v["laser_model_type"] == "beam":
            total = sum(beluga_beam_value(given, pose, point) ** 3 for point in points)
            result.append(math.log(total) if total > 0.0 else -math.inf)
        else:
            values = [beluga_field_value(given, pose, point) for point in points]
            prob = v["laser_model_type"] == "likelihood_field_prob"
            result.append(sum(map(math.log, values)) if prob else math.log(1.0 + sum(p**3 for p in values)))
    return result


def beluga_field_value(given: Input, pose: Pose, point: tuple[float, float]) -> float:
    v = given.values
    c, s = math.cos(pose[2]), math.sin(pose[2])
    u, w = given.in_grid(pose[0] + c * point[0] - s * point[1], pose[1] + s * point[0] + c * point[1], yaw=True)
    col, row = math.floor(u), math.floor(w)
    if not given.has(col, row):
        return 1.0 / v["laser_max_range"]

    def value(d: float) -> float:
        peak = v["z_hit"] / (v["sigma_hit"] * math.sqrt(2.0 * math.pi))
        return peak * math.exp(-(d**2) / (2.0 * v["sigma_hit"] ** 2)) + v["z_rand"] / v["laser_max_range"]

    obstacles, unknown = occupied_cells(given), given.cells[row][col] == -1
    options = v["laser_model_type"] == "likelihood_field"
    if options and v["only_obstacle_boundaries"]:
        obstacles = [cell for cell in obstacles if beside_free(given, *cell)]
        unknown = unknown or (given.cells[row][col] == 100 and (col, row) not in obstacles)
    limit = v["laser_likelihood_max_dist"]
    if options and v["model_unknown_space"] and unknown:
        # At the distance that is worth this, or at the longest.
        return max(1.0 / v["laser_max_range"], value(limit))
    squared = given.nearest(col, row, obstacles)
    return value(limit if squared is None else min(limit, math.sqrt(squared) * given.cell))


def beside_free(given: Input, col: int, row: int) -> bool:
    around = ((col - 1, row), (col + 1, row), (col, row - 1), (col, row + 1))
    return any(given.has(c, r) and given.cells[r][c] == 0 for c, r in around)


def beluga_beam_value(given: Input, pose: Pose, point: tuple[float, float]) -> float:
    v = given.values
    high, sigma, rate = v["laser_max_range"], v["sigma_hit"], v["lambda_short"]
    z, along = math.hypot(*point), pose[2] + math.atan2(point[1], point[0])
    first = [math.floor(t) for t in given.in_grid(pose[0], pose[1], yaw=True)]
    end = given.in_grid(pose[0] + high * math.cos(along), pose[1] + high * math.sin(along), yaw=True)
    expected = high
    for col, row in line(first, [math.floor(t) for t in end], longer=0, ties_turn=False):
        if not given.has(col, row):
            break
        if given.cells[row][col] != 0:
            expected = min(high, math.hypot(col - first[0], row - first[1]) * given.cell)
            break

    def below(x: float) -> float:
        return 0.5 * (1.0 + math.erf((x - expected) / (sigma * math.sqrt(2.0))))

    normal = math.exp(-((z - expected) ** 2) / (2.0 * sigma**2)) / (sigma * math.sqrt(2.0 * math.pi))
    p = v["z_hit"] * normal / (below(high) - below(0.0))
    if z < expected and rate > 0.0:
        p += v["z_short"] * rate * math.exp(-rate * z) / (1.0 - math.exp(-rate * expected))
    return p + (v["z_max"] if z >= high else v["z_rand"] / high)


# MRPT


def at_whole_cells(given: Input) -> Input:
    """Return the input with the map's origin a whole number of cells from the map frame's."""
    x, y, turn = given.origin
    return replace(given, origin=(round(x / given.cell) * given.cell, round(y / given.cell) * given.cell, turn))


def mrpt_field_weights(given: Input, poses: list[Pose]) -> list[float]:
    """Return log-weights by MRPT's LF_Thrun."""
    given = at_whole_cells(given)
    v = given.values
    points: list[tuple[float, float]] = []
    before = True
    for z, bearing in zip(given.ranges, given.bearings, strict=True):
        valid = given.range_min <= z < given.range_max
        if valid and before:
            along = given.mount[2] + bearing
            x, y = given.mount[0] + z * math.cos(along), given.mount[1] + z * math.sin(along)
            if not points or math.hypot(x - points[-1][0], y - points[-1][1]) >= given.cell / 2.0:
                points.append((x, y))
        before = valid
    if len(points) >= 10:
        points = points[:: v["LF_decimation"]]
    weights = []
    for pose in poses:
        values = [mrpt_field_value(given, pose, point) for point in points]
        if not values:
            weights.append(0.0)
        elif v["LF_alternateAverageMethod"]:
            weights.append(math.log(sum(values) / len(values)))
        else:
            weights.append(sum(map(math.log, values)))
    return weights


def mrpt_field_value(given: Input, pose: Pose, point: tuple[float, float]) -> float:
    v = given.values
    c, s = math.cos(pose[2]), math.sin(pose[2])
    u, w = given.in_grid(pose[0] + c * point[0] - s * point[1], pose[1] + s * point[0] + c * point[1], yaw=False)
    col, row = int(u), int(w)  # towards 0
    squared = v["LF_maxCorrsDistance"] ** 2
    if 0 <= col < given.cols - 1 and 0 <= row < given.rows - 1:
        nearest = given.nearest(col, row, occupied_cells(given))
        if nearest is not None:
            squared = min(squared, nearest * given.cell**2)
        if v["LF_useSquareDist"]:
            squared *= squared
    return v["LF_zHit"] * math.exp(-0.5 * squared / v["LF_stdHit"] ** 2) + v["LF_zRandom"] / v["LF_maxRange"]


def mrpt_ray_weights(given: Input, poses: list[Pose]) -> list[float]:
    """Return log-weights by MRPT's rayTracing."""
    given = at_whole_cells(given)
    v = given.values
    weights = []
    for pose in poses:
        x, y, theta = given.sensor(pose)
        log_w = 1.0
        for i in range(0, len(given.ranges), v["rayTracing_decimation"]):
            z = given.ranges[i]
            if not given.range_min <= z < given.range_max:
                continue
            error = abs(z - marched_range(given, x, y, theta + given.bearings[i]))
            if v["rayTracing_useDistanceFilter"]:
                error = min(error, 2.0)
            log_w += math.log(0.1 / given.range_max + 0.9 * math.exp(-0.5 * (error / v["rayTracing_stdHit"]) ** 2))
        weights.append(log_w)
    return weights


def marched_range(given: Input, x: float, y: float, along: float) -> float:
    u, w = given.in_grid(x, y, yaw=False)
    at_u, at_w = int(u * 1024), int(w * 1024)
    step_u, step_w = int(0.8 * math.cos(along) * 1024), int(0.8 * math.sin(along) * 1024)
    most = round(given.range_max / given.cell)
    for taken in range(most + 1):
        col, row = at_u // 1024, at_w // 1024
        if not given.has(col, row) or given.cells[row][col] not in (0, 100):
            return given.range_max
        if given.cells[row][col] == 100:
            return taken * 0.8 * given.cell
        at_u, at_w = at_u + step_u, at_w + step_w
    return most * 0.8 * given.cell


# F1TENTH


def f1tenth_weights(given: Input, poses: list[Pose]) -> list[float]:
    """Return log-weights by F1TENTH's table, on exact ranges."""
    v = given.values
    high = v["max_range"]
    n = int(high / given.cell)
    columns: dict[int, list[float]] = {}
    weights = []
    for pose in poses:
        total = 0.0
        for i in range(0, len(given.ranges), v["angle_step"]):
            z = given.ranges[i]
            if math.isnan(z):
                continue
            expected = exact_range(given, *given.sensor(pose), given.bearings[i], high)
            r = min(n, int(single(single(max(0.0, min(z, high))) / given.cell)))
            d = min(n, int(single(single(expected) / given.cell)))
            if d not in columns:
                columns[d] = f1tenth_column(v, d, n)
            total += math.log(columns[d][r])
        weights.append(total / v["squash_factor"])
    return weights


def f1tenth_column(v: dict[str, Any], d: int, n: int) -> list[float]:
    column = []
    for r in range(n + 1):
        p = v["z_hit"] * math.exp(-0.5 * ((r - d) / v["sigma_hit"]) ** 2) / (v["sigma_hit"] * math.sqrt(2.0 * math.pi))
        if r < d:
            p += 2.0 * v["z_short"] * (d - r) / d
        p += v["z_max"] if r == n else v["z_rand"] / n
        column.append(p)
    total = sum(column)
    return [p / total for p in column]


def exact_range(given: Input, x: float, y: float, theta: float, bearing: float, high: float) -> float:
    """Return the distance at which a ray enters the first occupied cell; that off the map nothing is met."""
    u, w = given.in_grid(x, y, yaw=True)
    if not given.has(math.floor(u), math.floor(w)):
        return high
    along = theta + bearing - given.origin[2]
    nearest = high
    for col, row in occupied_cells(given):
        near, far = 0.0, math.inf
        for at, direction, corner in ((u, math.cos(along), col), (w, math.sin(along), row)):
            one, other = sorted(((corner - at) / direction, (corner + 1 - at) / direction))
            near, far = max(near, one), min(far, other)
        if near <= far:
            nearest = min(nearest, near * given.cell)
    return nearest
