"""The screens' end of the socket, and the state that crosses it part by part."""

from __future__ import annotations

import itertools
import os
import select
import socket
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.engine import wire
from madrob_console.engine.disk import PriorityQueue
from madrob_console.engine.engine_lock import peer_of
from madrob_console.engine.engine_thread import begun, fail
from madrob_console.engine.requests import NO_ANSWER, Request, Role, T
from madrob_console.engine.snapshot import Snapshot
from madrob_console.engine.wire import ON_ITS_WAY, awaited

# The state in parts: each is encoded once, when it has changed.
#
# A part is a field of `Snapshot`. The log and the result, which are most of the state, cross only
# when they have changed. An idle engine sends a sign of life.


SIGN_OF_LIFE = 0.5
"""How often an engine without news sends its time, s; its pulse says if its core stands still."""

OWN = "right"
"""The part that differs by screen: it crosses beside the others."""

_NAMES = tuple(field.name for field in fields(Snapshot))
_SHARED = tuple(name for name in _NAMES if name != OWN)


class Outgoing:
    """News of the engine's state, for screens that saw different versions last."""

    def __init__(self) -> None:
        self.version = 0
        self._sent: Snapshot | None = None
        self._sent_at = 0.0
        self._parts: dict[str, tuple[int, msgspec.Raw]] = {}
        self._frames: dict[int, bytes] = {}

    def show(self, snapshot: Snapshot, now: float) -> None:
        """Take the engine's latest snapshot; `now` is s of a monotonic clock."""
        sent = self._sent
        new = [
            name
            for name in _SHARED
            if sent is None or getattr(snapshot, name) != getattr(sent, name)
        ]
        if new in ([], ["time"]) and now - self._sent_at < SIGN_OF_LIFE:
            return
        self.version += 1
        for name in new:
            self._parts[name] = (self.version, wire.raw(getattr(snapshot, name)))
        self._frames.clear()
        self._sent, self._sent_at = snapshot, now

    def since(self, version: int) -> bytes:
        """What is new since a version, encoded; everything since version 0."""
        if version not in self._frames:
            new = {name: raw for name, (since, raw) in self._parts.items() if since > version}
            self._frames[version] = wire.frame(wire.State(new))
        return self._frames[version]


class Incoming:
    """The state as it has arrived so far."""

    def __init__(self) -> None:
        self._parts: dict[str, Any] = {}

    def apply_state(self, state: wire.State) -> Snapshot | None:
        """The updated state; None while parts of the first one are missing."""
        for name, raw in state.parts.items():
            if name not in _NAMES:
                raise MadrobError("not a message of an engine: an unknown part of its state")
            self._parts[name] = wire.decoded(_decoders()[name], raw, "a message of an engine")
        return Snapshot(**self._parts) if len(self._parts) == len(_NAMES) else None


@cache
def _decoders() -> Mapping[str, msgspec.msgpack.Decoder[Any]]:
    types = get_type_hints(Snapshot)
    return {name: msgspec.msgpack.Decoder(types[name]) for name in _NAMES}


_GREETING_TIME = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """A request and its future answer; the engine begins it before `deadline` (monotonic s)."""

    number: int
    request: Request[Any]
    deadline: float
    answer: Future[Any]

    def call(self) -> wire.Call | None:
        if time.monotonic() > self.deadline:
            fail(self.answer, NO_ANSWER)
        if not begun(self.answer):
            return None
        return wire.Call(self.number, self.deadline, wire.raw(self.request))

    def take(self, reply: wire.Reply) -> None:
        try:
            value = wire.answer_of(self.request, reply)
        except MadrobError as error:
            fail(self.answer, error)
        else:
            with suppress(InvalidStateError):
                self.answer.set_result(value)


