"""Message types: bytes to message objects and back, without a ROS installation.

A thin layer over the typestore of rosbags: the standard types of ROS 2 Jazzy are known from the
start, every other type is registered at run time with its `ros2msg` definition.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from madrob_console.errors import MadrobError

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc, Typesdict

    from recorder.bag import Topic

_DTYPES = {"byte": "uint8", "char": "uint8"}


Message: TypeAlias = Any
"""A decoded message; rosbags makes its class at run time, with the type's fields."""


class MessageError(MadrobError):
    """A message is not what the configuration says; the text names its topic or type."""


class MessageTypes:
    """The message types that the console knows; standard types from the start."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._given: dict[str, str] = {}

    def register(self, type_name: str, definition: str) -> None:
        """Make a type known.

        Args:
            type_name: full type name, `pkg/msg/Type`.
            definition: `ros2msg` text with the definitions of nested types appended; those that
                are known already may be missing.

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
        complete = _closure(type_name, {**self._store.fielddefs, **parsed}) <= parsed.keys()
        try:
            self._store.register(parsed)
        except TypesysError:
            raise MadrobError(
                f"{type_name}: known with other fields; use one version of its package everywhere"
            ) from None
        if complete:
            self._given[type_name] = text

    def knows(self, type_name: str) -> bool:
        """Whether messages of this type can be encoded and decoded."""
        return type_name in self._store.fielddefs

    def fields(self, type_name: str) -> dict[str, FieldDesc]:
        """The fields of a type as rosbags describes them, by name.

        Raises:
            MessageError: the type is unknown.
        """
        return dict(self._fields(type_name))

    def definition(self, type_name: str) -> str:
        """The type's `ros2msg` text with every nested definition appended.

        Raises:
            MessageError: the type is unknown.
        """
        self._fields(type_name)
        return (
            self._given.get(type_name) or self._store.generate_msgdef(type_name, ros_version=2)[0]
        )

    def type_hash(self, type_name: str) -> str:
        """The type's `RIHS01_...` hash; empty where rosbags would compute a wrong one.

        Raises:
            MessageError: the type is unknown.
        """
        self._fields(type_name)
        for name in _closure(type_name, self._store.fielddefs):
            for _, field in self._store.fielddefs[name][1]:
                # rosidl hashes char as uint8 (and byte as octet), rosbags char as itself.
                if _base_name(field) == "char":
                    return ""
        return self._store.hash_rihs01(type_name)

    def make(self, type_name: str, /, **fields: object) -> Message:
        """A message with the given fields; the others are 0, empty or False.

        Raises:
            MessageError: the type is unknown or has no such field.
        """
        known = dict(self._fields(type_name))
        if unknown := fields.keys() - known.keys():
            raise MessageError(f"{type_name} has no field {min(unknown)}")
        values = [
            fields[name] if name in fields else self._default(field)
            for name, field in known.items()
        ]
        return self._store.types[type_name](*values)  # type: ignore[arg-type]  # checked on encoding

    def encode(self, type_name: str, message: object) -> bytes:
        """A message as CDR bytes.

        Raises:
            MessageError: the type is unknown or the message does not fit it.
        """
        self._fields(type_name)
        try:
            return bytes(self._store.serialize_cdr(message, type_name))
        except Exception as error:  # noqa: BLE001  # a value's misfit raises what it likes
            raise MessageError(f"{type_name}: cannot be encoded ({_line(error)})") from None

    def decode(self, type_name: str, data: bytes) -> Message:
        """The message in CDR bytes.

        Raises:
            MessageError: the type is unknown or the bytes are not a message of it.
        """
        try:
            return self._store.deserialize_cdr(data, type_name)
        except Exception as error:  # noqa: BLE001  # bytes raise what they like
            self._fields(type_name)
            raise MessageError(f"not a {type_name} ({_line(error)})") from None

    def _fields(self, type_name: str) -> list[tuple[str, FieldDesc]]:
        try:
            return self._store.fielddefs[type_name][1]
        except KeyError:
            raise MessageError(
                f"the message type {type_name} is unknown: install its package"
            ) from None

    def _default(self, field: FieldDesc) -> object:
        if field[0] == Nodetype.NAME:
            return self.make(field[1])
        if field[0] == Nodetype.BASE:
            name = field[1][0]
            if name == "bool":
                return False
            return "" if name == "string" else 0.0 if name.startswith("float") else 0
        inner, size = field[1]
        count = size if field[0] == Nodetype.ARRAY else 0
        if inner[0] == Nodetype.NAME or inner[1][0] == "string":
            return [self._default(inner) for _ in range(count)]
        return np.zeros(count, dtype=_DTYPES.get(inner[1][0], inner[1][0]))


def _base_name(field: FieldDesc) -> str | None:
    """The primitive type in a field or in its elements; None for a nested message."""
    inner = field[1][0] if field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else field
    return inner[1][0] if inner[0] == Nodetype.BASE else None


def _nested(type_name: str, fields: Typesdict) -> Iterator[str]:
    for _, field in fields[type_name][1]:
        inner = field[1][0] if field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else field
        if inner[0] == Nodetype.NAME:
            yield inner[1]


def _closure(type_name: str, fields: Typesdict) -> set[str]:
    """The type and all types in it, at any depth."""
    graph: dict[str, list[str]] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop()
        if name not in fields:
            raise MadrobError(f"{type_name}: the definition of {name} is missing; append it")
        if name not in graph:
            graph[name] = list(_nested(name, fields))
            waiting += graph[name]
    try:
        TopologicalSorter(graph).prepare()
    except CycleError:
        raise MadrobError(f"{type_name}: its definition contains itself; correct it") from None
    return set(graph)


def _line(error: Exception) -> str:
    """The first line of an error's text, or its name."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__


@cache
def standard_types() -> MessageTypes:
    """The types of ROS 2, for all bags: what reads them is compiled once. Register nothing here."""
    return MessageTypes()


def types_of(topics: Iterable[Topic]) -> MessageTypes:
    """The types of a bag's topics; those that only it knows are registered for it alone.

    Raises:
        MadrobError: the definition of one cannot be read.
    """
    unknown = [topic for topic in topics if not standard_types().knows(topic.type)]
    if not unknown:
        return standard_types()
    types = MessageTypes()
    for topic in unknown:
        if not types.knows(topic.type):
            types.register(topic.type, topic.definition)
    return types
