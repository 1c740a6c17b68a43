"""What crosses the socket between an engine and its screens, and the client of a screen.

A frame is four bytes of length, big-endian, and one message in MessagePack. The first is the
screen's `Hello`; an engine of another version says so and hangs up. Then the engine sends a
`State` when something has changed, as fast as the screen takes it, and one `Reply` for each
`Call`. Everything is checked against its type on arrival.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, Union, get_args

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.requests import NO_ANSWER, UNSURE, Request, Role

if TYPE_CHECKING:
    from concurrent.futures import Future

    from madrob_console.engine.requests import T
    from madrob_console.engine.snapshot import Snapshot

# The client of a screen: its view of the engine.


ON_ITS_WAY = 0.5
"""Extra wait for the engine's own report that it gave a request up, s."""


class UnsureError(MadrobError):
    """No answer came to a request that may have begun: its effect is unknown."""


class EngineClient(Protocol):
    """A connection to an engine: in this process or in another one."""

    def snapshot(self) -> Snapshot:
        """The latest snapshot; always the same object while the engine is silent.

        Raises:
            MadrobError: the engine has failed or the connection is lost.
        """
        ...

    def begin_request(self, request: Request[T]) -> Future[T]:
        """Have a request carried out; never waits.

        A cancelled request never takes effect; one that has begun cannot be cancelled.
        """
        ...

    def send_request(self, request: Request[T]) -> T:
        """Have a request carried out; waits no longer than its timeout."""
        ...

    def close(self) -> None:
        """End the connection; an engine in this process ends with it."""
        ...


def awaited(answer: Future[T], patience: float) -> T:
    """The answer to a request, which is given up after `patience` s.

    Raises:
        UnsureError: it had begun.
        MadrobError: it failed, or was given up before it began.
    """
    try:
        return answer.result(patience)
    except CancelledError:
        raise MadrobError(NO_ANSWER) from None
    except TimeoutError:
        raise given_up(answer) from None


def given_up(answer: Future[T]) -> MadrobError:
    return MadrobError(NO_ANSWER) if answer.cancel() else UnsureError(UNSURE)


VERSION = 12
"""Version of this protocol; raised with every change that an older side would not understand."""

LARGEST_REQUEST = 1_000_000
"""Bytes that an engine takes from a screen at once."""

LARGEST_STATE = 64_000_000
"""Bytes that a screen takes from an engine at once; the curves of a long run are the most."""

LENGTH = struct.Struct(">I")
"""The start of a frame: its length."""


class Hello(msgspec.Struct, frozen=True, tag=True):
    """First message of a screen: its protocol version, role and name for people."""

    version: int
    role: Role
    who: str


class Call(msgspec.Struct, frozen=True, tag=True):
    """A request of a screen, as `call_of` reads it, under the screen's own number.

    It is not carried out after the `deadline`, s of the machine's monotonic clock.
    """

    number: int
    deadline: float
    request: msgspec.Raw


class Welcome(msgspec.Struct, frozen=True, tag=True):
    """First message of an engine: its process, testbed and results folder."""

    version: int
    pid: int
    label: str
    results: str


class Rejected(msgspec.Struct, frozen=True, tag=True):
    """The engine hangs up, and why."""

    reason: str


class State(msgspec.Struct, frozen=True, tag=True):
    """New parts of the state, by the name of their field of `Snapshot`.

    The first ones together are all of them.
    """

    parts: dict[str, msgspec.Raw]


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


ToScreen = Welcome | Rejected | State | Reply

_T = TypeVar("_T")


def _kinds(kind: type[Request[Any]] = Request) -> Iterator[type[Request[Any]]]:
    under = kind.__subclasses__()
    if not under:
        yield kind
    for one in under:
        yield from _kinds(one)


REQUESTS = tuple(_kinds())


def _answer_type(kind: type[Request[Any]]) -> object:
    bases = (base for one in kind.__mro__ for base in one.__dict__.get("__orig_bases__", ()))
    return get_args(next(bases))[0]


_MALFORMED = (msgspec.MsgspecError, ValueError, RecursionError)
_encoder = msgspec.msgpack.Encoder()
_hellos = msgspec.msgpack.Decoder(Hello)
_calls = msgspec.msgpack.Decoder(Call)
_requests: msgspec.msgpack.Decoder[Request[Any]] = msgspec.msgpack.Decoder(Union[REQUESTS])  # noqa: UP007
_answers = {kind: msgspec.msgpack.Decoder(_answer_type(kind)) for kind in REQUESTS}
_messages: msgspec.msgpack.Decoder[ToScreen] = msgspec.msgpack.Decoder(ToScreen)


def frame(message: msgspec.Struct) -> bytes:
    data = _encoder.encode(message)
    return LENGTH.pack(len(data)) + data


def raw(value: object) -> msgspec.Raw:
    return msgspec.Raw(_encoder.encode(value))


def hello_of(data: bytes) -> Hello:
    return decoded(_hellos, data, "a greeting of a console")


def call_of(data: bytes) -> tuple[Call, Request[Any]]:
    call = decoded(_calls, data, "a request of a console")
    return call, decoded(_requests, call.request, "a request of a console")


def message_of(data: bytes) -> ToScreen:
    return decoded(_messages, data, "a message of an engine")


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
