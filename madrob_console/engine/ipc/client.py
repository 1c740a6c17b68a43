"""The screens' end of the socket."""

from __future__ import annotations

import itertools
import socket
import threading
import time
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.engine.ipc import greeting, wire
from madrob_console.engine.ipc.engine_interface import ON_ITS_WAY, awaited, begun, fail
from madrob_console.engine.ipc.engine_sockets import connect_to, pid_of_peer
from madrob_console.engine.priority_queue import PriorityQueue
from madrob_console.engine.requests import NO_ANSWER, Request, Role, T
from madrob_console.engine.snapshot import RightToAct, Snapshot

GREETING_TIME = 5.0
"""An engine that does not greet a screen within this time is silent, s."""

_snapshots = msgspec.msgpack.Decoder(Snapshot)
_rights = msgspec.msgpack.Decoder(RightToAct)


def snapshot_of(state: wire.State) -> Snapshot:
    snapshot = wire.decoded(_snapshots, state.snapshot, "a message of an engine")
    return replace(snapshot, right=wire.decoded(_rights, state.right, "a message of an engine"))


class NotYetError(MadrobError):
    """The engine starts or ends: ask again in a moment."""


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
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
    """A connection to the engine of a testbed; an `EngineClient`.

    `stem` names the testbed, `who` this screen at other screens.

    Raises:
        NotYetError: it starts or ends.
        MadrobError: it rejects this screen.
        TimeoutError: it is silent.
        OSError: it has no engine of this user, or one that has just ended.
    """

    def __init__(self, stem: str, role: Role, who: str) -> None:
        self._numbers = itertools.count(1)
        self._pending: dict[int, _Waiting] = {}
        self._outbox: PriorityQueue[_Waiting] = PriorityQueue()
        self._failure: str | None = None
        self._lost, self._again = _LOST[role], _AGAIN[role]
        self._socket = connect_to(stem, GREETING_TIME)
        self.pid = pid_of_peer(self._socket)
        try:
            self._socket.sendall(wire.frame(greeting.Hello(wire.VERSION, role, who)))
            self.results, self._snapshot = self._greeted()
        except BaseException:
            self._socket.close()
            raise
        self._socket.settimeout(None)
        self._threads = [
            threading.Thread(target=work, name=name, daemon=True)
            for work, name in ((self._listen, "engine-link"), (self._speak, "engine-link-out"))
        ]
        for thread in self._threads:
            thread.start()

    def snapshot(self) -> Snapshot:
        if self._failure is not None:
            raise MadrobError(self._failure)
        return self._snapshot

    def begin_request(self, request: Request[T]) -> Future[T]:
        deadline = time.monotonic() + request.latest_begin
        waiting = _Waiting(next(self._numbers), request, deadline, Future[T]())
        self._pending[waiting.number] = waiting
        if self._failure is not None:  # only now: what fails later finds who waits
            fail(waiting.answer, self._failure)
        self._outbox.put_item(waiting, first=request.urgent)
        return waiting.answer

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

    # ------------------------------------------------------------------ the socket

    def _speak(self) -> None:
        """Send the requests, except those given up before: they never reach the engine."""
        try:
            while (waiting := self._outbox.next()) is not None:
                if (call := waiting.call()) is not None:
                    self._socket.sendall(wire.frame(call))
                else:
                    self._pending.pop(waiting.number, None)
        except OSError:
            pass  # the other thread sees it, too
        except Exception as error:  # noqa: BLE001 - a screen that can ask nothing has to know
            self._failure = self._failed(error)
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def _greeted(self) -> tuple[Path, Snapshot]:
        match wire.receive(self._socket):
            case wire.Welcome(results, state):
                return Path(results), snapshot_of(state)
            case greeting.Rejected(reason, again):
                raise (NotYetError if again else MadrobError)(reason)
            case _:
                raise MadrobError("the engine speaks another language")

    def _listen(self) -> None:
        try:
            while True:
                match wire.receive(self._socket):
                    case wire.State() as state:
                        self._snapshot = snapshot_of(state)
                    case wire.Reply() as reply:
                        if (waiting := self._pending.pop(reply.number, None)) is not None:
                            waiting.take(reply)
                    case greeting.Rejected(reason):
                        self._failure = reason
                        return
        except OSError:
            self._failure = self._failure or self._lost
        except MadrobError as error:
            self._failure = str(error)
        except Exception as error:  # noqa: BLE001 - a screen that stands still has to know
            self._failure = self._failed(error)
        finally:
            for waiting in list(self._pending.values()):
                fail(waiting.answer, self._failure or self._lost)

    def _failed(self, error: Exception) -> str:
        why = str(error) or type(error).__name__
        return f"the connection to the engine has failed ({why}): {self._again}"


_LOST = {
    Role.REFEREE: "the engine has ended: Ctrl+R starts it again",
    Role.WATCH: "the engine has ended: the next one is looked for",
}
_AGAIN = {Role.REFEREE: "Ctrl+R connects again", Role.WATCH: "it is tried again"}
