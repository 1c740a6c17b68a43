"""Single messages of a recording, found by the times of its chunks without reading all of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from mcap.records import Message

from recorder.bag import RawMessage
from recorder.errors import RecorderError
from recorder.mcap_reader import (
    RECORD_LIMIT,
    DamageError,
    chunk_places,
    read_chunk,
    records_in,
)
from recorder.reader import open_recording, read_catalogue

_MOST_UNPACKED = 2 * RECORD_LIMIT
"""Bytes that are unpacked to find a message: two raw cameras fill as many in two seconds."""


class Seeker:
    """A recording in which messages are looked for; no file is held open between calls.

    `problem` says why it is not complete, as far as is known; else None. Raises DamageError or
    OSError if there is nothing to read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._catalogue, self.problem = read_catalogue(path)
        self.topics = tuple(self._catalogue.topics())
        with open_recording(path) as file:
            self._chunks = chunk_places(file)
        self._unpacked = 0

    def nearest(self, name: str, at_ns: int, within_ns: int) -> RawMessage | None:
        """The message of a topic that was received nearest to an instant, ns since the epoch.

        None = none within so many ns. A damaged chunk is passed over, and `problem` tells it.
        Raises RecorderError if the disk refuses.
        """
        channels = self._catalogue.channels_of(name)
        near = [chunk for chunk in self._chunks if chunk.distance(at_ns) <= within_ns]
        found: Message | None = None
        self._unpacked = 0
        try:
            with open_recording(self.path) as file:
                for chunk in sorted(near, key=lambda chunk: chunk.distance(at_ns)):
                    if chunk.distance(at_ns) > within_ns or self._unpacked > _MOST_UNPACKED:
                        break
                    if not chunk.channels or chunk.channels & channels:
                        for message in self._messages(file, chunk.offset, channels):
                            if abs(message.log_time - at_ns) <= within_ns:
                                found, within_ns = message, abs(message.log_time - at_ns) - 1
            if found is None:
                return None
            topic = self._catalogue.topic(found.channel_id)
        except (DamageError, OSError) as error:
            raise RecorderError(f"{name}: cannot be read ({error}); look at the disk") from None
        return RawMessage(name, topic.type, found.data, found.publish_time, found.log_time)

    def _messages(self, file: BinaryIO, offset: int, channels: set[int]) -> Iterator[Message]:
        content = read_chunk(file, offset)
        self._unpacked += len(content.records)
        if content.problem is not None and self.problem is None:
            self.problem = f"a chunk {content.problem} (byte {offset})"
        with suppress(DamageError):
            for record in records_in(content.records):
                if isinstance(record, Message) and record.channel_id in channels:
                    yield record
