"""Reads messages that are laid out like one that was read before.

A publisher sends the same names and lengths again and again; only numbers change. Once rosbags
has read a message, one `struct.Struct` reads the next, several times as fast, if every length
and every text in it is the same. If not, rosbags reads it again and decides alone. Archives and
jumps in a replay need this; decoding by rosbags would take most of their time.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from rosbags.interfaces import Nodetype

from madrob_console.messages.message_fields import getter
from madrob_console.messages.message_types import Message, MessageTypes
from madrob_console.messages.topic_mapping import NamedElement, Steps

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc


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
