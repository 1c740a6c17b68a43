"""The screens' end of the socket: an `EngineClient` on an engine in another process."""

from __future__ import annotations

import itertools
import socket
import threading
import time
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path

import msgspec

from madrob_console.engine.shown import wire
from madrob_console.engine.shown.parts import Incoming
from madrob_console.engine.shown.requests import NO_ANSWER, Request, Role, T
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError

_ON_ITS_WAY = 0.5
"""The engine's own word that it gave a request up may come so much later, s."""

_GREETING_TIME = 10.0


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
        self._numbers = itertools.count(1)
        self._waiting: dict[int, Future[wire.Reply]] = {}
        self._lock = threading.Lock()
        self._failure: str | None = None
        self._incoming = Incoming()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(_GREETING_TIME)
        try:
            self._socket.connect(str(path))
            self._send(wire.Hello(wire.VERSION, role, who))
            welcome, self._snapshot = self._greeted()
        except (TimeoutError, EOFError):
            self._socket.close()
            raise MadrobError("the engine does not answer: `madrob engine stop` ends it") from None
        except BaseException:
            self._socket.close()
            raise
        self.results = Path(welcome.results)
        self.pid = welcome.pid
        self._socket.settimeout(None)
        self._thread = threading.Thread(target=self._listen, name="engine-link", daemon=True)
        self._thread.start()

    def snapshot(self) -> Snapshot:
        """The latest snapshot.

        Raises:
            MadrobError: the connection is lost.
        """
        if self._failure is not None:
            raise MadrobError(self._failure)
        return self._snapshot

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

    def _greeted(self) -> tuple[wire.Welcome, Snapshot]:
        """What the engine says first."""
        welcome: wire.Welcome | None = None
        snapshot: Snapshot | None = None
        while welcome is None or snapshot is None:
            match self._receive():
                case wire.Welcome() as welcome:
                    pass
                case wire.State() as state:
                    snapshot = self._incoming.take(state)
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
                        self._snapshot = self._incoming.take(state) or self._snapshot
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
        return wire.message_of(self._exactly(length))

    def _exactly(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            part = self._socket.recv(min(size - len(data), 1 << 20))
            if not part:
                raise EOFError
            data += part
        return bytes(data)


_LOST = "the engine has ended: leave and start the console again, no recorded data are lost"
