"""The rosbag2 layout of a bag: file names, messages, topics, QoS, `metadata.yaml`."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import msgspec
import yaml

METADATA_FILE = "metadata.yaml"
BAG_INFORMATION = "rosbag2_bagfile_information"
EVIDENCE = "_evidence"
"""Ends the name of a bag that was recorded beside another one, in the folder of that one."""

MAX_NS = 2**63 - 1
"""The latest time rosbag2 can store; it also stands for the start of an empty bag."""

YAML_PROBLEMS = (
    yaml.YAMLError,
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
)
"""What PyYAML raises over bad content, and what use of content of another shape raises."""

_TOPIC_NAME = re.compile(r"(/[^\s/]+)+")
_TYPE_NAME = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*", re.ASCII)

_QOS_LIMIT = 64 * 1024
"""The most characters of QoS that are parsed; one publisher has about 400."""

_MOST_LEVELS = 2000
"""libyaml recurses on the machine's stack, which has room for far more levels."""

_INDENTED = re.compile(r"[ \t?:-]+")


class Reliability(StrEnum):
    """DDS reliability, as rosbag2 spells it."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


class Durability(StrEnum):
    """As rosbag2 spells it."""

    VOLATILE = "volatile"
    TRANSIENT_LOCAL = "transient_local"


@dataclass(frozen=True, slots=True)
class Qos:
    """The QoS that a topic's publisher offers."""

    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic, as a bag must know it before its first message.

    `definition` is the `ros2msg` text with every nested definition appended. It and `type_hash`
    (`RIHS01_...`) are empty when unknown.
    """

    name: str
    type: str
    definition: str
    type_hash: str = ""
    qos: Qos = Qos()


def topic_problem(topic: Topic) -> str | None:
    if not _TOPIC_NAME.fullmatch(topic.name):
        return f"{topic.name!r} is no full topic name; it reads /like/this"
    if not _TYPE_NAME.fullmatch(topic.type):
        return f"type {topic.type!r} of {topic.name} is no full type name; it reads pkg/msg/Type"
    try:
        f"{topic.name}{topic.definition}{topic.type_hash}".encode()
    except UnicodeEncodeError:
        return f"the definition of {topic.type} ({topic.name!r}) is not valid text"
    return None


def bag_file_name(folder_name: str) -> str:
    return f"{folder_name}_0.mcap"


def qos_text(qos: Qos) -> str:
    return _dump(_qos_profiles(qos))


def load_yaml(text: str) -> object:
    """Read plain values of YAML. Raises YAML_PROBLEMS."""
    blocks = max(map(len, _INDENTED.findall(text)), default=0)
    if text.count("[") + text.count("{") + 2 * blocks >= _MOST_LEVELS:
        raise yaml.YAMLError("nested without bounds")
    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def parse_qos(text: str) -> Qos:
    """Read `offered_qos_profiles`.

    Of several publishers the least that all offer.

    Takes the words of rosbag2 and the numbers of its older versions. What cannot be read counts
    as the default.
    """
    try:
        profiles = load_yaml(text[:_QOS_LIMIT])
    except YAML_PROBLEMS:
        return Qos()
    if not isinstance(profiles, list):
        return Qos()
    items = [item for item in profiles if isinstance(item, dict)]
    if not items:
        return Qos()
    best_effort = any(item.get("reliability") in (Reliability.BEST_EFFORT, 2) for item in items)
    latched = all(item.get("durability") in (Durability.TRANSIENT_LOCAL, 1) for item in items)
    return Qos(
        Reliability.BEST_EFFORT if best_effort else Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
    )


@dataclass(frozen=True, slots=True)
class BagInformation:
    """The content of `metadata.yaml` for a bag of one file.

    Times are log times, ns since the epoch; None without messages.
    """

    file_name: str
    topics: Iterable[Topic]
    counts: Mapping[str, int]
    start_ns: int | None
    end_ns: int | None

    def metadata_yaml(self) -> str:
        return _dump({BAG_INFORMATION: self._document()})

    def serialized_metadata(self) -> str:
        """The metadata record `rosbag2`: without the root key."""
        return _dump(self._document())

    def _document(self) -> dict[str, Any]:
        return {
            "version": 9,
            "storage_identifier": "mcap",
            **self._span(),
            "topics_with_message_count": [
                {
                    "topic_metadata": _topic_metadata(topic),
                    "message_count": self.counts.get(topic.name, 0),
                }
                for topic in self.topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.file_name],
            "files": [{"path": self.file_name, **self._span()}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }

    def _span(self) -> dict[str, Any]:
        start = MAX_NS if self.start_ns is None else self.start_ns
        end = start if self.end_ns is None else self.end_ns
        return {
            "duration": {"nanoseconds": end - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": sum(self.counts.values()),
        }


def _topic_metadata(topic: Topic) -> dict[str, Any]:
    return {
        "name": topic.name,
        "type": topic.type,
        "serialization_format": "cdr",
        "offered_qos_profiles": _qos_profiles(topic.qos),
        "type_description_hash": topic.type_hash,
    }


def _qos_profiles(qos: Qos) -> list[dict[str, Any]]:
    return [
        {
            "history": "unknown",
            "depth": 0,
            "reliability": qos.reliability.value,
            "durability": qos.durability.value,
            "deadline": _infinite(),
            "lifespan": _infinite(),
            "liveliness": "automatic",
            "liveliness_lease_duration": _infinite(),
            "avoid_ros_namespace_conventions": False,
        }
    ]


def _infinite() -> dict[str, int]:
    """DDS for never.

    A new object each time, or the YAML would hold anchors.
    """
    return {"sec": 9_223_372_036, "nsec": 854_775_807}


def _dump(value: object) -> str:
    """Write YAML by libyaml, five times as fast, unless a name is no valid text."""
    quick = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    try:
        return str(yaml.dump(value, Dumper=quick, sort_keys=False, allow_unicode=True))
    except UnicodeEncodeError:
        return yaml.safe_dump(value, sort_keys=False, allow_unicode=True)


def write_metadata(folder_fd: int, information: BagInformation) -> None:
    """Replace `metadata.yaml` in an open folder, on disk on return.

    A crash leaves one of them.
    """
    part = f"{METADATA_FILE}.part"  # no reader looks at it
    with suppress(FileNotFoundError):
        os.unlink(part, dir_fd=folder_fd)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    try:
        with os.fdopen(os.open(part, flags, 0o666, dir_fd=folder_fd), "wb") as file:
            file.write(information.metadata_yaml().encode())
            file.flush()
            os.fsync(file.fileno())
        os.rename(part, METADATA_FILE, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
        os.fsync(folder_fd)
    except OSError:
        with suppress(OSError):
            os.unlink(part, dir_fd=folder_fd)
        raise


class RawMessage(msgspec.Struct, frozen=True, gc=False):
    """A serialised message, as every source yields it and a bag stores it.

    Not a dataclass because there are so many: a frozen one takes ten times as long to make.

    Attributes:
        data: the CDR bytes, with their 4-byte encapsulation header, untouched.
        publish_ns: when the publisher sent it, ns since the epoch.
        receive_ns: when it was received, steady time (protocol section 8), ns since the
            epoch; the bag's log time.
        sequence: the publisher's count of its messages; 0 = unknown.
    """

    topic: str
    type: str
    data: bytes
    publish_ns: int
    receive_ns: int
    sequence: int = 0


@dataclass(slots=True)
class Batch:
    """What is read, or written, together: topics, then their messages, then metadata records."""

    topics: list[Topic] = field(default_factory=list)
    messages: list[RawMessage] = field(default_factory=list)
    records: dict[str, dict[str, str]] = field(default_factory=dict)