class RemoteEngine:
    """A connection to an engine; an `EngineClient`.

    `who` is this screen's name at other screens. `pid` is the engine's process, if known:
    another process may have taken its socket.

    Raises:
        MadrobError: the engine rejects this screen, or does not speak.
        OSError: there is no engine.
    """

    def __init__(self, path: Path, role: Role, who: str, pid: int = 0) -> None:
        self._numbers = itertools.count(1)
        self._asked: dict[int, _Asked] = {}
        self._outbox: PriorityQueue[_Asked] = PriorityQueue()
        self._failure: str | None = None
        self._lost, self._again = _LOST[role], _AGAIN[role]
        self._incoming = Incoming()
        self._process: int | None = None
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(_GREETING_TIME)
        try:
            self._socket.connect(str(path))
            _refuse_strangers(self._socket, pid)
            self._socket.sendall(wire.frame(wire.Hello(wire.VERSION, role, who)))
            welcome, self._snapshot = self._greeted()
        except (TimeoutError, EOFError):
            self._socket.close()
            raise MadrobError("the engine does not answer: `madrob engine stop` ends it") from None
        except BaseException:
            self._socket.close()
            raise
        self.results = Path(welcome.results)
        self.pid = welcome.pid
        if (peer := peer_of(self._socket).pid) not in (0, os.getpid()):
            with suppress(OSError):
                self._process = os.pidfd_open(peer)
        self._socket.settimeout(None)
        self._threads = [
            threading.Thread(target=work, name=name, daemon=True)
            for work, name in ((self._listen, "engine-link"), (self._speak, "engine-link-out"))
        ]
        for thread in self._threads:
            thread.start()

    def snapshot(self) -> Snapshot:
        if self._failure is not None:
            raise MadrobError(
                _ENDS if self._failure == self._lost and self._goes_on else self._failure
            )
        return self._snapshot

    @property
    def _goes_on(self) -> bool:
        """Whether the engine's process still exists: a disk may hold it up while closing."""
        if self._process is None:
            return False
        poll = select.poll()
        poll.register(self._process, select.POLLIN)
        return not poll.poll(0)

    def begin_request(self, request: Request[T]) -> Future[T]:
        deadline = time.monotonic() + request.latest_begin
        asked = _Asked(next(self._numbers), request, deadline, Future[T]())
        self._asked[asked.number] = asked
        if self._failure is not None:  # only now: what fails later finds who waits
            fail(asked.answer, self._failure)
        self._outbox.put_item(asked, first=request.urgent)
        return asked.answer

    def send_request(self, request: Request[T]) -> T:
        """Have a request carried out by the engine.

        Raises:
            UnsureError: no answer came, though the engine may have begun.
        """
        return awaited(self.begin_request(request), request.timeout + ON_ITS_WAY)

    def close(self) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._outbox.close()
        for thread in self._threads:
            thread.join()
        self._socket.close()
        if self._process is not None:
            os.close(self._process)
            self._process = None

    # ------------------------------------------------------------------ the socket

    def _speak(self) -> None:
        """Send the requests, except those given up before: they never reach the engine."""
        try:
            while (asked := self._outbox.next()) is not None:
                if (call := asked.call()) is not None:
                    self._socket.sendall(wire.frame(call))
                else:
                    self._asked.pop(asked.number, None)
        except OSError:
            pass  # the other thread sees it, too
        except Exception as error:  # noqa: BLE001 - a screen that can ask nothing has to know
            self._failure = self._failed(error)
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def _greeted(self) -> tuple[wire.Welcome, Snapshot]:
        welcome: wire.Welcome | None = None
        snapshot: Snapshot | None = None
        while welcome is None or snapshot is None:
            match self._receive():
                case wire.Welcome() as welcome:
                    pass
                case wire.State() as state:
                    snapshot = self._incoming.apply_state(state)
                case wire.Rejected(reason):
                    raise MadrobError(reason)
                case wire.Reply():
                    raise MadrobError("the engine speaks another language")
        return welcome, snapshot

    def _listen(self) -> None:
        try:
            while True:
                match self._receive():
                    case wire.State() as state:
                        self._snapshot = self._incoming.apply_state(state) or self._snapshot
                    case wire.Reply() as reply:
                        if (asked := self._asked.pop(reply.number, None)) is not None:
                            asked.take(reply)
                    case wire.Rejected(reason):
                        self._failure = reason
                        return
        except (OSError, EOFError):
            self._failure = self._failure or self._lost
        except MadrobError as error:
            self._failure = str(error)
        except Exception as error:  # noqa: BLE001 - a screen that stands still has to know
            self._failure = self._failed(error)
        finally:
            for asked in list(self._asked.values()):
                fail(asked.answer, self._failure or self._lost)

    def _failed(self, error: Exception) -> str:
        why = str(error) or type(error).__name__
        return f"the connection to the engine has failed ({why}): {self._again}"

    def _receive(self) -> wire.ToScreen:
        (length,) = wire.LENGTH.unpack(self._exactly(wire.LENGTH.size))
        if length > wire.LARGEST_STATE:
            raise MadrobError(f"a message of {length} bytes is too long")
        return wire.message_of(self._exactly(length))

    def _exactly(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            part = self._socket.recv(min(size - len(data), 1 << 20))
            if not part:
                raise EOFError
            data += part
        return bytes(data)


_ENDS = "the engine is ending: it closes its files, which a disk may hold up"
_LOST = {
    Role.REFEREE: (
        "the engine has ended: Ctrl+R starts it again; at most half a second of a recording is lost"
    ),
    Role.WATCH: "the engine has ended: what you see is old; the next one is looked for",
}
_AGAIN = {Role.REFEREE: "Ctrl+R connects again", Role.WATCH: "it is tried again"}


def _refuse_strangers(connection: socket.socket, pid: int) -> None:
    """Accept only an engine of this user, or of root."""
    peer = peer_of(connection)
    if peer.user not in (os.getuid(), 0):
        raise MadrobError("another user's process listens where the engine should")
    if pid and peer.pid != pid:
        raise ConnectionRefusedError
