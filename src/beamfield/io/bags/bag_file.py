"""Open ROS 1 and ROS 2 bags and walk through their messages, without ROS."""

from __future__ import annotations

import errno
import os
import re
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from ruamel.yaml.error import MantissaNoDotYAML1_1Warning

from beamfield.errors import BeamfieldError, FormatError, InvalidInputError, needs
from beamfield.io.bags.unpacking import Allowance, check_storage, limit_chunks, unpack_file, unpack_message
from beamfield.io.files.atomic import scratch_folder
from beamfield.io.files.bag_storage import is_packed_storage, mcap_profile, repair_of, storage_of
from beamfield.io.files.yaml_file import read_yaml

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

METADATA = "metadata.yaml"
MAX_METADATA_BYTES = 2**20  # a thousand topics need less
REINDEX = "`ros2 bag reindex` writes the metadata anew"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no message begins so: the first byte of CDR is 0


@contextmanager
def _without_yaml_warnings() -> Iterator[None]:
    """Leave out ruamel's warning of numbers without a point where metadata.yaml declares YAML 1.1."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MantissaNoDotYAML1_1Warning)
        yield


@dataclass(frozen=True)
class BagMessage:
    """One message of a topic, and when it was recorded, seconds.

    Its type is named as in ROS 2 (``sensor_msgs/msg/LaserScan``), its number counts the topic's messages from 1 in the
    order of recording, and its content has the fields of its type.
    """

    topic: str
    msgtype: str
    number: int
    recorded: float
    content: Any

    @property
    def place(self) -> str:
        """Topic and number, for errors."""
        return f"{self.topic}, message {self.number}"

    @property
    def stamp(self) -> float:
        """The header's stamp in seconds."""
        return seconds(self.content.header.stamp)


