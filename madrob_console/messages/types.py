"""Message types and their definitions, over the typestore of rosbags.

The standard types of ROS 2 Jazzy are known from the start, every other type is registered at run
time with its `ros2msg` definition.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from madrob_console.common.errors import MadrobError

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc, Typesdict

    from recorder.bag import Topic


Message: TypeAlias = Any
"""A decoded message; rosbags makes its class at run time, with the type's fields."""


class MessageError(MadrobError):
    """A message that does not match the configuration; the text names its topic or type."""


class MessageTypes:
    """Known message types, the standard ones among them; an unknown one raises MessageError."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._given: dict[str, str] = {}

    def register(self, type_name: str, definition: str) -> None:
        """Add the type `pkg/msg/Type` from its `ros2msg` text with nested definitions appended.

        Known nested types may be missing.

        Raises:
            MadrobError: the text cannot be parsed, a nested type is missing, or the type is known
                with other fields.
        """
        text = definition.replace("\r\n", "\n")
        if text and not text.endswith("\n"):
            text += "\n"
        try:
            parsed = get_types_from_msg(text, type_name)
        except (TypesysError, ValueError, AssertionError, RecursionError):
            raise MadrobError(
                f"{type_name}: its definition cannot be read; check the .msg file"
            ) from None
        if type_name not in parsed:
            raise MadrobError(f"{type_name} is no type name; write it as pkg/msg/Type")
        nested = _all_nested(type_name, {**self._store.fielddefs, **parsed})
        try:
            self._store.register(parsed)
        except TypesysError:
            raise MadrobError(
                f"{type_name}: known with other fields; use one version of its package everywhere"
            ) from None
        if nested <= parsed.keys():
            self._given[type_name] = text

    def knows(self, type_name: str) -> bool:
        return type_name in self._store.fielddefs

    def fields(self, type_name: str) -> dict[str, FieldDesc]:
        if not self.knows(type_name):
            raise MessageError(f"the message type {type_name} is unknown: install its package")
        return dict(self._store.fielddefs[type_name][1])

    def definition(self, type_name: str) -> str:
        """Return the type's `ros2msg` text with every nested definition appended."""
        self.fields(type_name)
        return (
            self._given.get(type_name) or self._store.generate_msgdef(type_name, ros_version=2)[0]
        )

    def type_hash(self, type_name: str) -> str:
        """Return the type's `RIHS01_...` hash.

        Empty where rosbags would compute a wrong one.
        """
        self.fields(type_name)
        known = self._store.fielddefs
        nested = _all_nested(type_name, known)
        fields = [element(field) for name in nested for _, field in known[name][1]]
        # rosidl hashes char as uint8 (and byte as octet), rosbags char as itself.
        if (Nodetype.BASE, ("char", 0)) in fields:
            return ""
        return self._store.hash_rihs01(type_name)

    def make(self, type_name: str, /, **fields: object) -> Message:
        """Make a message with the given fields.

        The others are 0, empty or False.
        """
        known = self.fields(type_name)
        if unknown := fields.keys() - known.keys():
            raise MessageError(f"{type_name} has no field {min(unknown)}")
        defaults = {name: self._default(field) for name, field in known.items()}
        return self._store.types[type_name](
            *(defaults | fields).values()  # type: ignore[arg-type]  # checked on encoding
        )

    def encode(self, type_name: str, message: object) -> bytes:
        try:
            return bytes(self._store.serialize_cdr(message, type_name))
        except Exception as error:  # noqa: BLE001  # a value's misfit raises what it likes
            self.fields(type_name)
            raise MessageError(f"{type_name}: cannot be encoded ({_line(error)})") from None

    def decode(self, type_name: str, data: bytes) -> Message:
        try:
            return self._store.deserialize_cdr(data, type_name)
        except Exception as error:  # noqa: BLE001  # bytes raise what they like
            self.fields(type_name)
            raise MessageError(f"not a {type_name} ({_line(error)})") from None

    def _default(self, field: FieldDesc) -> object:
        if field[0] == Nodetype.NAME:
            return self.make(field[1])
        if field[0] == Nodetype.BASE:
            return _DEFAULTS.get(field[1][0], 0)
        inner, size = field[1]
        count = size if field[0] == Nodetype.ARRAY else 0
        if inner[0] == Nodetype.NAME or inner[1][0] == "string":
            return [self._default(inner) for _ in range(count)]
        return np.zeros(count, dtype=_DTYPES.get(inner[1][0], inner[1][0]))


_DEFAULTS = {"bool": False, "string": "", "float32": 0.0, "float64": 0.0}
_DTYPES = {"byte": "uint8", "char": "uint8"}


def is_array(field: FieldDesc) -> bool:
    return field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE)


def element(field: FieldDesc) -> FieldDesc:
    """Return what an array holds, and any other field as it is."""
    return field[1][0] if field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else field


def nested_types(type_name: str, fields: Typesdict) -> list[str]:
    inner = [element(field) for _, field in fields[type_name][1]]
    return [field[1] for field in inner if field[0] == Nodetype.NAME]


def _all_nested(type_name: str, fields: Typesdict) -> set[str]:
    """Return the type and all types in it.

    MadrobError where one lacks or contains itself.
    """
    graph: dict[str, list[str]] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop()
        if name not in fields:
            raise MadrobError(f"{type_name}: the definition of {name} is missing; append it")
        if name not in graph:
            graph[name] = nested_types(name, fields)
            waiting += graph[name]
    try:
        TopologicalSorter(graph).prepare()
    except CycleError:
        raise MadrobError(f"{type_name}: its definition contains itself; correct it") from None
    return set(graph)


def _line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__


@cache
def standard_types() -> MessageTypes:
    """Return the types of ROS 2, shared so that readers compile once. Register nothing here."""
    return MessageTypes()


def types_of(topics: Iterable[Topic]) -> MessageTypes:
    """Return the types of a bag's topics.

    Other than standard ones are known for this bag alone.
    """
    unknown = [topic for topic in topics if not standard_types().knows(topic.type)]
    if not unknown:
        return standard_types()
    types = MessageTypes()
    for topic in unknown:
        if not types.knows(topic.type):
            types.register(topic.type, topic.definition)
    return types
