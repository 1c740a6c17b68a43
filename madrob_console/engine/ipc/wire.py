"""What crosses the socket between an engine and others of its user, and the client of a screen.

A frame is four bytes of length, big-endian, and one message in MessagePack. The form of the first
message never changes: a screen's `Hello`, `Who` or `Stop`. To `Who` and `Stop` an engine of any
version answers and hangs up; to a `Hello` of another version it says so and hangs up. Then it sends
a `State` when something has changed, as fast as the screen takes it, and one `Reply` for each
`Call`. Everything is checked against its type on arrival.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from os import fspath
from typing import TYPE_CHECKING, Any, TypeVar, Union, get_args

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.ipc.engine_interface import UnsureError
from madrob_console.engine.ipc.greeting import Hello, Rejected, Stop, StopAnswer, Who, WhoAnswer
from madrob_console.engine.playback import PlaybackCommand
from madrob_console.engine.requests import Request

if TYPE_CHECKING:
    import socket


VERSION = 19
"""Version of this protocol; raised with every change that an older side would not understand."""

LARGEST_REQUEST = 1_000_000
"""Bytes that an engine takes from a screen at once."""

LARGEST_STATE = 64_000_000
"""Bytes that a screen takes from an engine at once; the curves of a long run are the most."""

LENGTH = struct.Struct(">I")
"""The start of a frame: its length."""

ENDING = "ending"
"""The phase of an engine that lets its screens go and closes its files."""


class Call(msgspec.Struct, frozen=True, tag=True):
    """A request of a screen, as `call_of` reads it, under the screen's own number.

    It is not carried out after the `deadline`, s of the machine's monotonic clock.
    """

    number: int
    deadline: float
    request: msgspec.Raw


class State(msgspec.Struct, frozen=True, tag=True):
    """The whole state: a `Snapshot`, the same for all screens, and the screen's `RightToAct`."""

    snapshot: msgspec.Raw
    right: msgspec.Raw


class Welcome(msgspec.Struct, frozen=True, tag=True):
    """The engine takes a screen: its results folder and its state."""

    results: str
    state: State


_NIL = msgspec.Raw(msgspec.msgpack.encode(None))


class Reply(msgspec.Struct, frozen=True, tag=True):
    """The engine's answer, as `answer_of` reads it.

    `failed` says why there is none: the screen raises it. `unsure`: the request had begun,
    and its effect is unknown.
    """

    number: int
    value: msgspec.Raw = _NIL
    failed: str | None = None
    unsure: bool = False


First = Hello | Who | Stop
FromEngine = Welcome | Rejected | State | Reply | WhoAnswer | StopAnswer

_T = TypeVar("_T")


def _kinds(kind: type[Request[Any]]) -> Iterator[type[Request[Any]]]:
    under = kind.__subclasses__()
    if not under:
        yield kind
    for one in under:
        yield from _kinds(one)


REQUESTS = tuple(dict.fromkeys([*_kinds(Request), *_kinds(PlaybackCommand)]))


def _answer_type(kind: type[Request[Any]]) -> object:
    bases = (base for one in kind.__mro__ for base in one.__dict__.get("__orig_bases__", ()))
    return get_args(next(bases))[0]


_MALFORMED = (msgspec.MsgspecError, ValueError, RecursionError)
_encoder = msgspec.msgpack.Encoder(enc_hook=fspath)
_firsts: msgspec.msgpack.Decoder[First] = msgspec.msgpack.Decoder(First)
_calls = msgspec.msgpack.Decoder(Call)
_requests: msgspec.msgpack.Decoder[Request[Any]] = msgspec.msgpack.Decoder(Union[REQUESTS])  # noqa: UP007
_answers = {kind: msgspec.msgpack.Decoder(_answer_type(kind)) for kind in REQUESTS}
_messages: msgspec.msgpack.Decoder[FromEngine] = msgspec.msgpack.Decoder(FromEngine)


def frames(received: bytearray) -> Iterator[bytes]:
    """Whole frames; removes them from `received`."""
    while len(received) >= LENGTH.size:
        end = LENGTH.size + LENGTH.unpack_from(received)[0]
        if len(received) < end:
            return
        data = bytes(memoryview(received)[LENGTH.size : end])
        del received[:end]
        yield data


def frame(message: object) -> bytes:
    data = _encoder.encode(message)
    return LENGTH.pack(len(data)) + data


def raw(value: object) -> msgspec.Raw:
    return msgspec.Raw(_encoder.encode(value))


def first_of(data: bytes) -> First:
    return decoded(_firsts, data, "a greeting of a console")


def call_of(data: bytes) -> tuple[Call, Request[Any]]:
    call = decoded(_calls, data, "a request of a console")
    return call, decoded(_requests, call.request, "a request of a console")


def message_of(data: bytes) -> FromEngine:
    return decoded(_messages, data, "a message of an engine")


def receive(connection: socket.socket) -> FromEngine:
    """The next message of an engine.

    Raises:
        TimeoutError: nothing came for the timeout of the connection.
        OSError: it has hung up.
    """
    (length,) = LENGTH.unpack(_exactly(connection, LENGTH.size))
    if length > LARGEST_STATE:
        raise MadrobError(f"a message of {length} bytes is too long")
    return message_of(_exactly(connection, length))


def _exactly(connection: socket.socket, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        part = connection.recv(min(size - len(data), 1 << 20))
        if not part:
            raise ConnectionResetError
        data += part
    return bytes(data)


def answer_of(request: Request[_T], reply: Reply) -> _T:
    """The answer to a request.

    Raises:
        UnsureError: it had begun, and its effect is unknown.
    """
    if reply.failed is not None:
        raise (UnsureError if reply.unsure else MadrobError)(reply.failed)
    decoder: msgspec.msgpack.Decoder[_T] = _answers[type(request)]
    return decoded(decoder, reply.value, "an answer of an engine")


def decoded(
    decoder: msgspec.msgpack.Decoder[_T], data: bytes | memoryview | msgspec.Raw, what: str
) -> _T:
    """Decode a message or a part of one; raises `MadrobError` if it is not `what`."""
    try:
        return decoder.decode(data)
    except _MALFORMED as error:
        raise MadrobError(f"not {what}: {terminal_safe(str(error))}") from None
