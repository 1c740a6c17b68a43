"""The fields of a message, by their paths."""

from __future__ import annotations

import keyword
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rosbags.interfaces import Nodetype

from madrob_console.messages.mapping import NamedElement, Steps, parse_path
from madrob_console.messages.types import Message, MessageError, MessageTypes, element, is_array

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc


@dataclass(frozen=True, slots=True)
class MessageField:
    """A field that a type really has.

    Attributes:
        steps: the way to it, or in each message of an array.
        numbers: whether it holds several.
        owner: the nested type that holds the last name.
        base: the primitive type of the number or numbers.
        messages: the way to the array of messages of each of which it is a field; None = it is a
            field of one.
    """

    steps: Steps
    numbers: bool
    owner: str
    base: str
    messages: Steps | None = None

    def sibling(self, name: str, types: MessageTypes) -> MessageField | None:
        """Return the number of this name beside it.

        None where the type has none.
        """
        field = types.fields(self.owner).get(name)
        if field is None or not _is_number(field):
            return None
        return replace(self, steps=self._beside(name), numbers=False, base=str(field[1][0]))

    def names(self, types: MessageTypes) -> Steps:
        """Return the way to the names of the elements, or empty if it is no element by index."""
        if isinstance(self.steps[-1], int) and _are_texts(types.fields(self.owner).get("name")):
            return self._beside("name")
        return ()

    def value(self, message: Message) -> Message:
        """Return its value, of an array of messages a list (see `value_at`)."""
        if self.messages is None:
            return value_at(message, self.steps)
        return [value_at(part, self.steps) for part in value_at(message, self.messages)]

    def _beside(self, name: str) -> Steps:
        last = max(i for i, step in enumerate(self.steps) if isinstance(step, str))
        return (*self.steps[:last], name)


def value_at(message: Message, steps: Steps) -> Message:
    """Return what is at `steps` in a message.

    It raises IndexError where an array is too short, ValueError where no element has the name.
    """
    holder = value = message
    for step in steps:
        if isinstance(step, str):
            holder, value = value, getattr(value, attribute(step))
        elif isinstance(step, int):
            value = value[step]
        else:
            value = value[getattr(holder, attribute(step.names)).index(step.value)]
    return value


def attribute(name: str) -> str:
    """Return a field's name in the message object: rosbags appends _ to Python's keywords."""
    return name + "_" if keyword.iskeyword(name) else name


def find_field(types: MessageTypes, type_name: str, path: str) -> MessageField:
    """Find the field at `path`.

    MadrobError where the path is malformed.

    Raises:
        MessageError: the type is unknown, has no such field, or holds no numbers there.
    """
    steps = parse_path(path)
    field: FieldDesc = (Nodetype.NAME, type_name)
    owner = type_name
    messages = None
    for number, step in enumerate(steps):
        if messages is None and isinstance(step, str) and _holds_messages(field):
            messages = steps[:number]
            field = element(field)
        if problem := _problem_of(step, field, owner, types):
            raise MessageError(f"{type_name} has no field {path}: {problem}")
        if isinstance(step, str):
            owner = str(field[1])
            field = types.fields(owner)[step]
        else:
            field = element(field)
    if not _is_number(element(field)) or (messages is not None and is_array(field)):
        raise MessageError(f"{path} of {type_name} holds no numbers")
    numbers = is_array(field) or messages is not None
    return MessageField(
        steps[len(messages or ()) :], numbers, owner, str(element(field)[1][0]), messages
    )


_HEADER = (Nodetype.NAME, "std_msgs/msg/Header")


def has_header(types: MessageTypes, type_name: str) -> bool:
    return types.fields(type_name).get("header") == _HEADER


def begins_with_header(types: MessageTypes, type_name: str) -> bool:
    return next(iter(types.fields(type_name).values()), None) == _HEADER


def _problem_of(
    step: str | int | NamedElement, field: FieldDesc, owner: str, types: MessageTypes
) -> str | None:
    """Return why the step does not lead on from a field of `owner`.

    None if it does.
    """
    if isinstance(step, str):
        if field[0] != Nodetype.NAME:
            return "nothing is inside of the array"
        known = types.fields(str(field[1]))
        return None if step in known else f"{field[1]} holds {', '.join(known)}"
    if not is_array(field):
        return f"[{step if isinstance(step, int) else '='.join(step)}] follows no array"
    if isinstance(step, int):
        size = int(field[1][1])
        return f"its array ends at {size - 1}" if 0 < size <= step else None
    names = types.fields(owner).get(step.names)
    return None if _are_texts(names) else f"{step.names} holds no names"


def _holds_messages(field: FieldDesc) -> bool:
    return is_array(field) and element(field)[0] == Nodetype.NAME


def _are_texts(field: FieldDesc | None) -> bool:
    return field is not None and is_array(field) and element(field)[1][0] == "string"


def _is_number(field: FieldDesc) -> bool:
    return field[0] == Nodetype.BASE and field[1][0] not in ("string", "wstring")
