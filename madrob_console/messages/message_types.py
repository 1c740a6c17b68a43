"""Message types: definitions, field paths, and fast reading of CDR by layout.

A thin layer over the typestore of rosbags: the standard types of ROS 2 Jazzy are known from the
start, every other type is registered at run time with its `ros2msg` definition.
"""

from __future__ import annotations

import keyword
import struct
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, reduce
from graphlib import CycleError, TopologicalSorter
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from madrob_console.common.errors import MadrobError
from madrob_console.messages.topic_mapping import NamedElement, Steps, parse_path

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc, Typesdict

    from recorder.bag import Topic

_DTYPES = {"byte": "uint8", "char": "uint8"}


Message: TypeAlias = Any
"""A decoded message; rosbags makes its class at run time, with the type's fields."""


class MessageError(MadrobError):
    """A message does not match the configuration; the text names its topic or type."""


class MessageTypes:
    """Known message types, the standard ones among them; an unknown one raises MessageError."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._given: dict[str, str] = {}

    def register(self, type_name: str, definition: str) -> None:
        """Adds the type `pkg/msg/Type` from its `ros2msg` text with nested definitions appended.

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
        return type_name in self._store.fielddefs

    def fields(self, type_name: str) -> dict[str, FieldDesc]:
        try:
            return dict(self._store.fielddefs[type_name][1])
        except KeyError:
            raise MessageError(
                f"the message type {type_name} is unknown: install its package"
            ) from None

    def definition(self, type_name: str) -> str:
        """The type's `ros2msg` text with every nested definition appended."""
        self.fields(type_name)
        return (
            self._given.get(type_name) or self._store.generate_msgdef(type_name, ros_version=2)[0]
        )

    def type_hash(self, type_name: str) -> str:
        """The type's `RIHS01_...` hash; empty where rosbags would compute a wrong one."""
        self.fields(type_name)
        known = self._store.fielddefs
        nested = _closure(type_name, known)
        fields = [element(field) for name in nested for _, field in known[name][1]]
        # rosidl hashes char as uint8 (and byte as octet), rosbags char as itself.
        if any(field[0] == Nodetype.BASE and field[1][0] == "char" for field in fields):
            return ""
        return self._store.hash_rihs01(type_name)

    def make(self, type_name: str, /, **fields: object) -> Message:
        """A message with the given fields; the others are 0, empty or False."""
        known = self.fields(type_name)
        if unknown := fields.keys() - known.keys():
            raise MessageError(f"{type_name} has no field {min(unknown)}")
        values = [
            fields[name] if name in fields else self._default(field)
            for name, field in known.items()
        ]
        return self._store.types[type_name](*values)  # type: ignore[arg-type]  # checked on encoding

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
            name = field[1][0]
            if name == "bool":
                return False
            return "" if name == "string" else 0.0 if name.startswith("float") else 0
        inner, size = field[1]
        count = size if field[0] == Nodetype.ARRAY else 0
        if inner[0] == Nodetype.NAME or inner[1][0] == "string":
            return [self._default(inner) for _ in range(count)]
        return np.zeros(count, dtype=_DTYPES.get(inner[1][0], inner[1][0]))


def element(field: FieldDesc) -> FieldDesc:
    """What an array holds; any other field as it is."""
    return field[1][0] if field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else field


def nested_types(type_name: str, fields: Typesdict) -> list[str]:
    inner = [element(field) for _, field in fields[type_name][1]]
    return [field[1] for field in inner if field[0] == Nodetype.NAME]


def _closure(type_name: str, fields: Typesdict) -> set[str]:
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
    return next(iter(str(error).splitlines()), "") or type(error).__name__


@cache
def standard_types() -> MessageTypes:
    """The types of ROS 2, shared so that readers compile once. Register nothing here."""
    return MessageTypes()


def types_of(topics: Iterable[Topic]) -> MessageTypes:
    """The types of a bag's topics; other than standard ones are registered for this bag alone."""
    unknown = [topic for topic in topics if not standard_types().knows(topic.type)]
    if not unknown:
        return standard_types()
    types = MessageTypes()
    for topic in unknown:
        if not types.knows(topic.type):
            types.register(topic.type, topic.definition)
    return types


# Fields of a message, by their paths.


Getter: TypeAlias = Callable[[Message], Any]


