"""Every command that writes, on a small world of its own."""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image
from ruamel.yaml import YAML

from beamfield.cli.main import main
from beamfield.detection_log import DetectionLog
from beamfield.detections import Detections
from beamfield.io.landmarks.landmark_files import write_landmarks
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from tests.sightings_file import write_sightings

NAV2 = """\
amcl:
  ros__parameters:
    # tuned on a Friday
    z_hit: 0.5
    z_rand: 0.5
    sigma_hit: 0.6   # wide
    laser_model_type: "likelihood_field"
    max_beams: 60
"""
BELUGA = """\
amcl:
  ros__parameters:
    laser_model_type: likelihood_field
    z_hit: 0.9
    z_rand: 0.1
    sigma_hit: 0.2
"""


@dataclass(frozen=True)
class Command:
    """A command that writes into a folder.

    Parameters
    ----------
    name
        For the table.
    words
        What is typed; {out} is the folder, {world} the inputs.
    kills
        How often it is killed.
    mine
        Files in the folder that the user had before, by name; the command changes them.
    in_steps
        Whether it is several steps: what the first wrote stays if the next one fails.
    resumes
        Whether it goes on with what an earlier run wrote, in a folder of its own.
    """

    name: str
    words: str
    kills: int
    mine: Mapping[str, str] = field(default_factory=dict)
    in_steps: bool = False
    resumes: bool = False

    def typed(self, out: Path, world: Path) -> list[str]:
        return [word.format(out=out, world=world) for word in self.words.split()]


_LOG = "{world}/log.carmen --map {world}/map.yaml --quiet"
_FLEET = "--robots 2 --sites 1 --days 1 --duration 25 --scan-rate 3 --beams 45 --width 26 --height 20"
COMMANDS = (
    Command("translate --out", "translate {world}/nav2.yaml --to beluga --out {out}/beluga.yaml", 36),
    Command("translate --patch", "translate {world}/beluga.yaml --to nav2 --patch {out}/nav2.yaml", 36,
            {"nav2.yaml": NAV2}),
    Command("inspect --out", "inspect {world}/log.carmen --out {out}/log.png --quiet", 20),
    Command("map", "map {world}/log.carmen --out {out}/drawn.yaml --quiet", 30),
    Command("precompute", "precompute {world}/map.yaml --out {out}/map.ranges --quiet", 20),
    Command("simulate", "simulate --out {out}/world --seed 4 --duration 60 --beams 31 --format both --quiet", 26),
    Command("likelihood", f"likelihood {_LOG} --scan 3 --resolution 1 --out {{out}}/l.png --npz {{out}}/l.npz", 12),
    Command("calibrate-landmarks", "calibrate-landmarks {world}/seen.csv --landmarks {world}/tags.csv --replicates 20 "
            "--out {out}/landmarks.yaml --quiet", 18),
    Command("figures", "figures --only 6.3 6.4 --out {out}/figures --quiet", 8),
    Command("check", f"check {_LOG} --out {{out}}/check", 5),
    Command("trajectory", "trajectory {world}/log.carmen --map {world}/map.yaml --out {out}/way.tum --quiet", 6),
    Command("localize", f"localize {_LOG} --out {{out}}/l --rerun {{out}}/l.rrd --mcap {{out}}/l.mcap", 5),
    Command("evaluate", f"evaluate {_LOG} --params {{world}}/nav2.yaml --seeds 2 --out {{out}}/e", 4),
    Command("calibrate", f"calibrate {_LOG} --no-refine --out {{out}}/c", 4),
    Command("calibrate --stack --patch", f"calibrate {_LOG} --no-refine --out {{out}}/c --stack nav2 "
            "--patch {out}/nav2.yaml", 3, {"nav2.yaml": NAV2}),
    Command("fleet simulate", f"fleet simulate --out {{out}}/fleet {_FLEET} --workers 1 --quiet", 5),
    Command("fleet report", "fleet report {world}/catalogue --out {out}/report --scheduler serial --quiet", 3),
    Command("fleet scan", "fleet scan {world}/fleet.csv --out {out}/catalogue --scheduler serial --quiet", 12,
            in_steps=True, resumes=True),
    Command("demo", "demo --out {out}/demo --duration 90 --quiet", 2, in_steps=True),
)  # fmt: skip
QUICK = COMMANDS[:2]


def make_world(folder: Path, *, logs: bool) -> None:
    """Write what the commands read; those of QUICK need no logs."""
    folder.mkdir()
    (folder / "nav2.yaml").write_text(NAV2)
    (folder / "beluga.yaml").write_text(BELUGA)
    if not logs:
        return
    words = ["simulate", "--out", str(folder), "--seed", "4", "--duration", "90", "--scan-rate", "3"]
    if main([*words, "--beams", "31", "--quiet"]) != 0:
        raise RuntimeError("the world could not be simulated")
    (folder / "fleet.csv").write_text("log,map,robot,site\nlog.carmen,map.yaml,ann,hall\n")
    words = ["fleet", "scan", str(folder / "fleet.csv"), "--out", str(folder / "catalogue"), "--scheduler", "serial"]
    if main([*words, "--quiet"]) != 0:
        raise RuntimeError("the world could not be scanned")
    rng = np.random.default_rng(4)
    landmarks = LandmarkMap([[0.0, 0.0], [9.0, 1.0], [4.0, 7.0]], ids=[4, 9, 2])
    model = LandmarkModel(landmarks, LandmarkParameters(0.1, 0.02), correspondence="known")
    poses = rng.uniform([1.0, 1.0, -3.0], [8.0, 6.0, 3.0], (200, 3))
    seen = [Detections(z.ranges, z.bearings, ids=z.ids, stamp=float(i)) for i, z in enumerate(model.sample(poses, rng))]
    write_landmarks(folder / "tags.csv", landmarks)
    write_sightings(folder / "seen.csv", DetectionLog(poses, seen))


def is_complete(path: Path) -> bool:
    """Return whether a file is whole, for those that differ from run to run."""
    content = path.read_bytes()
    try:
        if path.suffix == ".json":
            json.loads(content)
        elif path.suffix == ".yaml":
            YAML(typ="safe").load(content.decode())
        elif path.suffix == ".png":
            with Image.open(path) as picture:
                picture.load()
            return content.endswith(b"IEND\xaeB`\x82")
        elif path.suffix == ".npz":
            with np.load(path) as arrays:
                return all(arrays[name] is not None for name in arrays.files)
        elif path.suffix == ".gz":
            return gzip.decompress(content).endswith(b"\n")
    except Exception:
        return False
    endings = {
        ".html": b"</html>\n", ".svg": b"</svg>\n", ".mcap": b"\x89MCAP0\r\n", ".rrd": b"RRF2FOOT\x01\0\0\0",
    }  # fmt: skip
    return content.endswith(endings.get(path.suffix, b"\n"))
