"""The screens' end of the socket: an `EngineClient` on an engine in another process."""

from __future__ import annotations

import itertools
import socket
import threading
import time
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import msgspec

from madrob_console.engine.shown import wire
from madrob_console.engine.shown.playback import PlaybackCommand
from madrob_console.engine.shown.requests import (
    ALONE,
    NO_ANSWER,
    ExportTeam,
    Request,
    Role,
    T,
    TakeOver,
)
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import ACTS

_ON_ITS_WAY = 0.5
"""The engine's own word that it gave a request up may come so much later, s."""

_GREETING_TIME = 10.0
_WATCHING = "this screen only watches: `madrob console` can act"


class RemoteEngine:
    """A connection to an engine; an `EngineClient`.

    Args:
        path: the engine's socket.
        role: what for.
        who: this screen, for the people at the others.

    Attributes:
        results: where the engine keeps the runs.

    Raises:
        MadrobError: the engine rejects this screen, or does not speak.
        OSError: there is no engine.
    """

    def __init__(self, path: Path, role: Role, who: str) -> None:
        self._role = role
        self._numbers = itertools.count(1)
        self._waiting: dict[int, Future[wire.Reply]] = {}
        self._lock = threading.Lock()
        self._failure: str | None = None
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(_GREETING_TIME)
        try:
            self._socket.connect(str(path))
            self._send(wire.Hello(wire.VERSION, role, who))
            welcome, state = self._receive(), self._receive()
        except (TimeoutError, EOFError):
            self._socket.close()
            raise MadrobError("the engine does not answer: `madrob engine stop` ends it") from None
        except BaseException:
            self._socket.close()
            raise
        if not (isinstance(welcome, wire.Welcome) and isinstance(state, wire.State)):
            self._socket.close()
            raise MadrobError("the engine speaks another language")
        self.results = Path(welcome.results)
        self.pid = welcome.pid
        self._state = state
        self._socket.settimeout(None)
        self._thread = threading.Thread(target=self._listen, name="engine-link", daemon=True)
        self._thread.start()

    def snapshot(self) -> Snapshot:
        """The latest snapshot; where this screen may not act, every act is refused in it.

        Raises:
            MadrobError: the connection is lost.
        """
        if self._failure is not None:
            raise MadrobError(self._failure)
        state = self._state
        refusal = self._refusal(state)
        if refusal is None:
            own = {**state.snapshot.refusals, TakeOver.name: ALONE}
            return replace(state.snapshot, refusals=own)
        names = (*(act.name for act in ACTS), PlaybackCommand.name, ExportTeam.name)
        refusals = dict.fromkeys(names, refusal)
        if self._role is Role.WATCH:
            return replace(state.snapshot, refusals={**refusals, TakeOver.name: refusal})
        faults = (refusal, *state.snapshot.faults)
        return replace(state.snapshot, refusals=refusals, faults=faults)

    def _refusal(self, state: wire.State) -> str | None:
        if self._role is Role.WATCH:
            return _WATCHING
        if state.may_act or not state.referee:
            return None
        return f"{state.referee} has the right to act: t takes it over"

    @property
    def may_act(self) -> bool:
        """Whether this screen has the right to act, or would get it with its next act."""
        return self._refusal(self._state) is None

    def ask(self, request: Request[T]) -> T:
        """Have a request carried out by the engine.

        Raises:
            MadrobError: it failed, or the engine has ended or does not answer.
        """
        number, waiting = next(self._numbers), Future[wire.Reply]()
        call = wire.Call(number, time.monotonic() + request.timeout, wire.raw(request))
        self._waiting[number] = waiting
        try:
            if self._failure is not None:  # only now: what fails later finds who waits
                raise MadrobError(self._failure)
            self._send(call)
            return wire.answer_of(request, waiting.result(request.timeout + _ON_ITS_WAY))
        except TimeoutError:
            raise MadrobError(NO_ANSWER) from None
        except OSError:
            raise MadrobError(self._failure or _LOST) from None
        finally:
            del self._waiting[number]

    def close(self) -> None:
        """End the connection; the engine goes on."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()

    # ------------------------------------------------------------------ the socket

    def _send(self, message: msgspec.Struct) -> None:
        with self._lock:
            self._socket.sendall(wire.frame(message))

    def _listen(self) -> None:
        try:
            while True:
                match self._receive():
                    case wire.State() as state:
                        self._state = state
                    case wire.Reply() as reply:
                        if (waiting := self._waiting.get(reply.number)) is not None:
                            waiting.set_result(reply)
                    case wire.Rejected(reason):
                        self._failure = reason
                        return
        except (OSError, EOFError):
            self._failure = _LOST
        except MadrobError as error:
            self._failure = str(error)
        finally:
            for waiting in list(self._waiting.values()):
                if not waiting.done():
                    waiting.set_exception(MadrobError(self._failure or _LOST))

    def _receive(self) -> wire.ToScreen:
        (length,) = wire.LENGTH.unpack(self._exactly(wire.LENGTH.size))
        if length > wire.LARGEST_STATE:
            raise MadrobError(f"a message of {length} bytes is too long")
        message = wire.message_of(self._exactly(length))
        if isinstance(message, wire.Rejected) and not hasattr(self, "_state"):
            raise MadrobError(message.reason)
        return message

    def _exactly(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            part = self._socket.recv(min(size - len(data), 1 << 20))
            if not part:
                raise EOFError
            data += part
        return bytes(data)


_LOST = "the engine has ended: leave and start the console again, no recorded data are lost"
