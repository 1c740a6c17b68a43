"""What screens and engine say to each other: frames of msgpack on a Unix socket."""

from __future__ import annotations

import asyncio
import struct
from enum import StrEnum
from typing import Any

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.engine.snapshot import (
    DoorView,
    HandleView,
    LatchView,
    SensorView,
    TopicView,
)
from madrob_console.referee.run import Run
from scoring.procedure import StepRecord
from scoring.protocol import Event

LARGEST = 16_000_000
"""Bytes of a frame.

Longer ones end the connection.
"""

_LENGTH = struct.Struct(">I")


class Role(StrEnum):
    """What a screen is for."""

    REFEREE = "referee"
    WATCH = "watch"


class Hello(msgspec.Struct, frozen=True, tag=True):
    """The first words of a screen."""

    role: Role
    who: str


class Perform(msgspec.Struct, frozen=True, tag=True):
    """Do an act.

    Its `id` is the screen's, and a second one with it is answered like the first.

    What has not begun by the `deadline` (monotonic s) never happens.
    """

    number: int
    deadline: float
    name: str
    details: dict[str, Any]
    id: str


class TakeOver(msgspec.Struct, frozen=True, tag=True):
    """Give this screen the right to act."""

    number: int


class Answer(msgspec.Struct, frozen=True, tag=True):
    """Why a request was refused, in words.

    None = it is done.
    """

    number: int
    refusal: str | None


class State(msgspec.Struct, frozen=True, tag=True):
    """What a screen shows.

    `holder` has the right to act.

    Times are s since the epoch. `result` has the values of the indicators, None without one.
    """

    time: float
    holder: str
    run: Run
    pending: str
    refusals: dict[str, str]
    steps: tuple[StepRecord, ...]
    provisional: dict[str, float]
    events: tuple[Event, ...]
    door: DoorView
    handle: HandleView
    latch: LatchView
    passage: tuple[SensorView, ...]
    topics: tuple[TopicView, ...]
    log: tuple[str, ...]
    result: dict[str, float | None] | None
    problems: tuple[str, ...]


class Rejected(msgspec.Struct, frozen=True, tag=True):
    """Why a screen is not attached."""

    reason: str


Message = Hello | Perform | TakeOver | Answer | State | Rejected

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Message)


def frame(message: Message) -> bytes:
    """Return a message as it crosses the socket."""
    data = _encoder.encode(message)
    return _LENGTH.pack(len(data)) + data


async def receive(reader: asyncio.StreamReader) -> Message:
    """Return the next message.

    Raises:
        asyncio.IncompleteReadError, OSError: the other side has gone.
        MadrobError: it speaks another language.
    """
    (length,) = _LENGTH.unpack(await reader.readexactly(_LENGTH.size))
    if length > LARGEST:
        raise MadrobError(f"a message of {length} bytes is too long")
    data = await reader.readexactly(length)
    try:
        return _decoder.decode(data)
    except msgspec.MsgspecError as error:
        raise MadrobError(f"no message of an engine: {error}") from None
