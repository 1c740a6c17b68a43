"""What crosses the socket between an engine and others of its user, and the client of a screen.

A frame is four bytes of length, big-endian, and one message in MessagePack. The form of the first
message never changes: a screen's `Hello`, `Who` or `Stop`. To `Who` and `Stop` an engine of any
version answers and hangs up; to a `Hello` of another version it says so and hangs up. Then it sends
a `State` when something has changed, as fast as the screen takes it, and one `Reply` for each
`Call`. Everything is checked against its type on arrival.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError, InvalidStateError
from contextlib import suppress
from os import fspath
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, Union, get_args

import msgspec
from msgspec.structs import replace

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.requests import NO_ANSWER, UNSURE, Request, Role
from madrob_console.referee.journal import Origin

if TYPE_CHECKING:
    import socket
    from concurrent.futures import Future
    from pathlib import Path

    from madrob_console.engine.requests import T
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.referee.run import Run

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

    def begin_request(self, request: Request[T]) -> Future[T]:
        """Have a request carried out; never waits.

        A cancelled request never takes effect; one that has begun cannot be cancelled.
        """

    def send_request(self, request: Request[T]) -> T:
        """Have a request carried out; waits no longer than its timeout."""

    def close(self) -> None:
        """End the connection; an engine in this process ends with it."""


class ServedEngine(Protocol):
    """The engine behind the socket; see `LocalEngine`."""

    @property
    def results(self) -> Path: ...

    @property
    def busy(self) -> bool: ...

    @property
    def unsaved(self) -> bool: ...

    @property
    def not_on_disk(self) -> Sequence[str]: ...

    def snapshot(self) -> Snapshot: ...

    def begin_request(
        self,
        request: Request[T],
        deadline: float | None = None,
        *,
        first: bool = True,
        origin: Origin = Origin.REFEREE,
    ) -> Future[T]: ...


def begun(answer: Future[Any]) -> bool:
    if not answer.done():
        with suppress(RuntimeError):  # it has failed just now
            return answer.set_running_or_notify_cancel()
    return False


def fail(answer: Future[Any], why: MadrobError | str) -> None:
    with suppress(InvalidStateError):
        answer.set_exception(MadrobError(why) if isinstance(why, str) else why)


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


VERSION = 18
"""Version of this protocol; raised with every change that an older side would not understand."""

LARGEST_REQUEST = 1_000_000
"""Bytes that an engine takes from a screen at once."""

LARGEST_STATE = 64_000_000
"""Bytes that a screen takes from an engine at once; the curves of a long run are the most."""

LENGTH = struct.Struct(">I")
"""The start of a frame: its length."""

ENDING = "ending"
"""The phase of an engine that lets its screens go and closes its files."""

# The first message and what answers it. Fields may be added with a default; none may go or mean
# something else, and whoever reads passes over what it does not know.


class Hello(msgspec.Struct, frozen=True, tag=True):
    """A screen attaches: its protocol version, role and name for people."""

    version: int
    role: Role
    who: str


class Who(msgspec.Struct, frozen=True, tag=True):
    """Who are you? Answered by a `WhoAnswer`."""


class Stop(msgspec.Struct, frozen=True, tag=True):
    """End, with `force` even while a run goes on or screens are attached: a `StopAnswer`."""

    force: bool = False


class Rejected(msgspec.Struct, frozen=True, tag=True):
    """The engine hangs up, and why; `again`: it starts or ends, ask again in a moment."""

    reason: str
    again: bool = False


class WhoAnswer(msgspec.Struct, frozen=True, tag=True):
    """What an engine says of itself.

    Attributes:
        version: of the software.
        wire: the version of the protocol that it speaks with screens; 0 = it takes none.
        testbed: for people, such as `LIVE ros domain 0`.
        results: where it keeps the runs; empty if it keeps none.
        phase: of the current run, or `starting`, `failed`, `ending`.
        run: the current run, for people.
        busy: whether a run goes on or is still being recorded.
        console: the options with which a console attaches to it.
        unsaved: whether anything of a run is in its memory alone.
    """

    version: str = ""
    wire: int = 0
    testbed: str = ""
    results: str = ""
    phase: str = "starting"
    run: str = ""
    busy: bool = False
    screens: int = 0
    console: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    unsaved: bool = False

    def with_run(self, run: Run, *, busy: bool, unsaved: bool = False) -> WhoAnswer:
        return replace(self, phase=run.phase.value, run=run_title(run), busy=busy, unsaved=unsaved)

    @property
    def against_stopping(self) -> str:
        """Why a stop needs `force`, in words; empty = it does not."""
        reasons = []
        if self.busy:
            reasons.append("a run is going on")
        if self.unsaved:
            reasons.append("a run is NOT ON DISK yet")
        if self.screens:
            one = self.screens == 1
            reasons.append(
                "a screen is attached" if one else f"{self.screens} screens are attached"
            )
        return ", ".join(reasons)


class StopAnswer(msgspec.Struct, frozen=True, tag=True):
    """The engine ends, unless it is `refused` in words."""

    refused: str = ""


def run_title(run: Run) -> str:
    setup = run.setup
    return "" if setup is None else f"run {setup.run_number} of subject {setup.subject}"


# What follows between a screen and an engine of the same version.


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
