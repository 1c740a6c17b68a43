"""Who are you, and stop: the part of the protocol that all versions share. It never changes.

One line of JSON each way over a Unix socket, in UTF-8, of at most `LONGEST_LINE` bytes, then the
engine hangs up. `{"ask": "who"}` is answered by the fields of `WhoAnswer`, and
`{"ask": "stop", "force": false}` by those of `StopAnswer`. Fields may be added, none may go or mean
something else; who reads ignores what it does not know and takes the default for what is missing.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import msgspec
from msgspec.structs import replace

from madrob_console.common.errors import MadrobError
from madrob_console.engine.engine_lock import Peer, address_of, holder_of, peer_of
from madrob_console.referee.run import Run

LONGEST_LINE = 65536
"""Bytes of a question or an answer."""

PATIENCE = 2.0
"""An engine without an answer for this long is silent, s."""

ENDING = "ending"
"""The phase of an engine that lets its screens go and closes its files."""

_ITS_TIME = 0.5
"""Time of a caller to send its question, s."""


class Inquiry(msgspec.Struct, frozen=True):
    """A question: `ask` is `who` or `stop`.

    A stop with `force` works even while a run goes on or screens are attached.
    """

    ask: str = ""
    force: bool = False


class WhoAnswer(msgspec.Struct, frozen=True):
    """What an engine says of itself.

    Attributes:
        wire: the version of the protocol that it speaks with screens.
        testbed: for people, such as `LIVE ros domain 0`.
        kind: of its testbed: `ros`, `simulated`, `replay`.
        results: where it keeps the runs; empty if it keeps none.
        socket: where screens attach; empty if nowhere, or not yet.
        started: s since the epoch.
        phase: of the current run, or `starting`, `failed`, `ending`.
        run: the current run, for people.
        busy: whether a run goes on or is still being recorded.
        console: the options with which a console attaches to it.
        unsaved: whether anything of a run is in its memory alone.
    """

    pid: int = 0
    version: str = ""
    wire: int = 0
    testbed: str = ""
    kind: str = ""
    domain: int | None = None
    results: str = ""
    socket: str = ""
    started: float = 0.0
    phase: str = "starting"
    run: str = ""
    busy: bool = False
    screens: int = 0
    console: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    unsaved: bool = False

    def with_run(self, run: Run, *, busy: bool, unsaved: bool = False) -> WhoAnswer:
        setup = run.setup
        words = "" if setup is None else f"run {setup.run_number} of subject {setup.subject}"
        return replace(self, phase=run.phase.value, run=words, busy=busy, unsaved=unsaved)

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


class StopAnswer(msgspec.Struct, frozen=True):
    """Whether the engine ends; else why not, in words."""

    ends: bool = False
    refused: str = ""


class ControlPort:
    """Answers the shared part of the protocol, in a thread of its own that waits for nobody.

    Only the user who runs the engine, and root, gets an answer. If the stop is granted, the
    caller is told so and the process gets SIGTERM, as from anybody else who ends it in
    order. `listening` is closed by whoever made it; `describe` must not wait.
    """

    def __init__(
        self, listening: Sequence[socket.socket], describe: Callable[[], WhoAnswer]
    ) -> None:
        self.describe = describe
        self._listening = listening
        self._over = threading.Event()
        self._threads = [
            threading.Thread(target=self._listen, args=(one,), name="control", daemon=True)
            for one in listening
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._over.set()
        for one, thread in zip(self._listening, self._threads, strict=True):
            with socket.socket(socket.AF_UNIX) as wake, suppress(OSError):
                wake.setblocking(False)
                wake.connect(one.getsockname())
            thread.join()

    def _listen(self, listening: socket.socket) -> None:
        while not self._over.is_set():
            try:
                connection, _ = listening.accept()
            except OSError:  # no file handle is free: the next one may be luckier
                self._over.wait(_ITS_TIME)
                continue
            with connection, suppress(OSError, MemoryError, *_NO_LINE):
                self._attend(connection)

    def _attend(self, connection: socket.socket) -> None:
        if peer_of(connection).user not in (os.getuid(), 0):
            return
        question = _INQUIRIES.decode(_line(connection, _ITS_TIME))
        presence = self._presence()
        match question.ask:
            case "who":
                _say(connection, presence)
            case "stop" if presence.against_stopping and not question.force:
                _say(connection, StopAnswer(refused=presence.against_stopping))
            case "stop":
                _say(connection, StopAnswer(ends=True))
                os.kill(os.getpid(), signal.SIGTERM)
            case _:
                _say(connection, StopAnswer(refused="this engine knows who and stop"))

    def _presence(self) -> WhoAnswer:
        try:
            return self.describe()
        except Exception as error:  # noqa: BLE001  whatever has failed: one can still be told, and stop it
            return WhoAnswer(os.getpid(), phase="failed", run=str(error))


@dataclass(frozen=True, slots=True)
class Heard:
    """The process that listens, and its answer; an empty line = it is silent."""

    peer: Peer
    line: bytes


def ask_owner(name: str, question: Inquiry, patience: float = PATIENCE) -> Heard | None:
    """Ask the process that has a name of this user; waits `patience` s at most.

    Raises:
        MadrobError: another user's process listens there.
    """
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(patience)
        try:
            connection.connect(address_of(name))
        except (BlockingIOError, TimeoutError):  # its backlog is full: it has hung for long
            return Heard(_no_stranger(holder_of(name), name), b"")
        except OSError:
            return None
        peer = _no_stranger(peer_of(connection), name)
        try:
            _say(connection, question)
            line = _line(connection, patience)
        except TimeoutError:
            return Heard(peer, b"")
        except OSError:
            return None  # it has just ended
        return Heard(peer, line) if line else None


def _no_stranger(peer: Peer, name: str) -> Peer:
    if peer.user == os.getuid():
        return peer
    if peer.pid:
        who = f"process {peer.pid} of another user ({peer.user})"
    else:
        who = "a process that cannot be seen from here"
    raise MadrobError(f"{who} has the name {name} of an engine of yours: have it ended")


def who_answer_in(line: bytes) -> WhoAnswer | None:
    try:
        return _WHO_ANSWERS.decode(line)
    except _NO_LINE:
        return None


def stop_answer_in(line: bytes) -> StopAnswer:
    try:
        return _STOP_ANSWERS.decode(line)
    except _NO_LINE:
        return StopAnswer()


_NO_LINE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)

_INQUIRIES = msgspec.json.Decoder(Inquiry)
_WHO_ANSWERS = msgspec.json.Decoder(WhoAnswer)
_STOP_ANSWERS = msgspec.json.Decoder(StopAnswer)


def _say(connection: socket.socket, what: msgspec.Struct) -> None:
    connection.sendall(msgspec.json.encode(what) + b"\n")


def _line(connection: socket.socket, patience: float) -> bytes:
    """The next line, or what came before the other side hung up; `TimeoutError` if late."""
    end = time.monotonic() + patience
    line = bytearray()
    while not line.endswith(b"\n") and len(line) <= LONGEST_LINE:
        connection.settimeout(max(1e-3, end - time.monotonic()))
        part = connection.recv(4096)
        if not part:
            break
        line += part
        if time.monotonic() > end:
            raise TimeoutError
    return bytes(line)
