"""What other programs hear of the engine: systemd, ROS services, `/diagnostics`.

The service manager is told by datagrams (sd_notify(3)). The watchdog hears of the core: a core
that hangs is ended and started again; a disk that hangs is no reason.
"""

from __future__ import annotations

import asyncio
import faulthandler
import io
import os
import re
import socket
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import replace
from enum import IntEnum
from typing import TYPE_CHECKING, TextIO

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import RemoteService, terminal_safe
from madrob_console.engine.requests import NO_ANSWER, Perform
from madrob_console.engine.snapshot import Snapshot, TopicView
from madrob_console.engine.wire import EngineClient, given_up
from madrob_console.referee.acts import Abort, Act, DeclareTimeout, Start
from madrob_console.referee.checks import CheckState, Freshness
from madrob_console.referee.journal import Origin
from madrob_console.referee.records import CheckName
from madrob_console.testbeds.source import CallAnswer, Diagnosis, Level, LookForAnswer

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from madrob_console.engine.engine_thread import LocalEngine
    from madrob_console.referee.records import format_size

HANGING = 2
"""A core that has not moved for longer hangs, s: the watchdog gets no more signs of life."""

_PERIOD = 1.0
_LAST_WORDS = 0.5
"""Time to tell the screens that the engine has failed, s."""

_NUMBERED = re.compile(r"<[0-7]>")


class Priority(IntEnum):
    """Syslog priority of a line in the journal."""

    ERROR = 3
    WARNING = 4
    INFORMATION = 6


