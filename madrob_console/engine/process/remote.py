"""The screens' end of the socket: an `EngineClient` on an engine in another process."""

from __future__ import annotations

import itertools
import socket
import threading
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import msgspec

from madrob_console.engine.shown import wire
from madrob_console.engine.shown.client import Role
from madrob_console.engine.shown.curves import Curves
from madrob_console.engine.shown.playback import CONTROL, AnyCommand
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import ACTS, Act

ANSWER_TIMEOUT = 5.0
"""A screen waits this long for an answer, s."""

OPENING_TIMEOUT = 120.0
"""The same for the opening of an earlier run, whose bag is read."""

TAKE_OVER = "take over"
"""Its refusal stands among those of the acts."""

EXPORT = "export the team's runs"
"""The same."""

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
        self._waiting: dict[int, Future[wire.Answer]] = {}
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
            own = {**state.snapshot.refusals, TAKE_OVER: wire.ALONE}
            return replace(state.snapshot, refusals=own)
        refusals = dict.fromkeys((*(act.name for act in ACTS), CONTROL, EXPORT), refusal)
        if self._role is Role.WATCH:
            return replace(state.snapshot, refusals={**refusals, TAKE_OVER: refusal})
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

    def act(self, act: Act) -> str | None:
        """Hand in an act; returns the refusal in words, None when it took effect.

        Raises:
            MadrobError: the engine has ended or does not answer.
        """
        details: dict[str, object] = msgspec.to_builtins(act)
        return self._ask(wire.ActRequest(next(self._numbers), act.name, details)).refused

    def next_run_number(self, subject: int, condition_number: int) -> int:
        """The next run number that was never used for this subject and condition.

        Raises:
            MadrobError: the results folder cannot be read, or all numbers are used.
        """
        request = wire.NextRunNumber(next(self._numbers), subject, condition_number)
        value = self._ask(request).value
        if value is None:
            raise MadrobError("the engine gave no run number")
        return value

    def open_run(self, folder: str, *, invalid: bool = False) -> str | None:
        """Show an earlier run; takes as long as reading its bag.

        Raises:
            MadrobError: it cannot be read, or the engine has ended.
        """
        request = wire.OpenRun(next(self._numbers), folder, invalid)
        return self._ask(request, OPENING_TIMEOUT).refused

    def export_team(self, subject: int) -> str | None:
        """Pack a team's runs; returns why not, None when it is on its way.

        Raises:
            MadrobError: the engine has ended or does not answer.
        """
        return self._ask(wire.ExportTeam(next(self._numbers), subject)).refused

    def curves(self) -> Curves | None:
        """What the figures show of the run with a result; None without one.

        Raises:
            MadrobError: the engine has ended or does not answer.
        """
        return self._ask(wire.GiveCurves(next(self._numbers))).curves

    def control(self, command: AnyCommand) -> str | None:
        """Pause, step or move a replay; returns why not.

        Raises:
            MadrobError: the engine has ended or does not answer.
        """
        return self._ask(wire.Control(next(self._numbers), command)).refused

    def take_over(self) -> str | None:
        """Take the right to act from another screen; returns why not.

        Raises:
            MadrobError: the engine has ended or does not answer.
        """
        return self._ask(wire.TakeOver(next(self._numbers))).refused

    def stop_engine(self, *, force: bool) -> str | None:
        """End the engine; returns why not.

        Raises:
            MadrobError: the engine has ended or does not answer.
        """
        return self._ask(wire.StopEngine(next(self._numbers), force)).refused

    def close(self) -> None:
        """End the connection; the engine goes on."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()

    # ------------------------------------------------------------------ the socket

    def _ask(self, request: wire.Request, timeout: float = ANSWER_TIMEOUT) -> wire.Answer:
        if self._failure is not None:
            raise MadrobError(self._failure)
        waiting: Future[wire.Answer] = Future()
        self._waiting[request.number] = waiting
        try:
            self._send(request)
            answer = waiting.result(timeout)
        except TimeoutError:
            raise MadrobError("the engine does not answer: look at the disk") from None
        except OSError:
            raise MadrobError(_LOST) from None
        finally:
            self._waiting.pop(request.number, None)
        if answer.failed is not None:
            raise MadrobError(answer.failed)
        return answer

    def _send(self, message: msgspec.Struct) -> None:
        with self._lock:
            self._socket.sendall(wire.frame(message))

    def _listen(self) -> None:
        try:
            while True:
                match self._receive():
                    case wire.State() as state:
                        self._state = state
                    case wire.Answer() as answer:
                        if (waiting := self._waiting.get(answer.number)) is not None:
                            waiting.set_result(answer)
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
