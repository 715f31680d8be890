"""Measure how a fleet's work scales: ``python benchmarks/fleet.py [--workers 1 2] [--beams 6 7] [--tasks 10000]``.

Workers: scan simulated raw logs, and learn from the catalogue, with so many processes. Beams: learn from 10^6, 10^7 ...
simulated beams in a process of its own, for cost per beam and peak memory. Tasks: what a task costs the scheduler. All
of them print Markdown. Other programs on the machine make the times longer, and speed-ups smaller.
"""

from __future__ import annotations

import argparse
import datetime
import multiprocessing
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from beamfield.fleet.beam_schema import beam_schema, require_pyarrow
from beamfield.fleet.catalogue import Catalogue, create_catalogue, open_catalogue
from beamfield.fleet.engine import Engine
from beamfield.fleet.learning import learn
from beamfield.fleet.manifest import read_manifest
from beamfield.fleet.run_record import MapInfo, RunRecord, ShardFile
from beamfield.fleet.scan import scan_fleet
from beamfield.fleet.simulated import FleetSize, plan_fleet
from beamfield.fleet.simulated_files import write_fleet
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from tables import print_table

TRUTH = BeamParameters(0.86, 0.06, 0.03, 0.05, 0.02, 0.5, 0.01)
MAX_RANGE, BEAMS, SHARD_ROWS = 12.0, 500, 1_000_000
LOGS = FleetSize(robots=8, sites=2, days=2, duration=60.0, width=26.0, height=20.0)


def beams_of_shard(rng: np.random.Generator, rows: int, start: float) -> dict[str, np.ndarray]:
    """Return columns of beams drawn from known parameters, ten scans a second."""
    scan, beam = np.divmod(np.arange(rows), BEAMS)
    expected = rng.uniform(0.3, 11.0, rows)
    nothing = np.zeros(rows)
    return {
        "stamp": start + 0.1 * scan, "scan": scan, "beam": beam,
        "bearing": (beam + 0.5) * (2.0 * np.pi / BEAMS) - np.pi,
        "range": sample_beams(expected, MAX_RANGE, TRUTH, rng), "expected_range": expected, "incidence": nothing,
        "hit_row": nothing, "hit_col": nothing, "x": nothing, "y": nothing, "heading": nothing, "var_x": nothing,
        "var_y": nothing, "var_heading": nothing, "cov_xy": nothing, "held_out": scan // 200 % 4 == 3,
    }  # fmt: skip


def simulated_catalogue(folder: Path, n_beams: int) -> Catalogue:
    """Write a catalogue of simulated beams, in shards of a million; each tenth shard is drawn, the others repeat it."""
    pa, catalogue = require_pyarrow(), create_catalogue(str(folder))
    (folder / "runs").mkdir()
    written: dict[int, Path] = {}
    for number in range(-(-n_beams // SHARD_ROWS)):
        day = datetime.date(2026, 3, 2) + datetime.timedelta(days=number // 20)
        robot, run = f"robot-{number % 20:02d}", f"run-{number:05d}"
        name = f"beams/site=hall/robot={robot}/day={day}/{run}.parquet"
        path = folder / name
        path.parent.mkdir(parents=True)
        rows = min(SHARD_ROWS, n_beams)
        start = datetime.datetime.combine(day, datetime.time(8), datetime.UTC).timestamp()
        if number % 10 in written:
            path.hardlink_to(written[number % 10])
        else:
            columns = beams_of_shard(np.random.default_rng(number), rows, start)
            schema = beam_schema()
            names = pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), [run])
            arrays = [names if f.name == "run" else pa.array(columns[f.name]).cast(f.type) for f in schema]
            pa.parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), path, compression="zstd")
            written[number % 10] = path
        record = RunRecord(
            run=run, robot=robot, site="hall", key=run, log="", map="", poses="", log_sensor="", log_hash="",
            status="used", first_stamp=start, last_stamp=start + 0.1 * rows / BEAMS, scans=rows // BEAMS, beams=rows,
            files=(ShardFile(name, day.isoformat(), rows, path.stat().st_size),),
            sensor={"mounts": [[0.0, 0.0, 0.0]] * BEAMS, "max_range": MAX_RANGE, "min_range": 0.0,
                    "opening_angle": 0.0, "name": ""},
            map_info=MapInfo(0.05, (0.0, 0.0, 0.0), (1, 1), "0" * 64),
        )  # fmt: skip
        (folder / f"runs/{run}.json").write_bytes(record.to_json())
    return catalogue


