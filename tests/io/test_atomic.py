"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from beamfield.errors import InvalidInputError
from beamfield.io.files.atomic import (
    atomic_file,
    atomic_files,
    atomic_folder,
    check_folder_writable,
    check_writable,
    kept_files,
    write_file,
)


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


class Interrupt(Exception):
    pass


def test_a_file_appears_with_its_content_and_nothing_is_left_beside_it(tmp_path):
    with atomic_file(tmp_path / "a.txt") as part:
        part.write_text("new")
        assert not (tmp_path / "a.txt").exists()
    assert (tmp_path / "a.txt").read_text() == "new"
    assert names(tmp_path) == ["a.txt"]


def test_the_temporary_name_keeps_the_suffix_because_writers_choose_the_format_by_it(tmp_path):
    with atomic_file(tmp_path / "picture.png") as part:
        assert part.suffix == ".png"
        assert part.parent.parent == tmp_path
        part.write_bytes(b"x")


@pytest.mark.parametrize("error", [Interrupt, KeyboardInterrupt])
def test_an_error_leaves_the_old_file_as_it_was(tmp_path, error):
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write() -> None:
        with atomic_file(target) as part:
            part.write_text("half")
            raise error

    with pytest.raises(error):
        write()
    assert target.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


KILLED = (
    "import os, signal, sys\n"
    "from beamfield.io.files.atomic import atomic_file\n"
    "with atomic_file(sys.argv[1]) as part:\n"
    "    part.write_text('half')\n"
    "    os.kill(os.getpid(), signal.SIGKILL)\n"
)


def kill_a_writer_of(target: Path) -> Path:
    """Return the scratch folder that it leaves."""
    done = subprocess.run([sys.executable, "-c", KILLED, str(target)], check=False)
    assert done.returncode == -signal.SIGKILL
    (left,) = target.parent.glob(".*.beamfield-part")
    return left


def test_a_killed_writer_leaves_the_old_file_as_it_was_and_nothing_that_others_can_read(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    target.chmod(0o600)
    left = kill_a_writer_of(target)
    assert target.read_text() == "old"
    assert (left / "a.txt").read_text() == "half"
    assert left.stat().st_mode & 0o777 == 0o700


def test_the_next_run_removes_what_a_killed_one_left_for_the_same_target(tmp_path):
    left = kill_a_writer_of(tmp_path / "a.txt")
    write_file(tmp_path / "b.txt", "another target")
    assert left.is_dir()
    write_file(tmp_path / "a.txt", "new")
    assert names(tmp_path) == ["a.txt", "b.txt"]


def test_a_run_leaves_what_a_living_one_is_writing(tmp_path):
    with atomic_file(tmp_path / "a.txt") as part:
        part.write_text("first")
        write_file(tmp_path / "a.txt", "second")
        assert part.read_text() == "first"
    assert (tmp_path / "a.txt").read_text() == "first"
    assert names(tmp_path) == ["a.txt"]


def test_a_run_leaves_what_it_cannot_be_sure_of(tmp_path, monkeypatch):
    left = kill_a_writer_of(tmp_path / "a.txt")
    monkeypatch.setattr("beamfield.io.files.atomic._scratch_suffix", lambda: ".another.beamfield-part")
    write_file(tmp_path / "a.txt", "new")
    assert names(tmp_path) == [left.name, "a.txt"]
    monkeypatch.undo()

    def no_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", no_locks)
    write_file(tmp_path / "a.txt", "newer")
    assert (tmp_path / "a.txt").read_text() == "newer"
    assert names(tmp_path) == [left.name, "a.txt"]


def test_what_only_looks_like_a_scratch_folder_stays(tmp_path):
    with atomic_file(tmp_path / "a.txt") as part:
        name = part.parent.name
        part.write_text("x")
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "kept").write_text("x")
    (tmp_path / name).symlink_to("else", target_is_directory=True)
    (tmp_path / name.replace("a.txt.", "a.txt.0")).write_text("a file")
    write_file(tmp_path / "a.txt", "new")
    assert len(names(tmp_path)) == 4
    assert names(tmp_path / "else") == ["kept"]


def test_a_scratch_folder_that_another_run_took_for_abandoned_is_given_up(tmp_path, monkeypatch):
    flock, seen = fcntl.flock, []

    def lose_the_first(handle: int, flags: int) -> None:
        seen.append(handle)
        if len(seen) == 1:
            raise BlockingIOError
        flock(handle, flags)

    monkeypatch.setattr("fcntl.flock", lose_the_first)
    write_file(tmp_path / "a.txt", "new")
    assert len(seen) == 2
    assert (tmp_path / "a.txt").read_text() == "new"


