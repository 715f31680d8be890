"""Kill every command that writes, fill its disk, take its rights, run it twice at once; then look at what is there.

Run: python -m tests.faults [--quick] [--only COMMAND] [--seed N]
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from tests.faults.commands import COMMANDS, QUICK, Command, is_complete, make_world
from tests.faults.processes import NOBODY, Run, limit_files, lose_the_rights_of_root

THESIS = b"not ours to touch\n"


@dataclass(frozen=True)
class Expected:
    """What a command does when nothing goes wrong.

    Parameters
    ----------
    code
        Its exit code.
    seconds
        How long it takes.
    files
        What it writes, by name below its folder; None where two runs differ.
    """

    code: int
    seconds: float
    files: dict[str, bytes | None]


class Trial:
    """A command, and a folder that it writes into.

    Parameters
    ----------
    command, expected
        The command.
    world
        Its inputs.
    folder
        Where to write; emptied before each run by `begin`.
    """

    def __init__(self, command: Command, expected: Expected, world: Path, folder: Path) -> None:
        self.command, self.expected, self.world, self.folder = command, expected, world, folder
        self.counts: Counter[str] = Counter()
        self.faults: list[str] = []
        self.old: dict[str, bytes] = {}

    def begin(self, *, with_old: bool) -> None:
        """Empty the folder, or fill it with what an earlier run and the user left."""
        subprocess.run(["rm", "-rf", self.folder], check=True)
        self.folder.mkdir()
        self.old = {name: text.encode() for name, text in self.command.mine.items()}
        if with_old:
            replaced = () if self.command.resumes else self.expected.files
            self.old |= {name: f"old {name}\n".encode() * 50 for name in replaced if name not in self.old}
            self.old["thesis.tex"] = THESIS
        for name, content in self.old.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            path.chmod(0o600)

    def run(self, before: Callable[[], object] = lambda: None) -> Run:
        return Run(self.command.typed(self.folder, self.world), before)

    def scratch(self) -> list[Path]:
        """Return the scratch folders that are there."""
        return [Path(top) / name for top, names, _ in os.walk(self.folder) for name in names if is_scratch(name)]

    def look(self, when: str, *, finished: bool) -> None:
        """Record every file that is neither what it was nor what it should become."""
        for path in self.folder.rglob("*"):
            name = path.relative_to(self.folder).as_posix()
            if path.is_dir() or any(is_scratch(part) for part in path.relative_to(self.folder).parts):
                if path.is_dir() and is_scratch(path.name) and path.stat().st_mode & 0o077:
                    self.faults.append(f"{when}: {name} can be read by others")
                continue
            state = self.state(name, path)
            if state is None or (finished and state == "old" and name in self.expected.files):
                self.faults.append(f"{when}: {name} is {'not new' if state else 'neither old nor new'}")
            if name in self.old and path.stat().st_mode & 0o777 != 0o600:
                self.faults.append(f"{when}: the permissions of {name} changed")
        missing = set(self.old) | (set(self.expected.files) if finished else set())
        self.faults += [f"{when}: {name} is gone" for name in missing if not (self.folder / name).is_file()]

    def state(self, name: str, path: Path) -> str | None:
        """Return whether a file is old, new or a backup; None if it is none of them."""
        content = path.read_bytes()
        if content == self.old.get(name):
            return "old"
        if name in self.expected.files:
            new = self.expected.files[name]
            return "new" if content == new or (new is None and is_complete(path)) else None
        mine, _, backup = name.partition(".bak")
        if mine in self.command.mine and backup.isdigit() | (name.endswith(".bak")):
            whole = content in (self.old[mine], self.expected.files[mine]) and path.stat().st_mode & 0o777 == 0o600
            return "backup" if whole else None
        return None


def is_scratch(name: str) -> bool:
    return name.startswith(".") and name.endswith(".beamfield-part")


# ----------------------------------------------------------------------------------------------------------- the faults


def kill(trial: Trial, rng: random.Random) -> None:
    """Kill at a random moment, or soon after a scratch folder appears; then run again."""
    for _ in range(4 * trial.command.kills):
        if trial.counts["killed"] >= trial.command.kills:
            return
        trial.begin(with_old=rng.random() < 0.6)
        aimed = rng.random() < 0.6
        run = trial.run()
        if aimed:
            while not run.ended() and not trial.scratch():
                time.sleep(0.0002)
            time.sleep(rng.choice((0.0, 0.002, 0.02, 0.3 * trial.expected.seconds)) * rng.random())
        else:
            time.sleep(rng.random() * trial.expected.seconds)
        if run.kill() >= 0:
            run.said()
            trial.counts["ended before"] += 1
            continue
        trial.counts["killed"] += 1
        trial.counts["left scratch"] += bool(trial.scratch())
        run.said()
        trial.look("after a kill", finished=False)
        expect_success(trial, trial.run(), "run again after a kill")


def expect_success(trial: Trial, run: Run, when: str) -> None:
    trial.counts[when] += 1
    code, said = run.wait(), run.said()
    refused = when == "two runs at once" and code == 1 and "has changed since it was read" in said
    if code != trial.expected.code and not refused:
        trial.faults.append(f"{when}: exit code {code}: {said[-300:]}")
    trial.look(when, finished=True)
    trial.faults += [f"{when}: {path.name} is left" for path in trial.scratch()]


def expect_refusal(trial: Trial, run: Run, when: str) -> None:
    """Check for exit code 1, one line that says why, and all as it was (or a step of several done)."""
    trial.counts[when] += 1
    code, lines = run.wait(), run.said().splitlines()
    if code != 1 or len(lines) != 1 or not lines[0].startswith("beamfield: error: "):
        trial.faults.append(f"{when}: exit code {code}, {lines[-3:]}")
    allowed = ("old", "new") if trial.command.in_steps else ("old",)
    files = {path.relative_to(trial.folder).as_posix(): path for path in trial.folder.rglob("*") if path.is_file()}
    changed = [name for name, path in files.items() if trial.state(name, path) not in allowed]
    if changed or set(trial.old) - set(files) or trial.scratch():
        trial.faults.append(f"{when}: changed {changed}, gone {set(trial.old) - set(files)}, left {trial.scratch()}")


def fill_disk(trial: Trial) -> None:
    sizes = [(trial.folder / name).stat().st_size for name in fresh(trial)]
    for share in (0.01, 0.5, 0.999) if trial.expected.seconds < 10 else (0.999,):
        trial.begin(with_old=True)
        expect_refusal(trial, trial.run(limit_files(int(share * max(sizes)))), "disk full (file size limit)")


def fresh(trial: Trial) -> list[str]:
    """Let the command write into an empty folder and return what it wrote."""
    trial.begin(with_old=False)
    expect_success(trial, trial.run(), "an undisturbed run")
    return list(trial.expected.files)


def fill_small_disk(trial: Trial) -> None:
    """The same on a real file system without space, which only root can mount."""
    total = sum((trial.folder / name).stat().st_size for name in fresh(trial))
    for mode in ("size", "read-only"):
        trial.begin(with_old=False)
        mount = ["mount", "-t", "tmpfs", "-o", f"size={total + 65_536},mode=755", "tmpfs", str(trial.folder)]
        if os.geteuid() != 0 or subprocess.run(mount, check=False, capture_output=True).returncode != 0:
            trial.counts["no file system could be mounted"] += 1
            return
        try:
            for name, content in trial.old.items():
                (trial.folder / name).write_bytes(content)
                (trial.folder / name).chmod(0o600)
            if mode == "read-only":
                subprocess.run(["mount", "-o", "remount,ro", str(trial.folder)], check=True)
                expect_refusal(trial, trial.run(), "read-only file system")
            else:
                # Half of what is needed stays free; a page is the least.
                space = os.statvfs(trial.folder)
                trial.old["filler"] = bytes(space.f_bsize * (space.f_bavail - total // 2 // space.f_bsize))
                (trial.folder / "filler").write_bytes(trial.old["filler"])
                expect_refusal(trial, trial.run(), "disk full (small tmpfs)")
        finally:
            subprocess.run(["umount", str(trial.folder)], check=True)


def take_rights(trial: Trial) -> None:
    """Write into a folder of somebody else, whose files may be read."""
    if os.geteuid() != 0:
        trial.counts["not root: a folder of others not tested"] += 1
        return
    trial.begin(with_old=True)
    for path in [trial.folder, *trial.folder.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
        os.chown(path, NOBODY, NOBODY)
    expect_refusal(trial, trial.run(lose_the_rights_of_root), "no permission")


def run_twice(trial: Trial, times: int) -> None:
    for i in range(times):
        trial.begin(with_old=i % 2 == 0)
        first, second = trial.run(), trial.run()
        first.wait()
        second.wait()
        expect_success(trial, first, "two runs at once")
        expect_success(trial, second, "two runs at once")


# ------------------------------------------------------------------------------------------------------------ the table


def expected_of(command: Command, world: Path, folder: Path) -> Expected:
    """Run a command twice undisturbed, and return what both did."""
    results, seconds, codes = [], [], []
    for _ in range(2):
        trial = Trial(command, Expected(0, 0.0, {}), world, folder)
        trial.begin(with_old=False)
        start = time.monotonic()
        run = trial.run()
        codes.append(run.wait())
        seconds.append(time.monotonic() - start)
        said = run.said()
        if codes[-1] not in (0, 3):
            raise RuntimeError(f"{command.name}: exit code {codes[-1]}: {said}")
        names = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        results.append({name: content for name, content in names.items() if ".bak" not in name})
    same = {name: content if results[1].get(name) == content else None for name, content in results[0].items()}
    return Expected(codes[0], min(seconds), same)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few seconds' worth")
    parser.add_argument("--only", choices=[command.name for command in COMMANDS], help="one command")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    total: Counter[str] = Counter()
    faults: list[str] = []
    with tempfile.TemporaryDirectory(prefix="beamfield-kills-") as name:
        base = Path(name)
        base.chmod(0o755)
        make_world(base / "world", logs=not arguments.quick)
        for command in QUICK if arguments.quick else COMMANDS:
            if arguments.only not in (None, command.name):
                continue
            expected = expected_of(command, base / "world", base / "out")
            trial = Trial(command, expected, base / "world", base / "out")
            if arguments.quick:
                trial.command = replace(command, kills=3)
            kill(trial, rng)
            fill_disk(trial)
            fill_small_disk(trial)
            take_rights(trial)
            run_twice(trial, 2 if arguments.quick or expected.seconds > 2 else 6)
            done = ", ".join(f"{what}: {n}" for what, n in sorted(trial.counts.items()))
            print(f"{command.name} ({expected.seconds:.1f} s): {done}; faults: {len(trial.faults)}", flush=True)
            total += trial.counts
            faults += [f"{command.name}: {fault}" for fault in trial.faults]
    print("\n| what | times |\n|---|---|")
    for what, n in sorted(total.items()):
        print(f"| {what} | {n} |")
    print(f"| faults | {len(faults)} |")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