class ServiceManager:
    """The systemd that started this process, if `present`.

    It expects a sign of life of the core within `watchdog` s; None = it does not.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "").replace("@", "\0", 1)
        self.present = self._address.startswith(("/", "\0"))
        self.watchdog = _watchdog(environment) if self.present else None

    def send_assignments(self, *assignments: str) -> None:
        """Send `NAME=value` assignments; never waits, and needs no receiver."""
        if not self.present:
            return
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)
            sender.sendto("\n".join(assignments).encode(), self._address)


def _watchdog(environment: Mapping[str, str]) -> float | None:
    period = environment.get("WATCHDOG_USEC", "")
    whose = environment.get("WATCHDOG_PID", "")
    if not period.isdecimal() or int(period) == 0 or whose not in ("", str(os.getpid())):
        return None
    return int(period) / 1e6


async def keep_told(
    manager: ServiceManager,
    engine: EngineClient,
    words: Callable[[Snapshot], str],
    fail: Callable[[], None],
) -> None:
    """Report that the engine is ready, then its state in the log; until it fails."""
    manager.send_assignments("READY=1")
    period = _PERIOD if manager.watchdog is None else min(_PERIOD, manager.watchdog / 4)
    told = shown = ""
    while True:
        try:
            snapshot = engine.snapshot()
        except MadrobError as error:
            manager.send_assignments(f"STATUS={error}")
            await asyncio.sleep(_LAST_WORDS)
            fail()
            return
        news = []
        if snapshot.pulse.core <= HANGING:
            news.append("WATCHDOG=1")
        if (status := words(snapshot)) != told:
            told = status
            log(status, Priority.INFORMATION)
        status = terminal_safe("; ".join((status, *_faults(snapshot)[:1])))
        if status != shown:
            shown = status
            news.append(f"STATUS={status}")
        manager.send_assignments(*news)
        await asyncio.sleep(period)


def _faults(snapshot: Snapshot) -> list[str]:
    return [*filter(None, (snapshot.pulse.words,)), *snapshot.faults, *snapshot.topic_faults]


# ---------------------------------------------------------------------- lines in the journal


class PriorityLines(io.TextIOBase):
    """Puts a syslog priority before each line; `usual` if the line has none of its own."""

    def __init__(self, stream: TextIO, usual: Priority) -> None:
        self._stream = stream
        self._usual = usual
        self._begun = ""

    def write(self, text: str) -> int:
        *lines, self._begun = (self._begun + text).split("\n")
        for line in lines:
            own = _NUMBERED.match(line) is not None
            self._stream.write(f"{line}\n" if own else f"<{self._usual}>{line}\n")
        if lines:
            self._stream.flush()
        return len(text)

    def flush(self) -> None:
        if self._begun:
            self.write("\n")

    def fileno(self) -> int:
        return self._stream.fileno()


def log_to_journal(environment: Mapping[str, str]) -> None:
    """Give each line a priority, where the error output goes to the journal.

    The watchdog ends a process by SIGABRT: then the log says where each thread was.
    """
    if not _is_journal(environment):
        return
    faulthandler.enable(sys.stderr)
    sys.stderr = PriorityLines(sys.stderr, Priority.ERROR)


def log(line: str, priority: Priority) -> None:
    if isinstance(sys.stderr, PriorityLines):
        sys.stderr.write(f"<{priority}>{terminal_safe(line)}\n")


def _is_journal(environment: Mapping[str, str]) -> bool:
    try:
        found = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return environment.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


# The state as `/diagnostics`, for ROS programs.
#
# Nothing is judged here: words and faults are those of the screens.


_ENGINE = "engine"
_LEVELS = {
    Freshness.FRESH: Level.WARN,
    Freshness.STALE: Level.WARN,
    Freshness.LOST: Level.STALE,
    Freshness.NEVER: Level.ERROR,
}


def diagnoses(snapshot: Snapshot, rate: float) -> tuple[Diagnosis, ...]:
    """Health of engine, recorder, disk and each topic; `rate` is the expected one, Hz."""
    topics = tuple(_topic(view, rate) for view in snapshot.topics)
    told = (_recorder(snapshot), _disk(snapshot), *topics)
    if snapshot.pulse.stale:  # what is known of them is old
        words = str(snapshot.pulse.words)
        told = tuple(replace(one, level=Level.STALE, message=words) for one in told)
    return (_engine(snapshot), *told)


def failure(words: str) -> Diagnosis:
    return Diagnosis(_ENGINE, Level.ERROR, words)


def _engine(snapshot: Snapshot) -> Diagnosis:
    pulse, setup = snapshot.pulse, snapshot.run.setup
    values = {
        "phase": str(snapshot.run.phase),
        "core silent, s": str(pulse.core),
        "testbed": snapshot.label,
        "subject": "" if setup is None else str(setup.subject),
        "run": "" if setup is None else str(setup.run_number),
    }
    if pulse.stale:
        return Diagnosis(_ENGINE, Level.ERROR, str(pulse.words), values)
    faults = [fault for fault in snapshot.faults if not fault.startswith("recorder: ")]
    level = Level.WARN if faults else Level.OK
    return Diagnosis(_ENGINE, level, "; ".join(faults) or str(snapshot.run.phase), values)


def _recorder(snapshot: Snapshot) -> Diagnosis:
    recorder = snapshot.recorder
    lost = sum(view.lost or 0 for view in snapshot.topics)
    values = {
        "messages": str(recorder.messages),
        "bytes": str(recorder.size),
        "queue, bytes": str(recorder.queued),
        "dropped": str(recorder.dropped),
        "lost on the way": str(lost),
    }
    faults = [f for f in snapshot.faults if f.startswith("recorder: ")]
    words = "; ".join(fault.removeprefix("recorder: ") for fault in faults)
    level = Level.ERROR if faults else Level.OK
    return Diagnosis("recorder", level, words or recorder.state, values)


def _disk(snapshot: Snapshot) -> Diagnosis:
    silent, free = snapshot.pulse.disk, snapshot.disk_free
    values = {
        "free, bytes": "" if free is None else str(free),
        "silent, s": str(silent),
        "lines waiting": str(snapshot.pulse.unwritten),
    }
    if silent:
        return Diagnosis("disk", Level.ERROR, f"silent for {silent} s", values)
    check = next((check for check in snapshot.checks if check.name is CheckName.DISK), None)
    if check is not None:
        return Diagnosis("disk", _CHECKED[check.state], check.reason, values)
    if free is None:
        return Diagnosis("disk", Level.STALE, "free space unknown", values)
    return Diagnosis("disk", Level.OK, f"{format_size(free)} free", values)


_CHECKED = {
    CheckState.OK: Level.OK,
    CheckState.WARNING: Level.WARN,
    CheckState.FAILED: Level.ERROR,
    CheckState.NO_DATA: Level.STALE,
    CheckState.WAIVED: Level.WARN,
}


def _topic(view: TopicView, rate: float) -> Diagnosis:
    values = {
        "rate, Hz": "" if view.rate is None else f"{view.rate:.1f}",
        "age, s": "" if view.age is None else f"{view.age:.3f}",
        "expected, Hz": "" if view.optional else f"{rate:g}",
        "received": str(view.received),
        "lost": "" if view.lost is None else str(view.lost),
        "publishers": str(view.publishers),
    }
    if view.problem is None:
        absent = view.freshness is Freshness.NEVER
        words = f"{view.freshness} (optional)" if absent else str(view.freshness)
        return Diagnosis(view.topic, Level.OK, words, values)
    return Diagnosis(view.topic, _LEVELS[view.freshness], view.problem, values)


# Answers to other programs of a testbed: services that they call, topics that they hear.


_WHY = "called over ROS"

_ACTS: dict[RemoteService, Act] = {
    RemoteService.START: Start(),
    RemoteService.ABORT: Abort(_WHY),
    RemoteService.DECLARE_TIMEOUT: DeclareTimeout(_WHY),
}
"""A call is an act like any other: same checks, same refusals, same queue."""


class Attendant:
    """Has calls carried out as acts of the origin `remote`. From any thread; never waits.

    `rate` is the required rate of the testbed's topics, Hz.
    """

    def __init__(
        self, engine: LocalEngine, services: Collection[RemoteService], rate: float
    ) -> None:
        self.services = services
        self._engine = engine
        self._rate = rate

    def call(self, service: RemoteService) -> LookForAnswer:
        """Have an act done; the answer comes in time, whatever core and disk do."""
        act = _ACTS[service]
        request = Perform.of(act)
        answer = self._engine.begin_request(request, origin=Origin.REMOTE)
        ends = time.monotonic() + request.timeout

        def look() -> CallAnswer | None:
            if answer.done():
                return _answered(act, answer)
            if time.monotonic() < ends:
                return None
            return CallAnswer(success=False, message=f"{act.name}: {given_up(answer)}")

        return look

    def diagnose(self) -> Sequence[Diagnosis]:
        try:
            return diagnoses(self._engine.snapshot(), self._rate)
        except MadrobError as error:
            return (failure(str(error)),)


def _answered(act: Act, answer: Future[str | None]) -> CallAnswer:
    try:
        refused = answer.result(0)
    except CancelledError:
        refused = NO_ANSWER
    except MadrobError as error:
        refused = str(error)
    if refused is None:
        return CallAnswer(success=True, message=f"Done: {act.done_text}")
    return CallAnswer(success=False, message=f"Refused: {act.name}: {refused}")