def measured_learning(folder: str, few: str, answer: multiprocessing.Queue) -> None:
    """Learn in this process, and say what it took; the first learning, from few beams, loads the kernels."""
    catalogue = open_catalogue(folder)
    with Engine("serial") as engine:
        learn(open_catalogue(few), engine)
        start, used = time.perf_counter(), time.process_time()
        fit = learn(catalogue, engine).fits[0]
        answer.put({
            "passes": fit.passes, "seconds": time.perf_counter() - start, "processor": time.process_time() - used,
            "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "z_hit": fit.parameters.z_hit,
        })  # fmt: skip


def beams_table(powers: list[int]) -> None:
    rows = []
    # Once with few beams at first, to compile the kernels: that takes memory, too.
    for number, power in enumerate([5, *powers]):
        with tempfile.TemporaryDirectory() as scratch:
            folder, few = Path(scratch) / "catalogue", Path(scratch) / "few"
            catalogue = simulated_catalogue(folder, 10**power)
            simulated_catalogue(few, 10**5)
            context = multiprocessing.get_context("spawn")
            answer = context.Queue()
            process = context.Process(target=measured_learning, args=(str(folder), str(few), answer))
            process.start()
            found = answer.get()
            process.join()
            size = catalogue.used[0].files[0].size / catalogue.used[0].beams
        if number == 0:
            continue
        per_beam = 1e9 * found["processor"] / 10**power
        rows.append({
            "beams": f"10^{power}", "passes": found["passes"], "processor time [s]": f"{found['processor']:.1f}",
            "per beam [ns]": f"{per_beam:.0f}", "per beam and pass [ns]": f"{per_beam / found['passes']:.0f}",
            "peak memory [MiB]": f"{found['memory']:.0f}", "bytes per beam on disk": f"{size:.1f}",
            "z_hit (true 0.86)": f"{found['z_hit']:.4f}",
        })  # fmt: skip
    print_table(rows)


def workers_table(workers: list[int]) -> None:
    rows, first = [], {}
    with tempfile.TemporaryDirectory() as scratch:
        logs = Path(scratch) / "logs"
        logs.mkdir()
        with Engine("serial") as engine:
            write_fleet(logs, plan_fleet(LOGS), engine)
        many = simulated_catalogue(Path(scratch) / "many", 2 * 10**7)
        for n in workers:
            with Engine("processes", n) as engine:
                # Every worker compiles or loads kernels once.
                scan_fleet(read_manifest(logs / "manifest.yaml")[: 2 * n], f"{scratch}/warm-{n}", engine)
                learn(many, engine, thin=50)
                start = time.perf_counter()
                scanned = scan_fleet(logs / "manifest.yaml", f"{scratch}/catalogue-{n}", engine)
                seconds = {"scan": time.perf_counter() - start}
                start = time.perf_counter()
                learn(many, engine)
                seconds["learn"] = time.perf_counter() - start
            row = {"workers": n}
            for name, took in seconds.items():
                first.setdefault(name, (n, took))
                speed_up = first[name][1] / took
                row |= {f"{name} [s]": f"{took:.1f}", f"{name}: speed-up": f"{speed_up:.2f}",
                        f"{name}: efficiency": f"{speed_up * first[name][0] / n:.0%}"}  # fmt: skip
            rows.append(row)
        used = sum(record.is_used for record in scanned.records)
    print(f"scan: {used} logs of {LOGS.duration:g} s with {LOGS.beams} beams, {LOGS.scan_rate:g} Hz; learn: 2e7 beams")
    print_table(rows)


def small_task(number: int) -> np.ndarray:
    """Return sums as large as those of a shard."""
    return np.full(100, float(number))


def tasks_table(n_tasks: int, workers: list[int]) -> None:
    rows = []
    for n in workers:
        with Engine("processes", n) as engine:
            engine.map(small_task, range(100))
            start = time.perf_counter()
            engine.map(small_task, range(n_tasks))
            mapped = time.perf_counter() - start
            start = time.perf_counter()
            total = engine.reduce(small_task, range(n_tasks), np.add)
            reduced = time.perf_counter() - start
        assert total[0] == n_tasks * (n_tasks - 1) / 2
        rows.append({
            "workers": n, "tasks": n_tasks,
            "map [s]": f"{mapped:.1f}", "map, per task [ms]": f"{1e3 * mapped / n_tasks:.2f}",
            "reduce [s]": f"{reduced:.1f}", "reduce, per task [ms]": f"{1e3 * reduced / n_tasks:.2f}",
        })  # fmt: skip
    print_table(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--beams", type=int, nargs="*", default=[6, 7], metavar="POWER")
    parser.add_argument("--tasks", type=int, default=10_000)
    chosen = parser.parse_args()
    if chosen.beams:
        beams_table(chosen.beams)
    if chosen.workers and chosen.tasks:
        tasks_table(chosen.tasks, chosen.workers)
    if chosen.workers:
        workers_table(chosen.workers)
