"""Read a bag, finished or not: its topics, its records and its messages in storage order."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePath
from typing import BinaryIO

import yaml
from mcap.records import Channel, McapRecord, Message, Metadata, Schema, Statistics
from mcap.well_known import MessageEncoding, SchemaEncoding

from recorder.bag import BAG_INFORMATION, METADATA_FILE, Topic, parse_qos
from recorder.errors import RecorderError
from recorder.mcap_stream import DamageError, ForeignError, read_records, read_summary
from recorder.message import RawMessage

_METADATA_LIMIT = 4 * 1024 * 1024
"""The most bytes of `metadata.yaml` that are read; rosbag2 writes some kilobytes."""


def read_bag(path: Path) -> Bag:
    """Open a bag folder, recorded here or by `ros2 bag record`, or one `.mcap` file.

    An unfinished or damaged bag is opened as far as it goes, see `Bag.problem`.

    Raises:
        RecorderError: there is nothing to read; the message names the remedy.
    """
    try:
        path.stat()
        files, problem = _bag_files(path) if path.is_dir() else ([path], None)
        _refuse_sqlite(path, files)
        return Bag(path, files, problem)
    except ForeignError as error:
        raise RecorderError(
            f"{path} is no bag: {error}; choose a rosbag2 bag folder or an .mcap file of ROS 2"
        ) from None
    except OSError as error:
        raise RecorderError(
            f"cannot read {error.filename or path}: {error.strerror or error}; "
            "check the path and its permissions"
        ) from None


class Bag:
    """A bag on disk; made by `read_bag`. No file is held open between calls.

    Attributes:
        path: the bag folder or the file.
        records: the MCAP metadata records; of several with one name the last.
        problem: why the bag is not complete, in words; None for a complete one. Damage that
            only reading everything can show is added by `messages`.
    """

    def __init__(self, path: Path, files: Iterable[Path], problem: str | None) -> None:
        self.path = path
        self.problem = problem
        self.records: dict[str, dict[str, str]] = {}
        self._files: list[Path] = []
        self._topics: dict[str, Topic] = {}
        for file in files:
            try:
                catalogue, damage = _catalogue(file)
                topics = catalogue.topics()
            except (DamageError, OSError) as error:
                if not self._files:
                    raise
                self._found(file, error)
                break
            self._files.append(file)
            self.records |= catalogue.records
            for topic in topics:
                self._topics.setdefault(topic.name, topic)
            if damage is not None:
                self._found(file, damage)

    @property
    def complete(self) -> bool:
        """Whether everything that was recorded is there, as far as is known."""
        return self.problem is None

    def topics(self) -> tuple[Topic, ...]:
        """The topics, with their definitions."""
        return tuple(self._topics.values())

    def messages(self) -> Iterator[RawMessage]:
        """Messages in the order in which they were written, chunk by chunk from the disk.

        Ends where the bag is torn or damaged, and then says so in `problem`; never raises.
        """
        for file in self._files:
            try:
                yield from _messages(file)
            except (DamageError, OSError) as error:
                self._found(file, error)
                return

    def _found(self, file: Path, error: Exception) -> None:
        self.problem = self.problem or f"{file}: {error}; what comes before that is read"


class _Catalogue:
    """Schemas, channels and metadata records of one file, gathered in any order."""

    def __init__(self, records: Iterable[McapRecord] = ()) -> None:
        self.records: dict[str, dict[str, str]] = {}
        self.statistics: Statistics | None = None
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._by_channel: dict[int, Topic] = {}
        for record in records:
            self.add(record)

    def add(self, record: McapRecord) -> None:
        match record:
            case Schema():
                self._schemas.setdefault(record.id, record)
            case Channel():
                self._channels.setdefault(record.id, record)
            case Metadata():
                self.records[record.name] = record.metadata
            case Statistics():
                self.statistics = record

    @property
    def whole(self) -> bool:
        """Whether, taken from a summary, it is all that the file holds."""
        return (
            self.statistics is not None
            and self.statistics.channel_count == len(self._channels)
            and bool(self.records) == bool(self.statistics.metadata_count)
            and all(channel.schema_id in self._schemas for channel in self._channels.values())
        )

    def topics(self) -> list[Topic]:
        """The topics whose type is there.

        Raises:
            ForeignError: one does not hold ROS 2 messages.
        """
        topics = []
        for channel_id in self._channels:
            try:
                topics.append(self.topic(channel_id))
            except ForeignError:
                raise
            except DamageError:  # its messages cannot be read either, and then say so
                continue
        return topics

    def topic(self, channel_id: int) -> Topic:
        """The topic of a channel.

        Raises:
            ForeignError: it does not hold ROS 2 messages.
            DamageError: it is not in the file.
        """
        if channel_id not in self._by_channel:
            self._by_channel[channel_id] = self._make_topic(channel_id)
        return self._by_channel[channel_id]

    def _make_topic(self, channel_id: int) -> Topic:
        channel = self._channels.get(channel_id)
        if channel is None:
            raise DamageError(f"a message belongs to the unknown channel {channel_id}")
        if channel.message_encoding != MessageEncoding.CDR:
            raise ForeignError(f"{channel.topic} holds {channel.message_encoding!r}, not CDR")
        schema = self._schemas.get(channel.schema_id)
        if schema is None:
            raise DamageError(f"the type of {channel.topic} is missing")
        is_text = schema.encoding == SchemaEncoding.ROS2
        return Topic(
            channel.topic,
            schema.name,
            schema.data.decode(errors="replace") if is_text else "",
            channel.metadata.get("topic_type_hash", ""),
            parse_qos(channel.metadata.get("offered_qos_profiles", "")),
        )


def _catalogue(path: Path) -> tuple[_Catalogue, DamageError | None]:
    """What a file holds, by its summary or else by reading it, and what ended the reading."""
    with _open(path) as file:
        try:
            catalogue = _Catalogue(read_summary(file))
            if catalogue.whole:
                return catalogue, None
        except DamageError:
            pass  # unfinished, or a writer that makes no summary
        catalogue = _Catalogue()
        try:
            for record in read_records(file):
                catalogue.add(record)
        except ForeignError:
            raise
        except DamageError as error:
            return catalogue, error
        return catalogue, None


def _messages(path: Path) -> Iterator[RawMessage]:
    catalogue = _Catalogue()
    count = 0
    with _open(path) as file:
        for record in read_records(file):
            if not isinstance(record, Message):
                catalogue.add(record)
                continue
            topic = catalogue.topic(record.channel_id)
            count += 1
            yield RawMessage(
                topic.name, topic.type, record.data, record.publish_time, record.log_time
            )
    statistics = catalogue.statistics
    if statistics is not None and statistics.message_count != count:
        raise DamageError(f"{count} of {statistics.message_count} messages are left")


def _open(path: Path) -> BinaryIO:
    if path.exists() and not path.is_file():
        raise ForeignError(f"{path.name} is not a file")
    return path.open("rb")


def _bag_files(folder: Path) -> tuple[list[Path], str | None]:
    """The recordings of a bag in their order, and why they may not be all."""
    try:
        return _listed_files(folder), None
    except FileNotFoundError:
        problem = f"{folder} has no {METADATA_FILE}, so its recording was not finished"
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError, yaml.YAMLError):
        problem = f"{folder / METADATA_FILE} is damaged"
    recordings = [path for path in folder.iterdir() if path.suffix in {".mcap", ".db3"}]
    if not recordings:
        raise ForeignError("the folder holds no recording")
    return sorted(recordings, key=_natural), problem


def _listed_files(folder: Path) -> list[Path]:
    with (folder / METADATA_FILE).open("rb") as file:
        document = yaml.safe_load(file.read(_METADATA_LIMIT))
    information = document[BAG_INFORMATION]
    if str(information.get("compression_mode", "")).lower() in {"file", "message"}:
        raise RecorderError(
            f"{folder} is compressed by rosbag2 as a whole; unpack it by `ros2 bag convert`"
        )
    # Early versions put the folder's name before the file's.
    names = [PurePath(name).name for name in information["relative_file_paths"]]
    if not names or not all(name.isprintable() for name in names):
        raise ValueError
    return [folder / name for name in names]


def _refuse_sqlite(path: Path, files: Iterable[Path]) -> None:
    if any(file.suffix == ".db3" for file in files):
        raise RecorderError(f"{path} is a sqlite3 bag; make it an mcap bag by `ros2 bag convert`")


def _natural(path: Path) -> list[int | str]:
    """Order by the numbers in a name: `bag_10.mcap` comes after `bag_9.mcap`."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.name)]
