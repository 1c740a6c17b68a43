"""Finds and ends the engines of this user."""

from __future__ import annotations

import os
import select
import shlex
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import is_held
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.engine.ipc import greeting, wire
from madrob_console.engine.ipc.engine_lock import holder_in
from madrob_console.engine.ipc.engine_sockets import connect_to, state_folder

PATIENCE = 2.0
"""An engine without an answer for this long is silent, s."""


@dataclass(frozen=True, slots=True)
class FoundEngine:
    """The engine of a testbed.

    Attributes:
        stem: names the testbed, as in `Owned`.
        results: where it records; None = nowhere.
        since: when it began, s since the epoch.
        answer: what it says of itself; None = it is silent.
    """

    stem: str
    pid: int
    results: Path | None
    since: float
    answer: greeting.WhoAnswer | None

    @property
    def label(self) -> str:
        if self.answer is not None and self.answer.testbed:
            return terminal_safe(self.answer.testbed)
        if self.domain is not None:
            return f"LIVE ros domain {self.domain}"
        return f"{self.kind} testbed"

    @property
    def who(self) -> str:
        began = time.strftime("%Y-%m-%d %H:%M", time.localtime(self.since))
        return f"{self.label}, pid {self.pid}, since {began}"

    @property
    def kind(self) -> str:
        return self.stem.partition("_")[0]

    @property
    def domain(self) -> int | None:
        last = self.stem.rpartition("_")[2]
        return int(last) if self.kind == SourceKind.ROS and last.isdecimal() else None

    def attach_line(self, command: str = "console") -> str:
        if self.answer is None or not self.answer.console:
            return ""
        return terminal_safe(shlex.join(["madrob", command, *self.answer.console]))

    @property
    def end_words(self) -> str:
        return f"`{self.stop_line}` ends it"

    @property
    def stop_line(self) -> str:
        return f"madrob engine stop --pid {self.pid}"


def ask(stem: str, question: wire.First, patience: float = PATIENCE) -> wire.FromEngine | None:
    """Ask the engine of a testbed; None = there is none, or it has just ended.

    Raises:
        TimeoutError: it is silent.
        MadrobError: it answers something else.
    """
    try:
        with connect_to(stem, patience) as connection:
            connection.sendall(wire.frame(question))
            return wire.receive(connection)
    except TimeoutError:
        raise
    except OSError:
        return None


def find_engine(stem: str) -> FoundEngine | None:
    """The engine of a testbed, even if it is silent."""
    answer: wire.FromEngine | None = None
    with suppress(TimeoutError, MadrobError):
        if (answer := ask(stem, greeting.Who())) is None:
            return None
    return holder_of(stem, answer)


def holder_of(stem: str, answer: wire.FromEngine | None) -> FoundEngine | None:
    """The engine that holds the lock of a testbed: whoever else answers is none."""
    path = state_folder() / f"{stem}.lock"
    holder = holder_in(path)
    if not is_held(path) or not holder.pid:
        return None
    results = Path(holder.results) if holder.results else None
    description = answer if isinstance(answer, greeting.WhoAnswer) else None
    return FoundEngine(stem, holder.pid, results, holder.since, description)


def running_engines(besides: str = "") -> tuple[FoundEngine, ...]:
    """Every engine of this user but that of the testbed `besides`."""
    stems = sorted({path.stem for path in state_folder().glob("*.sock")} - {besides})
    with ThreadPoolExecutor() as pool:  # one that hangs holds up nobody else's answer
        return tuple(engine for engine in pool.map(find_engine, stems) if engine is not None)


@contextmanager
def process_of(engine: FoundEngine) -> Iterator[int]:
    """A handle of its process while inside: no other process can take its number.

    Raises:
        ProcessLookupError: it has ended meanwhile.
    """
    process = os.pidfd_open(engine.pid)
    try:
        now = holder_of(engine.stem, None)
        if now is None or now.pid != engine.pid:
            raise ProcessLookupError
        yield process
    finally:
        os.close(process)


def has_ended(process: int, patience: float = 0.0) -> bool:
    """Wait at most `patience` s for its end."""
    poll = select.poll()
    poll.register(process, select.POLLIN)
    return bool(poll.poll(1000 * patience))


def send_signals(process: int, *numbers: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        for number in numbers:
            signal.pidfd_send_signal(process, number)
