"""Single messages of a bag, found by their time without reading what lies between them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from recorder.bag import Topic
from recorder.chunk_table import ChunkTable, MessagePlace
from recorder.errors import RecorderError
from recorder.mcap_stream import DamageError, ForeignError
from recorder.message import RawMessage
from recorder.reader import bag_files, open_recording


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A message that was found, and not read yet.

    Attributes:
        topic: with the type that this message has.
        log_ns: its log time, ns since the epoch.
        place: where it lies.
        table: of the file in which it lies.
    """

    topic: Topic
    log_ns: int
    place: MessagePlace
    table: ChunkTable

    @property
    def key(self) -> tuple[int, int, int]:
        """The same for the same message, however often it is found."""
        return id(self.table), self.place.chunk.offset, self.place.offset


class Seeker:
    """The files of a bag, open to look for single messages; a context manager.

    Files that are no recordings are passed over and told.

    Args:
        path: a bag folder, or one `.mcap` file.
        evidence: of the folder look at its evidence instead of what is scored.

    Attributes:
        problems: what of it cannot be read, in words.

    Raises:
        RecorderError: there is nothing to read; the message names the remedy.
    """

    def __init__(self, path: Path, *, evidence: bool = False) -> None:
        self.problems: list[str] = []
        self._tables: list[tuple[ChunkTable, dict[int, Topic]]] = []
        with ExitStack() as undo:
            try:
                files = bag_files(path, evidence=evidence)[0] if path.is_dir() else [path]
            except (ForeignError, OSError) as error:
                raise RecorderError(f"cannot read {path}: {error}; choose a bag") from None
            for file in files:
                try:
                    table = ChunkTable(undo.enter_context(open_recording(file)))
                except (DamageError, OSError) as error:
                    self.problems.append(f"{file.name}: {error}")
                    continue
                self._tables.append((table, dict(_topics(table))))
                if table.problem is not None:
                    self.problems.append(f"{file.name}: {table.problem}")
            self._open = undo.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._open.close()

    def topics(self) -> tuple[Topic, ...]:
        """The topics of which there are messages, each with the type that it has first."""
        known: dict[str, Topic] = {}
        for _, topics in self._tables:
            for topic in topics.values():
                known.setdefault(topic.name, topic)
        return tuple(known.values())

    def between(self, name: str, begin_ns: int, end_ns: int) -> list[Found]:
        """The messages of a topic that were logged from one time to another, by log time.

        Raises:
            RecorderError: a file cannot be read.
        """
        return self._found(name, lambda table, channel: table.places(channel, begin_ns, end_ns))

    def spread(self, name: str, most: int) -> list[Found]:
        """Some messages of a topic, evenly over the whole bag, by log time.

        Args:
            name: of the topic.
            most: so many chunks of each file are looked at.

        Raises:
            RecorderError: a file cannot be read.
        """
        return self._found(name, lambda table, channel: table.spread(channel, most))

    def head(self, found: Found, size: int) -> bytes:
        """The first bytes of a message's data.

        Raises:
            RecorderError: it cannot be read.
        """
        try:
            return found.table.head(found.place, size)
        except (DamageError, OSError) as error:
            raise _unreadable(found, error) from None

    def message(self, found: Found, limit: int) -> RawMessage:
        """A message of at most `limit` bytes.

        Raises:
            RecorderError: it cannot be read, or it is larger.
        """
        try:
            message = found.table.message(found.place, limit)
        except (DamageError, OSError) as error:
            raise _unreadable(found, error) from None
        topic = found.topic
        times = message.publish_time, message.log_time
        return RawMessage(topic.name, topic.type, message.data, *times)

    def _found(
        self, name: str, look: Callable[[ChunkTable, int], Iterator[MessagePlace]]
    ) -> list[Found]:
        found: list[Found] = []
        try:
            for table, topics in self._tables:
                for channel, topic in topics.items():
                    if topic.name == name:
                        places = look(table, channel)
                        found += [Found(topic, place.log_ns, place, table) for place in places]
        except OSError as error:
            raise RecorderError(
                f"{name}: cannot be read ({error.strerror}); look at the disk"
            ) from None
        return sorted(found, key=lambda one: one.log_ns)


def _topics(table: ChunkTable) -> Iterator[tuple[int, Topic]]:
    for channel in table.channels:
        try:
            yield channel, table.catalogue.topic(channel)
        except DamageError as error:
            table.problem = table.problem or str(error)


def _unreadable(found: Found, error: DamageError | OSError) -> RecorderError:
    return RecorderError(f"{found.topic.name}: {error}")
