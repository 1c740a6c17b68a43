"""How large a message of a type usually is at most: what is larger is not worth reading.

Reading takes time by what a message holds: 500,000 names, 4 MB, take 0.2 s. What decides about a
run may not wait for that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosbags.interfaces import Nodetype

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc

    from madrob_console.messages.message_types import MessageTypes

LONGEST_TEXT = 256
"""Bytes of a text without a bound of its own."""

MOST_NUMBERS = 4096
"""Numbers in an array without a bound of its own."""

MOST_PARTS = 32
"""Texts or messages in an array without a bound of its own."""

UNKNOWN_SIZE = 65536
"""Of a type that is not known yet, bytes."""

_HEAD = 4
_TAIL = 8
_LENGTH = 8  # the bytes that tell one, and those that align it
_SIZES = {"bool": 1, "byte": 1, "char": 1, "int8": 1, "uint8": 1, "octet": 1} | {
    f"{kind}{bits}": bits // 8 for kind in ("int", "uint", "float") for bits in (16, 32, 64)
}
_LARGEST_NUMBER = 16


def usual_size(types: MessageTypes, type_name: str) -> int:
    """At most so many CDR bytes has a message of a type, as testbeds use it.

    Exact, but for bytes that align and that DDS adds at the end, where the type bounds all that
    it holds.
    """
    if not types.knows(type_name):
        return UNKNOWN_SIZE
    return _HEAD + _message(types, type_name) + _TAIL


def _message(types: MessageTypes, type_name: str) -> int:
    return sum(_field(types, field) for field in types.fields(type_name).values())


def _field(types: MessageTypes, field: FieldDesc) -> int:
    if field[0] == Nodetype.NAME:
        return _message(types, field[1])
    if field[0] == Nodetype.BASE:
        name, bound = field[1]
        if name in ("string", "wstring"):
            return _LENGTH + (bound or LONGEST_TEXT) * (4 if name == "wstring" else 1) + 1
        return 2 * _SIZES.get(name, _LARGEST_NUMBER) - 1
    inner, count = field[1]
    head = 0 if field[0] == Nodetype.ARRAY else _LENGTH
    if inner[0] == Nodetype.BASE and inner[1][0] in _SIZES:
        size = _SIZES[inner[1][0]]
        return head + size - 1 + size * (count or MOST_NUMBERS)
    return head + _field(types, inner) * (count or MOST_PARTS)
