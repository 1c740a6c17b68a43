"""What crosses the socket between an engine and its screens.

A frame is four bytes of length, big-endian, and one message in MessagePack. The first is the
screen's `Hello`; an engine of another version says so and hangs up. Then the engine sends `State`
whenever there is something new, as fast as the screen takes it, and one `Answer` for each request.
Everything is checked against its type on arrival.
"""

from __future__ import annotations

import struct
from typing import Any

import msgspec

from madrob_console.engine.shown.client import Role
from madrob_console.engine.shown.curves import Curves
from madrob_console.engine.shown.playback import AnyCommand
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe

VERSION = 3
"""Of this protocol; raised with every change that an older side would not understand."""

LARGEST_REQUEST = 1_000_000
"""Bytes that an engine takes from a screen at once."""

LARGEST_STATE = 64_000_000
"""Bytes that a screen takes from an engine at once; the curves of a long run are the most."""

ALONE = "this console has the right to act"
"""Why there is nothing to take over."""

LENGTH = struct.Struct(">I")
"""How a frame begins."""


class Hello(msgspec.Struct, frozen=True, tag=True):
    """A screen comes: which protocol it speaks, what for, and who it is, for people."""

    version: int
    role: Role
    who: str


class ActRequest(msgspec.Struct, frozen=True, tag=True):
    """Do an act of the referee: its name and its fields."""

    number: int
    name: str
    details: dict[str, Any]


class NextRunNumber(msgspec.Struct, frozen=True, tag=True):
    """Which run number comes next?"""

    number: int
    subject: int
    condition: int


class OpenRun(msgspec.Struct, frozen=True, tag=True):
    """Show an earlier run: the name of its folder; `invalid`: one that was cut off is void."""

    number: int
    folder: str
    invalid: bool = False


class ExportTeam(msgspec.Struct, frozen=True, tag=True):
    """Pack the runs of a team into a zip."""

    number: int
    subject: int


class GiveCurves(msgspec.Struct, frozen=True, tag=True):
    """What do the figures show?"""

    number: int


class TakeOver(msgspec.Struct, frozen=True, tag=True):
    """Give me the right to act."""

    number: int


class Control(msgspec.Struct, frozen=True, tag=True):
    """Pause, step or move a replay."""

    number: int
    command: AnyCommand


class StopEngine(msgspec.Struct, frozen=True, tag=True):
    """End the engine; `force` also while a run goes on."""

    number: int
    force: bool = False


Request = (
    ActRequest | NextRunNumber | OpenRun | ExportTeam | GiveCurves | TakeOver | Control | StopEngine
)


class Welcome(msgspec.Struct, frozen=True, tag=True):
    """The engine: its process, what it is connected to, where it keeps the runs."""

    version: int
    pid: int
    label: str
    results: str


class Rejected(msgspec.Struct, frozen=True, tag=True):
    """The engine hangs up, and why."""

    reason: str


class State(msgspec.Struct, frozen=True, tag=True):
    """The latest snapshot; whether this screen may act, and if not, who may."""

    snapshot: Snapshot
    may_act: bool
    referee: str


class Answer(msgspec.Struct, frozen=True, tag=True):
    """The answer to the request with this number.

    Attributes:
        number: of the request.
        refused: why not, in words; None = done.
        failed: the engine could not, in words: the screen raises it.
        value: the run number asked for.
        curves: those asked for.
    """

    number: int
    refused: str | None = None
    failed: str | None = None
    value: int | None = None
    curves: Curves | None = None


ToScreen = Welcome | Rejected | State | Answer

_MALFORMED = (msgspec.MsgspecError, ValueError, RecursionError)
_encoder = msgspec.msgpack.Encoder()
_requests: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)
_hellos = msgspec.msgpack.Decoder(Hello)
_states: msgspec.msgpack.Decoder[ToScreen] = msgspec.msgpack.Decoder(ToScreen)


def frame(message: msgspec.Struct) -> bytes:
    """A message as it crosses the socket."""
    data = _encoder.encode(message)
    return LENGTH.pack(len(data)) + data


def hello_of(data: bytes) -> Hello:
    """The first message of a screen.

    Raises:
        MadrobError: it is something else.
    """
    try:
        return _hellos.decode(data)
    except _MALFORMED as error:
        raise MadrobError(f"not a greeting of a console: {terminal_safe(str(error))}") from None


def request_of(data: bytes) -> Request:
    """A later message of a screen.

    Raises:
        MadrobError: it is something else.
    """
    try:
        return _requests.decode(data)
    except _MALFORMED as error:
        raise MadrobError(f"not a request of a console: {terminal_safe(str(error))}") from None


def message_of(data: bytes) -> ToScreen:
    """A message of an engine.

    Raises:
        MadrobError: it is something else.
    """
    try:
        return _states.decode(data)
    except _MALFORMED as error:
        raise MadrobError(f"not a message of an engine: {terminal_safe(str(error))}") from None