@dataclass(frozen=True, slots=True)
class MessageField:
    """A field that a type really has.

    Attributes:
        owner: the nested type that holds the last name.
        base: the primitive type of the number or numbers.
        each: the step before which the index of a message in an array belongs; None = the numbers
            are no field of each message.
    """

    steps: Steps
    numbers: bool
    owner: str
    base: str
    each: int | None = None

    def sibling(self, name: str, types: MessageTypes) -> MessageField | None:
        field = types.fields(self.owner).get(name)
        if field is None or not _is_number(field):
            return None
        return MessageField(
            self._beside(name),
            numbers=False,
            owner=self.owner,
            base=str(field[1][0]),
            each=self.each,
        )

    def elements(self, most: int) -> tuple[Steps, ...]:
        """The steps to it, or to it in each of the first `most` messages of the array."""
        at, steps = self.each, self.steps
        if at is None:
            return (steps,)
        return tuple((*steps[:at], index, *steps[at:]) for index in range(most))

    def names(self, types: MessageTypes) -> Getter | None:
        """A function from a message to the names of the elements of which it is one by index."""
        if isinstance(self.steps[-1], int) and _are_texts(types.fields(self.owner).get("name")):
            return getter(self._beside("name"))
        return None

    def _beside(self, name: str) -> Steps:
        last = max(i for i, step in enumerate(self.steps) if isinstance(step, str))
        return (*self.steps[:last], name)


def find_field(types: MessageTypes, type_name: str, path: str) -> MessageField:
    """Finds the field at `path`; raises MadrobError where the path is malformed.

    Raises:
        MessageError: the type is unknown, has no such field, or holds no numbers there.
    """
    steps = parse_path(path)
    desc: FieldDesc = (Nodetype.NAME, type_name)
    owner, each = type_name, None
    for number, step in enumerate(steps):
        if isinstance(step, str):
            if each is None and _is_array(desc) and element(desc)[0] == Nodetype.NAME:
                each, desc = number, element(desc)
            reason = _no_name(types, desc, step)
            if reason is None:
                owner = str(desc[1])
                desc = types.fields(owner)[step]
        else:
            reason = _no_element(types.fields(owner), desc, step)
            if reason is None:
                desc = element(desc)
        if reason is not None:
            raise MessageError(f"{type_name} has no field {path}: {reason}")
    held = element(desc)
    if held[0] == Nodetype.BASE and _is_number(held) and (each is None or held == desc):
        return MessageField(steps, held != desc or each is not None, owner, held[1][0], each)
    raise MessageError(f"{path} of {type_name} holds no numbers")


def _no_name(types: MessageTypes, desc: FieldDesc, name: str) -> str | None:
    """Why there is no field of a name; None = there is."""
    if desc[0] != Nodetype.NAME:
        return "nothing is inside of the array"
    known = types.fields(str(desc[1]))
    return None if name in known else f"{desc[1]} holds {_listed(known)}"


def _no_element(
    beside: dict[str, FieldDesc], desc: FieldDesc, step: int | NamedElement
) -> str | None:
    """Why there is no element at an index or of a name; None = there may be."""
    if not _is_array(desc):
        shown = step if isinstance(step, int) else "=".join(step)
        return f"[{shown}] follows no array"
    if isinstance(step, int):
        size = int(desc[1][1])
        return f"its array ends at {size - 1}" if 0 < size <= step else None
    return None if _are_texts(beside.get(step.names)) else f"{step.names} holds no names"


def find_stamp(types: MessageTypes, type_name: str) -> Getter | None:
    """A function from a message to its stamp; None where the type has no header."""
    header = types.fields(type_name).get("header")
    if header is None or header[1] != "std_msgs/msg/Header":
        return None
    return attrgetter("header.stamp")


def attribute(name: str) -> str:
    """A field's name in the message object: rosbags appends _ to Python's keywords."""
    return name + "_" if keyword.iskeyword(name) else name


def _is_array(field: FieldDesc) -> bool:
    return field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE)


def _are_texts(field: FieldDesc | None) -> bool:
    return field is not None and _is_array(field) and element(field)[1][0] == "string"


def _is_number(field: FieldDesc) -> bool:
    return field[0] == Nodetype.BASE and field[1][0] not in ("string", "wstring")


def _listed(fields: dict[str, FieldDesc]) -> str:
    return ", ".join(fields) or "nothing"


def getter(steps: Steps) -> Getter:
    """A function from a message to the value at `steps`; IndexError where an array is too short.

    The steps have no names of elements, see `Wanted.at`.
    """
    parts = [
        attrgetter(attribute(step)) if isinstance(step, str) else itemgetter(step) for step in steps
    ]
    return lambda message: reduce(lambda value, part: part(value), parts, message)


# Reading messages that are laid out like one that was read before.
#
# A publisher sends the same names and lengths again and again; only numbers change. Once rosbags
# has read a message, one `struct.Struct` reads the next, several times as fast, if every length
# and every text in it is the same. If not, rosbags reads it again and decides alone. Archives and
# jumps in a replay need this; decoding by rosbags would take most of their time.


Numbers: TypeAlias = tuple[float, ...]

_CODES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_TEXT = "s"
_UNUSED = "x"
_HEAD = 4
"""Bytes of the encapsulation header; alignment is counted after them."""

