"""The fields of a message, by their paths."""

from __future__ import annotations

import keyword
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, TypeAlias

from rosbags.interfaces import Nodetype

from madrob_console.messages.message_types import Message, MessageError, MessageTypes, element
from madrob_console.messages.topic_mapping import NamedElement, Steps, parse_path

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc


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
