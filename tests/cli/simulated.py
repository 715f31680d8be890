"""The worlds that commands are tested in."""

from __future__ import annotations

from pathlib import Path

from beamfield.cli.main import main


def simulated(folder: Path, options: str) -> Path:
    """Simulate a log and its map into the folder, of seed 4 if the options of the command name no other."""
    code = main(["simulate", "--out", str(folder), "--seed", "4", "--quiet", *options.split()])
    assert code == 0
    return folder


def on_map(command: str, world: Path, log: str, out: Path, *more: str) -> int:
    """Run a command on a log of the world and its map, and return the exit code."""
    return main([command, str(world / log), "--map", str(world / "map.yaml"), "--out", str(out), *more])
