"""The schemas, channels and metadata records of one file, and the topics that they make."""

from __future__ import annotations

from collections.abc import Iterable
from typing import BinaryIO

from mcap.records import Channel, McapRecord, Metadata, Schema, Statistics
from mcap.well_known import MessageEncoding, SchemaEncoding

from recorder.bag import Qos, Topic, parse_qos
from recorder.mcap_reader import DamageError, ForeignError, read_summary

CATALOGUE_LIMIT = 16 * 1024 * 1024
"""The most bytes of types, channels and records; those of a run have some 50 KiB."""

TOPIC_LIMIT = 1000
"""The most channels; a run has some twenty."""

QOS_LIMIT = 256 * 1024
"""The most bytes of differing QoS texts; a publisher's has about 400, and most are equal."""

_SHOWN = 80


class Catalogue:
    """Gathers the records of a file in any order, within a bag's limits."""

    def __init__(self, records: Iterable[McapRecord] = ()) -> None:
        self.records: dict[str, dict[str, str]] = {}
        self.statistics: Statistics | None = None
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._by_channel: dict[int, Topic] = {}
        self._qos: dict[str, Qos] = {}
        self._qos_size = 0
        self._size = 0
        for record in records:
            self.add_record(record)

    def add_record(self, record: McapRecord) -> None:
        """Records of other kinds are ignored. Raises DamageError beyond the limits."""
        match record:
            case Schema() if record.id not in self._schemas:
                self._grow(len(record.data) + len(record.name) + len(record.encoding))
                self._schemas[record.id] = record
            case Channel() if record.id not in self._channels:
                self._grow(len(record.topic) + _text_size(record.metadata))
                if len(self._channels) == TOPIC_LIMIT:
                    raise DamageError(f"it has more than {TOPIC_LIMIT} channels")
                self._channels[record.id] = record
            case Metadata():
                self._grow(len(record.name) + _text_size(record.metadata))
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

    def channels_of(self, topic: str) -> set[int]:
        return {number for number, channel in self._channels.items() if channel.topic == topic}

    def topics(self, channel_ids: Iterable[int] | None = None) -> list[Topic]:
        """Of some channels, or all. Raises ForeignError if one is not of ROS 2."""
        topics = []
        for channel_id in self._channels if channel_ids is None else channel_ids:
            try:
                topics.append(self.topic(channel_id))
            except ForeignError:
                raise
            except DamageError:  # its messages cannot be read either, and then say so
                continue
        return topics

    def topic(self, channel_id: int) -> Topic:
        """Raises ForeignError if it is not of ROS 2, DamageError if it is not in the file."""
        if channel_id not in self._by_channel:
            self._by_channel[channel_id] = self._make_topic(channel_id)
        return self._by_channel[channel_id]

    def _make_topic(self, channel_id: int) -> Topic:
        channel = self._channels.get(channel_id)
        if channel is None:
            raise DamageError(f"a message belongs to the unknown channel {channel_id}")
        name = _shown(channel.topic)
        if channel.message_encoding != MessageEncoding.CDR:
            raise ForeignError(f"{name} holds {channel.message_encoding[:_SHOWN]!r}, not CDR")
        schema = self._schemas.get(channel.schema_id)
        if schema is None:
            raise DamageError(f"the type of {name} is missing")
        is_text = schema.encoding == SchemaEncoding.ROS2
        return Topic(
            channel.topic,
            schema.name,
            schema.data.decode(errors="replace") if is_text else "",
            channel.metadata.get("topic_type_hash", ""),
            self._parsed_qos(channel.metadata.get("offered_qos_profiles", "")),
        )

    def _parsed_qos(self, text: str) -> Qos:
        if text not in self._qos:
            self._qos_size += len(text)
            if self._qos_size > QOS_LIMIT:
                raise DamageError(f"its topics have more than {QOS_LIMIT} bytes of QoS")
            self._qos[text] = parse_qos(text)
        return self._qos[text]

    def _grow(self, size: int) -> None:
        self._size += size
        if self._size > CATALOGUE_LIMIT:
            raise DamageError(f"its types and records have more than {CATALOGUE_LIMIT} bytes")


def _text_size(metadata: dict[str, str]) -> int:
    return sum(len(key) + len(value) for key, value in metadata.items())


def _shown(name: str) -> str:
    return name if name.isprintable() and len(name) <= _SHOWN else repr(name[:_SHOWN])


def read_outline(file: BinaryIO) -> Catalogue:
    """What a file holds beside messages, by its summary; DamageError where that is not all."""
    catalogue = Catalogue(read_summary(file))
    if not catalogue.whole:
        raise DamageError("its summary is not complete")
    return catalogue