_MOST_PARTS = 200
"""rosbags decodes messages of more parts."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """The number at `steps`, or the first `most` numbers of the array there."""

    steps: Steps
    most: int = 1

    def at(self, message: Message) -> Wanted:
        """With the indices of named elements in a message; beyond its end where a name lacks."""
        steps: list[str | int | NamedElement] = []
        for step in self.steps:
            if isinstance(step, NamedElement):
                index = sys.maxsize
                with suppress(IndexError, ValueError):
                    index = getter((*steps[:-1], step.names))(message).index(step.value)
                steps.append(index)
            else:
                steps.append(step)
        return Wanted(tuple(steps), self.most)

    def getter(self) -> Callable[[Message], Numbers]:
        get, most = getter(self.steps), self.most

        def numbers(message: Message) -> Numbers:
            try:
                found = get(message)
            except IndexError:
                return ()
            return tuple(found[:most].tolist()) if isinstance(found, np.ndarray) else (found,)

        return numbers


class Layout:
    """The layout of one message; ValueError where rosbags has to decode the message instead."""

    def __init__(
        self, types: MessageTypes, type_name: str, data: bytes, wanted: Sequence[Wanted]
    ) -> None:
        walk = _Walk(types, data, {one.steps: one.most for one in wanted})
        walk.message(type_name, ())
        walk.skip(len(data) - _HEAD - walk.place)
        parts = "".join(f"{count}{code}" for code, count in walk.parts)
        self._struct = struct.Struct(("<" if data[1] else ">") + parts)
        sample = self._struct.unpack(data)
        self._same = tuple((i, part) for i, part in enumerate(sample) if isinstance(part, bytes))
        self._slices = tuple(walk.found.get(one.steps, slice(0)) for one in wanted)

    def read(self, data: bytes) -> tuple[Numbers, ...] | None:
        """The numbers of each `Wanted`, none where an array is too short; None = another layout."""
        if len(data) != self._struct.size:
            return None
        values = self._struct.unpack(data)
        for index, part in self._same:
            if values[index] != part:
                return None
        return tuple([values[part] for part in self._slices])


class _Walk:
    """Goes through a message once, from its first field to its last.

    Attributes:
        parts: (struct code, count), one after the other.
        found: where in the unpacked values the wanted numbers are.
        place: offset in bytes behind the head.
    """

    def __init__(self, types: MessageTypes, data: bytes, wanted: dict[Steps, int]) -> None:
        self.parts: list[tuple[str, int]] = [(_TEXT, _HEAD)]
        self.found: dict[Steps, slice] = {}
        self.place = 0
        self._types = types
        self._data = data
        self._length = struct.Struct("<I" if data[1] else ">I")
        self._wanted = wanted
        self._values = 1

    def message(self, type_name: str, steps: Steps) -> None:
        for name, field in self._types.fields(type_name).items():
            self._field(field, (*steps, name))

    def skip(self, count: int) -> None:
        self._part(_UNUSED, count)
        self.place += count

    def _field(self, field: FieldDesc, steps: Steps) -> None:
        if field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            inner, count = field[1]
            if field[0] == Nodetype.SEQUENCE:
                count = self._count()
            if inner[0] == Nodetype.BASE and inner[1][0] in _CODES:
                self._numbers(inner[1][0], count, steps)
            else:
                for index in range(count):
                    self._field(inner, (*steps, index))
        elif field[0] == Nodetype.NAME:
            self.message(field[1], steps)
        elif field[1][0] == "string":
            self._text(self._count())
        elif field[1][0] in _CODES:
            self._numbers(field[1][0], 1, steps)
        else:
            raise ValueError(field[1][0])

    def _numbers(self, kind: str, count: int, steps: Steps) -> None:
        if not count:
            return
        code = _CODES[kind]
        size = struct.calcsize(f"<{code}")
        self.skip(-self.place % size)
        done = 0
        if most := self._wanted.get(steps):
            done = min(most, count)
            self._take(code, size, done, steps)
        else:
            for index in sorted(s[-1] for s in self._wanted if s[:-1] == steps):
                if isinstance(index, int) and index < count:
                    self.skip(size * (index - done))
                    self._take(code, size, 1, (*steps, index))
                    done = index + 1
        self.skip(size * (count - done))

    def _take(self, code: str, size: int, count: int, steps: Steps) -> None:
        self.found[steps] = slice(self._values, self._values + count)
        self._values += count
        self._part(code, count)
        self.place += size * count

    def _count(self) -> int:
        """An array length, which has to be the same in every message of this layout."""
        self.skip(-self.place % self._length.size)
        (count,) = self._length.unpack_from(self._data, _HEAD + self.place)
        self._text(self._length.size)
        return int(count)

    def _text(self, count: int) -> None:
        self.place += count
        code, before = self.parts[-1]
        if code == _TEXT:
            self.parts[-1] = (code, before + count)
        elif count:
            self._part(_TEXT, count)
            self._values += 1

    def _part(self, code: str, count: int) -> None:
        if count:
            self.parts.append((code, count))
        if len(self.parts) > _MOST_PARTS:
            raise ValueError("many parts")