def test_new_files_honour_the_umask_and_old_files_keep_their_permissions(tmp_path):
    old = tmp_path / "old.txt"
    old.write_text("old")
    old.chmod(0o640)
    before = os.umask(0o027)
    try:
        write_file(tmp_path / "new.txt", "new")
        write_file(old, "changed")
    finally:
        os.umask(before)
    assert (tmp_path / "new.txt").stat().st_mode & 0o777 == 0o640
    assert old.stat().st_mode & 0o777 == 0o640
    old.chmod(0o604)
    write_file(old, "again")
    assert old.stat().st_mode & 0o777 == 0o604


@pytest.mark.skipif(os.getuid() != 0, reason="only root may give files away")
def test_root_leaves_files_to_their_owner(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    os.chown(tmp_path / "a.txt", 12345, 54321)
    write_file(tmp_path / "a.txt", "new")
    status = (tmp_path / "a.txt").stat()
    assert (status.st_uid, status.st_gid) == (12345, 54321)


def test_a_link_stays_a_link_and_its_target_is_replaced(tmp_path):
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to("real.txt")
    write_file(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"


def test_text_is_written_as_utf8_and_bytes_as_they_are(tmp_path):
    write_file(tmp_path / "a", "Å\n")
    write_file(tmp_path / "b", b"\xff\r\n")
    assert (tmp_path / "a").read_bytes() == b"\xc3\x85\n"
    assert (tmp_path / "b").read_bytes() == b"\xff\r\n"


def test_a_block_that_writes_nothing_is_an_error(tmp_path):
    with pytest.raises(InvalidInputError, match=r"a\.txt: nothing was written"), atomic_file(tmp_path / "a.txt"):
        pass
    assert names(tmp_path) == []


def test_a_folder_or_a_device_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(IsADirectoryError):
        write_file(tmp_path, "x")
    with pytest.raises(InvalidInputError, match="regular file"):
        write_file(os.devnull, "x")
    check_writable(tmp_path / "none" / "a.txt")
    check_writable(tmp_path / "a.txt")
    assert names(tmp_path) == []


def test_missing_folders_are_made_and_removed_again_on_an_error(tmp_path):
    write_file(tmp_path / "new" / "folder" / "a.txt", "x")
    assert (tmp_path / "new" / "folder" / "a.txt").read_text() == "x"
    with pytest.raises(RuntimeError), atomic_file(tmp_path / "other" / "folder" / "a.txt"):
        raise RuntimeError
    assert names(tmp_path) == ["new"]


def test_a_folder_that_cannot_be_written_is_said_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    for path in (tmp_path / "file", tmp_path / "file" / "below" / "it"):
        with pytest.raises(NotADirectoryError, match="file"):
            check_folder_writable(path)
    check_folder_writable(tmp_path)
    check_folder_writable(tmp_path / "new" / "folder")
    assert names(tmp_path) == ["file"]

    def refuse(folder: Path, *_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(folder))

    monkeypatch.setattr(Path, "mkdir", refuse)
    for path, check in ((tmp_path / "new" / "folder", check_folder_writable), (tmp_path / "file", check_writable)):
        with pytest.raises(PermissionError) as error:
            check(path)
        assert error.value.filename == str(path)  # not that of the folder that was tried


def test_a_folder_that_exists_is_written_without_touching_its_parent(tmp_path):
    out = tmp_path / "mounted"
    out.mkdir()
    with atomic_folder(out) as part:
        assert names(tmp_path) == ["mounted"]
        (part / "a.txt").write_text("new")
    assert names(out) == ["a.txt"]


def test_files_that_belong_together_come_together_or_not_at_all(tmp_path):
    (tmp_path / "b").write_text("old")

    def write() -> None:
        with atomic_files([tmp_path / "a", tmp_path / "b"]) as (a, _b):
            a.write_text("new")  # and the second file is never written

    with pytest.raises(InvalidInputError, match="nothing was written"):
        write()
    assert names(tmp_path) == ["b"]
    with atomic_files([tmp_path / "a", tmp_path / "b"]) as (a, b):
        a.write_text("1")
        b.write_text("2")
    assert [(tmp_path / n).read_text() for n in names(tmp_path)] == ["1", "2"]


def test_a_rename_that_fails_puts_the_renamed_files_back(tmp_path, monkeypatch):
    (tmp_path / "a").write_text("old a")
    replace = Path.replace

    def fail_on_c(self: Path, target: Path) -> Path:
        if Path(target).name == "c":
            raise OSError(28, "No space left on device")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", fail_on_c)

    def write() -> None:
        with atomic_files([tmp_path / n for n in "abc"]) as parts:
            for part in parts:
                part.write_text("new")

    with pytest.raises(OSError, match="No space"):
        write()
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "old a"


def test_a_new_folder_appears_whole_with_its_parents(tmp_path):
    with atomic_folder(tmp_path / "x" / "y" / "out") as folder:
        (folder / "a").write_text("1")
        (folder / "sub").mkdir()
        (folder / "sub" / "b").write_text("2")
        assert not (tmp_path / "x" / "y" / "out").exists()
    out = tmp_path / "x" / "y" / "out"
    assert (out / "a").read_text() + (out / "sub" / "b").read_text() == "12"
    assert names(out.parent) == ["out"]


def test_an_error_leaves_no_folder_and_no_parents_behind(tmp_path):
    def write() -> None:
        with atomic_folder(tmp_path / "x" / "y" / "out") as folder:
            (folder / "a").write_text("1")
            raise Interrupt

    with pytest.raises(Interrupt):
        write()
    assert names(tmp_path) == []


def test_an_existing_folder_keeps_the_files_that_are_not_ours(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("precious")
    (out / "a").write_text("old")
    with atomic_folder(out) as folder:
        (folder / "a").write_text("new")
        (folder / "sub").mkdir()
        (folder / "sub" / "b").write_text("2")
    assert names(out) == ["a", "sub", "thesis.tex"]
    assert (out / "a").read_text() == "new"
    assert (out / "thesis.tex").read_text() == "precious"
    assert names(tmp_path) == ["out"]


def test_an_error_leaves_an_existing_folder_as_it_was(tmp_path, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    (out / "a").write_text("old")
    replace = Path.replace

    def fail_on_z(self: Path, target: Path) -> Path:
        if Path(target).name == "z":
            raise OSError(28, "No space left on device")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", fail_on_z)

    def write() -> None:
        with atomic_folder(out) as folder:
            (folder / "a").write_text("new")
            (folder / "sub").mkdir()
            (folder / "sub" / "z").write_text("2")

    with pytest.raises(OSError, match="No space"):
        write()
    assert names(tmp_path) == ["out"]
    assert names(out) == ["a"]
    assert (out / "a").read_text() == "old"


def test_two_runs_that_make_one_new_folder_at_once_both_succeed(tmp_path):
    with atomic_folder(tmp_path / "out") as first:
        (first / "a").write_text("1")
        (first / "b").write_text("1")
        with atomic_folder(tmp_path / "out") as second:
            (second / "b").write_text("2")
            (second / "c").write_text("2")
    assert names(tmp_path) == ["out"]
    assert {file.name: file.read_text() for file in (tmp_path / "out").iterdir()} == {"a": "1", "b": "1", "c": "2"}


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(NotADirectoryError), atomic_folder(tmp_path / "out"):
        pytest.fail("the block must not run")
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("written", [None, "map.pgm"])
def test_a_full_disk_names_the_users_file(tmp_path, written):
    with (
        pytest.raises(OSError, match="No space left on device") as caught,
        atomic_file(tmp_path / "map.pgm") as part,
    ):
        raise OSError(errno.ENOSPC, "No space left on device", written and str(part))
    assert caught.value.filename == str(tmp_path / "map.pgm")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("written", [None, "figure.svg"])
def test_a_full_disk_names_the_users_folder(tmp_path, written):
    with (
        pytest.raises(OSError, match="No space left on device") as caught,
        atomic_folder(tmp_path / "out") as part,
    ):
        raise OSError(errno.ENOSPC, "No space left on device", written and str(part / written))
    assert caught.value.filename == str(tmp_path / "out" / (written or ""))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("number", "name"), [(errno.EIO, None), (errno.ENOSPC, "elsewhere.log")])
def test_an_error_of_another_file_is_left_as_it_is(tmp_path, number, name):
    with pytest.raises(OSError, match=os.strerror(number)) as caught, atomic_folder(tmp_path / "out"):
        raise OSError(number, os.strerror(number), name)
    assert caught.value.filename == name


def test_a_folder_with_a_file_that_is_to_be_kept_stays_as_it_was(tmp_path):
    for name in ("input.csv", "other.csv"):
        (tmp_path / name).write_text("old")

    def replace_both() -> None:
        with kept_files([tmp_path / "input.csv"]), atomic_folder(tmp_path) as part:
            for name in ("input.csv", "other.csv"):
                (part / name).write_text("new")

    with pytest.raises(InvalidInputError, match=r"input\.csv: this is read as input"):
        replace_both()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"input.csv": "old", "other.csv": "old"}