class BagFile:
    """An open bag: its topics, and its messages in the order of recording.

    Parameters
    ----------
    path
        A ROS 1 ``.bag``, or the folder of all parts of one that was split; a ROS 2 folder (with ``metadata.yaml``, or
        without, as a crash leaves it); or one ``.db3`` or ``.mcap`` file, in which case the folder around it is read if
        its metadata lists the file.

    Raises
    ------
    FormatError
        If it is not a bag, is cut or damaged, or unpacks to far more than its size (`unpacking`).
    MissingDependencyError
        If the package rosbags is not installed.
    FileNotFoundError, PermissionError
        From the file system.

    Notes
    -----
    Bags before ROS 2 Iron carry no message definitions. The types that beamfield reads have not changed over the ROS 2
    distributions, so that the newest definitions serve for all of them.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._stack = ExitStack()
        self.n_files = 0
        self._unpack: Callable[[bytes], bytes]  # for messages that are compressed one by one

    @_without_yaml_warnings()
    def __enter__(self) -> BagFile:
        with ExitStack() as stack, _speaking_of(self.path):
            paths, self._unpack = _storage(self.path, stack)
            self.n_files = len(paths)
            self._reader = stack.enter_context(_reader(paths))
            if not self._reader.is2:
                for reader, path in zip(self._reader.readers, paths, strict=True):
                    limit_chunks(reader, path)
            self._check_topics()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        with _speaking_of(self.path):
            self._stack.close()

    def _check_topics(self) -> None:
        """Check what metadata.yaml, where every value may be of any type, says about the topics."""
        for c in self._reader.connections:
            named = isinstance(c.topic, str) and isinstance(c.msgtype, str)
            if not named or not isinstance(c.msgcount, int) or c.msgcount < 0:
                raise FormatError(
                    self.path, f"expected topic, type and number of messages, got {(c.topic, c.msgtype, c.msgcount)!r}"
                )

    @property
    def topics(self) -> dict[str, str]:
        """Message type of each topic, in the order of the bag."""
        return {c.topic: c.msgtype for c in self._reader.connections}

    @property
    def counts(self) -> dict[str, int]:
        """How many messages each topic has, as the bag declares it."""
        totals: dict[str, int] = {}
        for c in self._reader.connections:
            totals[c.topic] = totals.get(c.topic, 0) + c.msgcount
        return totals

    def of_type(self, *msgtypes: str) -> list[str]:
        """Return the topics with one of these message types."""
        return [topic for topic, msgtype in self.topics.items() if msgtype in msgtypes]

    def find_topic(self, name: str, *msgtypes: str) -> str:
        """Return the topic of that name, which holds one of these types; a leading slash may be left out.

        InvalidInputError if the bag has no such topic (the text lists those it has), or it is of another type.
        """
        topic = next((t for t in (name, f"/{name}") if t in self.topics), None)
        if topic is None:
            raise InvalidInputError(f"{self.path}: no topic {name!r}; the bag has {self.describe()}")
        if msgtypes and self.topics[topic] not in msgtypes:
            held, expected = self.topics[topic], " or ".join(msgtypes)
            raise InvalidInputError(f"{self.path}: topic {topic!r} holds {held}, expected {expected}")
        return topic

    def only_topic(self, what: str, name: str | None, *msgtypes: str, preferred: str = "") -> str:
        """Return the topic of that name; if it is None the only one of these types, or the preferred one of several.

        FormatError says `what` the bag has none of; InvalidInputError as for `find_topic`, or if there are several.
        """
        if name is not None:
            return self.find_topic(name, *msgtypes)
        found = self.of_type(*msgtypes)
        if not found:
            expected = " or ".join(msgtypes)
            raise FormatError(self.path, f"no {what} of type {expected} in this bag; it has {self.describe()}")
        if len(found) > 1 and preferred not in found:
            listed = ", ".join(map(repr, found))
            raise InvalidInputError(f"{self.path}: several {what}s; choose one: the bag has {listed}")
        return preferred if preferred in found else found[0]

    def describe(self) -> str:
        """Return the topics with their types in words, for messages."""
        return ", ".join(f"{topic!r} ({msgtype})" for topic, msgtype in self.topics.items()) or "no topics"

    def messages(self, topics: Iterable[str]) -> Iterator[BagMessage]:
        """Yield the messages of some topics.

        FormatError if the bag is damaged (topic and message number are named), the file ends early, or a topic has
        messages of several types.
        """
        wanted = set(topics)
        connections = [c for c in self._reader.connections if c.topic in wanted]
        if not connections:
            return
        for c in connections:
            if c.msgtype != self.topics[c.topic]:
                raise FormatError(
                    self.path,
                    f"expected one type of message, got {c.msgtype!r} and {self.topics[c.topic]!r}",
                    field=c.topic,
                )
        numbers = dict.fromkeys(wanted, 0)
        for connection, recorded, raw in _guarded(self.path, self._reader.messages(connections)):
            if connection.topic not in wanted:
                raise FormatError(
                    self.path,
                    f"the bag is damaged or truncated: two topics share one id, one of them {connection.topic!r}",
                )
            numbers[connection.topic] += 1
            number = numbers[connection.topic]
            place = f"{connection.topic}, message {number}"
            with _speaking_of(self.path, place):
                if not isinstance(recorded, int):
                    raise FormatError(
                        self.path, f"expected the receive time in nanoseconds, got {recorded!r}", field=place
                    )
                if self._reader.is2 and bytes(raw[:4]) == ZSTD_MAGIC:
                    raw = self._unpack(raw)
                content = self._reader.deserialize(raw, connection.msgtype)
            yield BagMessage(connection.topic, connection.msgtype, number, recorded * 1e-9, content)

    @contextmanager
    def quoting(self, message: BagMessage) -> Iterator[None]:
        """Name the message in what is said about its content; a bag may define the fields of any type as it likes."""
        try:
            yield
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            if isinstance(error, FormatError):
                raise
            text = str(error) if isinstance(error, InvalidInputError) else f"not a valid {message.msgtype}: {error}"
            raise FormatError(self.path, text, field=message.place) from error


def seconds(stamp: Any) -> float:
    """Return a time of ROS 2 and rosbags (sec, nanosec) or of rospy (secs, nsecs) as seconds."""
    if hasattr(stamp, "secs"):
        return float(stamp.secs + stamp.nsecs * 1e-9)
    return float(stamp.sec + stamp.nanosec * 1e-9)


def _storage(path: Path, stack: ExitStack) -> tuple[list[Path], Callable[[bytes], bytes]]:
    """Return what rosbags shall open, checked, and what unpacks messages that are compressed one by one."""
    files = _resolve(path)
    packed = [is_packed_storage(file) for file in files]
    if files[0].is_dir():
        # Readers of folders would take the time to read all of the metadata, which storage files hold as well.
        files, all_packed = _files_of_metadata(files[0])
        packed = [all_packed] * len(files)
    allowance = Allowance(path, sum(file.stat().st_size for file in files))
    # rosbags would unpack them without a limit.
    scratch = stack.enter_context(scratch_folder(Path(tempfile.gettempdir()), path.name)) if any(packed) else path
    opened = []
    for file, is_packed in zip(files, packed, strict=True):
        plain = scratch / file.stem if is_packed else file
        if is_packed:
            unpack_file(file, plain)
        else:
            _check_merged(file)
        check_storage(plain, file)
        _check_profile(plain, file)
        opened.append(plain)
    return opened, partial(unpack_message, allowance=allowance)


def _check_merged(file: Path) -> None:
    """Refuse a database whose last messages are in a file beside it, which rosbags does not read."""
    rest = file.with_name(f"{file.name}-wal")
    if rest.is_file() and rest.stat().st_size > 0:
        raise FormatError(
            file,
            f"a recording that was cut off, or goes on: its last messages are in {rest.name}. Once it has ended, "
            f"`sqlite3 {file.name} 'PRAGMA wal_checkpoint(TRUNCATE)'` moves them into {file.name}",
        )


def _check_profile(path: Path, unpacked_from: Path) -> None:
    """Refuse an MCAP file whose messages may not be those of ROS 2, which is not damaged."""
    profile = mcap_profile(path)
    if profile not in (None, "ros2"):
        raise FormatError(
            unpacked_from,
            f"an MCAP file of profile {profile!r}, not 'ros2': give the ROS 1 .bag that it was made from; "
            "if there is none, `ros2 bag convert` writes it anew",
        )


def _files_of_metadata(folder: Path) -> tuple[list[Path], bool]:
    """Return the storage files of a bag, and whether each of them is compressed as a whole."""
    try:
        metadata = read_yaml(folder / METADATA, max_bytes=MAX_METADATA_BYTES, number_keys=True)
        bag = metadata.value("rosbag2_bagfile_information")
        files = [folder / PurePath(name).name for name in bag["relative_file_paths"]]
        mode = (bag.get("compression_mode") or "").lower()
    except FormatError as error:
        raise FormatError(folder, f"{str(error).removeprefix(f'{folder}/')}; {REINDEX}") from error
    except (AttributeError, KeyError, TypeError) as error:
        raise FormatError(folder / METADATA, f"damaged or truncated: {error}; {REINDEX}") from error
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise FormatError(folder, f"some files are missing: {missing}; without them, {REINDEX}")
    if mode in ("file", "message") and bag.get("compression_format") != "zstd":
        raise FormatError(folder / METADATA, f"expected zstd compression, got {bag.get('compression_format')!r}")
    return files, mode == "file"


def _reader(paths: list[Path]) -> AnyReader:
    with needs("rosbags", "ros", "reading a bag"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    return AnyReader(paths, default_typestore=get_typestore(Stores.LATEST))


def _resolve(path: Path) -> list[Path]:
    """Return what to open for a path that a user names."""
    if path.is_dir():
        return [path] if (path / METADATA).is_file() else _without_metadata(path)
    if is_packed_storage(path):
        raise FormatError(
            path, f"one file of a compressed ROS 2 bag: give the bag's folder, or unpack it with `zstd -d {path.name}`"
        )
    storage = storage_of(path)
    if storage is None:
        with path.open("rb") as file:
            start = file.read(16)
        found = f"it starts with {start!r}" if start else "it is empty"
        raise FormatError(path, f"not a ROS 1 bag, .mcap or .db3 file: {found}")
    if path.suffix == ".active" and storage == ".bag":
        raise FormatError(
            path, f"a recording that was cut off: `rosbag reindex {path.name}` may mend it; then name it {path.stem}"
        )
    if path.suffix != storage:
        raise FormatError(path, f"the content is a {storage} file, but the name ends in {path.suffix!r}")
    if storage != ".bag" and listed_in_metadata(path):
        return [path.parent]
    return [path]


def _without_metadata(folder: Path) -> list[Path]:
    """Return the storage files of a folder, also those that are compressed, unless they lie there unpacked as well."""
    plain = {file: file.with_suffix("") if is_packed_storage(file) else file for file in sorted(folder.iterdir())}
    files = [
        file
        for file, storage in plain.items()
        if storage.suffix in (".db3", ".mcap") and file.is_file() and (file == storage or storage not in plain)
    ]
    return files or _parts_of_ros1(folder)


def _parts_of_ros1(folder: Path) -> list[Path]:
    """Return the files of a folder that `rosbag record --split` has numbered from 0 on, in their order."""
    numbers = {file: re.search(r"_(\d+)\.bag$", file.name) for file in folder.glob("*.bag")}
    parts = {int(number[1]): file for file, number in numbers.items() if number}
    if not numbers:
        raise FormatError(folder, f"not a bag: no {METADATA}, .db3, .mcap or .bag file in it; name a file")
    if len(parts) < len(numbers) or sorted(parts) != list(range(len(parts))):
        raise FormatError(
            folder,
            f"expected the parts of one bag, ..._0.bag and so on, got {', '.join(sorted(f.name for f in numbers))}; "
            "name one of the files",
        )
    return [parts[i] for i in range(len(parts))]


def listed_in_metadata(file: Path) -> bool:
    """Return whether a file is part of the bag in its folder, which is then read as a whole."""
    metadata = file.parent / METADATA
    if not metadata.is_file() or metadata.stat().st_size > MAX_METADATA_BYTES:
        return False
    return os.fsencode(file.name) in metadata.read_bytes()


def _guarded(path: Path, iterator: Iterator[Any]) -> Iterator[Any]:
    """Yield from rosbags' iterator, with its errors turned into ours."""
    while True:
        with _speaking_of(path):
            try:
                item = next(iterator)
            except StopIteration:
                return
        yield item


@contextmanager
def _speaking_of(path: Path, field: str | None = None) -> Iterator[None]:
    """Turn what rosbags raises into a FormatError that names the file.

    rosbags has errors of its own, but a damaged file also comes out as struct.error, KeyError, AssertionError, sqlite's
    and the decompressors' errors, or a seek to nowhere: at this border, all that is not the file system speaking is
    bad content.
    """
    try:
        yield
    except BeamfieldError:
        raise
    except OSError as error:
        if error.errno not in (None, errno.EINVAL, errno.EOVERFLOW, errno.EFBIG):
            raise
        raise _damaged(path, error, field) from error
    except Exception as error:
        raise _damaged(path, error, field) from error


def _damaged(path: Path, error: Exception, field: str | None) -> FormatError:
    text = " ".join(str(error).split())[:300] or ("" if isinstance(error, AssertionError) else type(error).__name__)
    repair = repair_of(path)
    mend = f"; `{repair}` may save what is left" if repair else ""
    return FormatError(path, f"the bag is damaged or truncated{': ' if text else ''}{text}{mend}", field=field)
