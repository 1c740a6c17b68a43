"""Paths to a field of a message: `position[0]`, `wrench.force.x`, `ranges`."""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, TypeAlias

from rosbags.interfaces import Nodetype

from madrob_console.errors import MadrobError
from madrob_console.messages.message_types import Message, MessageError, MessageTypes

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc

_PATH = re.compile(r"[A-Za-z]\w*(\[\d+\])?(\.[A-Za-z]\w*(\[\d+\])?)*", re.ASCII)
_STEP = re.compile(r"[A-Za-z]\w*|\d+", re.ASCII)

Getter: TypeAlias = Callable[[Message], Any]
Steps: TypeAlias = tuple[str | int, ...]
"""Names and indices that lead to a field."""


def parse_path(path: str) -> Steps:
    """A path as names and indices.

    Raises:
        MadrobError: it is not names separated by dots with optional [index].
    """
    if not _PATH.fullmatch(path):
        raise MadrobError(f"{path!r} is no field: write names with dots, for example position[0]")
    return tuple(int(s) if s.isdigit() else s for s in _STEP.findall(path))


@dataclass(frozen=True, slots=True)
class MessageField:
    """A field that a type really has.

    Attributes:
        steps: names and indices that lead to it.
        numbers: whether it is a sequence of numbers rather than one number.
        owner: the nested type that holds the last name.
        base: the primitive type of the number or numbers.
    """

    steps: Steps
    numbers: bool
    owner: str
    base: str

    def sibling(self, name: str, types: MessageTypes) -> MessageField | None:
        """The number `name` beside this field; None if there is none."""
        last = max(i for i, step in enumerate(self.steps) if isinstance(step, str))
        field = types.fields(self.owner).get(name)
        if field is None or not _is_number(field):
            return None
        steps = (*self.steps[:last], name)
        return MessageField(steps, numbers=False, owner=self.owner, base=str(field[1][0]))


def find_field(types: MessageTypes, type_name: str, path: str) -> MessageField:
    """The field of a type at `path`.

    Raises:
        MessageError: the type is unknown, has no such field, or holds no numbers there.
        MadrobError: the path is malformed.
    """
    steps = parse_path(path)
    desc: FieldDesc = (Nodetype.NAME, type_name)
    owner = type_name
    for step in steps:
        if isinstance(step, int):
            if desc[0] not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                raise MessageError(f"{type_name} has no field {path}: [{step}] follows no array")
            inner, size = desc[1]
            if size and step >= size:
                raise MessageError(f"{type_name} has no field {path}: its array ends at {size - 1}")
            desc = inner
        else:
            if desc[0] != Nodetype.NAME:
                raise MessageError(
                    f"{type_name} has no field {path}: nothing is inside of the array"
                )
            owner = desc[1]
            known = types.fields(owner)
            if step not in known:
                raise MessageError(
                    f"{type_name} has no field {path}: {owner} holds {_listed(known)}"
                )
            desc = known[step]
    numbers = desc[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE)
    inner = desc[1][0] if desc[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else desc
    if inner[0] == Nodetype.BASE and _is_number(inner):
        return MessageField(steps, numbers, owner, base=inner[1][0])
    raise MessageError(f"{path} of {type_name} holds no numbers")


def find_stamp(types: MessageTypes, type_name: str) -> Getter | None:
    """A function from a message to its header's stamp; None where the type has no header.

    Raises:
        MessageError: the type is unknown.
    """
    header = types.fields(type_name).get("header")
    if header is None or header[1] != "std_msgs/msg/Header":
        return None
    return attrgetter("header.stamp")


def attribute(name: str) -> str:
    """A field's name in the message object: rosbags appends _ to Python's keywords."""
    return name + "_" if keyword.iskeyword(name) else name


def _is_number(field: FieldDesc) -> bool:
    return field[0] == Nodetype.BASE and field[1][0] not in ("string", "wstring")


def _listed(fields: dict[str, FieldDesc]) -> str:
    return ", ".join(fields) or "nothing"


def getter(steps: Steps) -> Getter:
    """A function from a message to what stands at `steps`.

    It raises IndexError where the message is shorter than an index.
    """
    parts: list[Getter] = []
    names: list[str] = []
    for step in steps:
        if isinstance(step, str):
            names.append(attribute(step))
            continue
        if names:
            parts.append(attrgetter(".".join(names)))
            names = []
        parts.append(itemgetter(step))
    if names:
        parts.append(attrgetter(".".join(names)))
    return _chained(parts)


def _chained(parts: list[Getter]) -> Getter:
    first, *rest = parts
    for part in rest:
        first = _then(first, part)
    return first


def _then(first: Getter, second: Getter) -> Getter:
    return lambda message: second(first(message))
