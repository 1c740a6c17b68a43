"""The stamp of a message by its first bytes: a picture of 2 MB need not be read for it."""

from __future__ import annotations

import struct

from rosbags.interfaces import Nodetype

from madrob_console.messages.message_types import MessageTypes

HEAD = 12
"""The bytes in which it stands: four that say how the rest is encoded, seconds, nanoseconds."""

_CODES = {b"\x00\x00": struct.Struct(">iI"), b"\x00\x01": struct.Struct("<iI")}
_NS = 1_000_000_000


def begins_with_header(types: MessageTypes, type_name: str) -> bool:
    """Whether messages of a type begin with a header, so that `header_stamp` reads it.

    Raises:
        MessageError: the type is unknown.
    """
    first = next(iter(types.fields(type_name).values()), None)
    return first is not None and first == (Nodetype.NAME, "std_msgs/msg/Header")


def header_stamp(data: bytes) -> float | None:
    """The stamp of a message that begins with a header, s since the epoch; None = it has none.

    Args:
        data: its first `HEAD` bytes, or more.
    """
    code = _CODES.get(data[:2])
    if code is None or len(data) < HEAD:
        return None
    sec, nanosec = code.unpack_from(data, 4)
    if nanosec >= _NS or sec < 0 or (sec == 0 and nanosec == 0):  # the last: never set
        return None
    return float(sec + nanosec / _NS)
