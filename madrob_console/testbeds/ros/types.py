"""Message types of the running ROS system: classes and definitions of installed packages."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rosbags.typesys import TypesysError, get_types_from_msg

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.messages.codec import describe_topic
from madrob_console.messages.types import MessageTypes, nested_types
from madrob_console.testbeds.ros.connection import RosObject, load_message_class
from recorder.bag import Topic, topic_problem

_SEPARATOR = "=" * 80


@dataclass(frozen=True, slots=True)
class Definition:
    """A type's `ros2msg` text with nested definitions appended; an unknown hash is empty."""

    text: str
    type_hash: str


def prefixes(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Where packages are installed: `AMENT_PREFIX_PATH`, then Python's own prefix (the wheels)."""
    paths = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return (*(Path(path) for path in paths if path), Path(sys.prefix))


def describe_registered(
    types: MessageTypes, prefixes: Sequence[Path], topic: str, type_name: str
) -> tuple[RosObject, Topic]:
    """A topic whose type becomes one of the `types`; MadrobError where the type is unusable."""
    message_class = load_message_class(type_name)
    definition = find_definition(type_name, prefixes)
    if definition is None:
        return message_class, describe_topic(types, topic, type_name)
    types.register(type_name, definition.text)
    described = describe_topic(types, topic, type_name)
    return message_class, replace(described, type_hash=definition.type_hash or described.type_hash)


def describe_installed(
    prefixes: Sequence[Path], topic: str, type_name: str
) -> tuple[RosObject, Topic]:
    """A topic as its installed package has it; MadrobError where that cannot be recorded."""
    message_class = load_message_class(type_name)
    definition = find_definition(type_name, prefixes)
    if definition is None:
        raise MadrobError(f"{type_name} has no .msg file here: install its package again, whole")
    described = Topic(topic, type_name, definition.text, definition.type_hash)
    if (refused := topic_problem(described)) is not None:
        raise MadrobError(terminal_safe(refused))
    return message_class, described


def find_definition(type_name: str, prefixes: Sequence[Path]) -> Definition | None:
    """The installed definition of a type; None without its `.msg` file."""
    text = _msg_text(type_name, prefixes)
    if text is None:
        return None
    found: dict[str, str] = {}
    known, pending = {type_name}, _nested(type_name, text)
    while pending:
        nested = pending.pop(0)
        if nested in known:
            continue
        known.add(nested)
        inner = _msg_text(nested, prefixes)
        if inner is not None:
            found[nested] = inner
            pending += _nested(nested, inner)
    return Definition(_joined(text, found), _type_hash(type_name, prefixes))


def _joined(text: str, nested: Mapping[str, str]) -> str:
    parts = [text]
    for name, inner in nested.items():
        package, last = name.split("/")[0], name.split("/")[-1]
        parts.append(f"{_SEPARATOR}\nMSG: {package}/{last}\n{inner}")
    return "\n".join(parts)


def _file(type_name: str, suffix: str, prefixes: Sequence[Path]) -> Path | None:
    package, name = type_name.split("/", maxsplit=1)[0], type_name.rsplit("/", maxsplit=1)[-1]
    for prefix in prefixes:
        path = prefix / "share" / package / "msg" / f"{name}{suffix}"
        if path.is_file():
            return path
    return None


def _msg_text(type_name: str, prefixes: Sequence[Path]) -> str | None:
    path = _file(type_name, ".msg", prefixes)
    return path.read_text(encoding="utf-8", errors="replace") if path else None


def _type_hash(type_name: str, prefixes: Sequence[Path]) -> str:
    path = _file(type_name, ".json", prefixes)
    try:
        hashes = json.loads(path.read_bytes())["type_hashes"] if path else []
        return next((str(h["hash_string"]) for h in hashes if h["type_name"] == type_name), "")
    except (OSError, ValueError, LookupError, TypeError):
        return ""


def _nested(type_name: str, text: str) -> list[str]:
    try:
        return nested_types(type_name, get_types_from_msg(text, type_name))
    except (TypesysError, ValueError, LookupError):
        return []
