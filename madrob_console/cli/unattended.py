"""A run or a replay without screens: a plain line per event."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Protocol

from madrob_console.cli.problems import StoppedError
from madrob_console.cli.score_table import result_lines
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.event_log import EventLog
from madrob_console.engine.live.replay import Replay
from madrob_console.engine.process.reporting import Reporting
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from madrob_console.referee.acts import Abort, Act, ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.on_record import CheckName
from madrob_console.referee.preflight import CheckState, blocking
from madrob_console.referee.run_setup import RunSetup
from scoring.protocol import Outcome

STEP = 0.02
"""The engine waits this long for messages, s of its clock."""

_LOOK_PERIOD = 0.5
_REST = 1.5


class SetupMaker(Protocol):
    """Makes what is set for a run."""

    def __call__(self, *, simulated: bool) -> RunSetup:
        """The set-up for a simulated testbed, or for a real one."""
        ...


class _LogPrinter:
    """Prints every line of a log once.

    Args:
        log: of an engine.
    """

    def __init__(self, log: EventLog) -> None:
        self._log = log
        self._printed = 0

    def print_new(self) -> None:
        """Print what has come since."""
        for line in self._log.lines:
            if line.number < self._printed:
                continue
            self._printed = line.number + 1
            clock = "" if line.relative is None else f"{line.relative:+.3f} s"
            print(f"{clock:>12}  {line.origin:<8}  {line.text}", flush=True)


def print_replay(engine: Engine, replay: Replay) -> Outcome:
    """Print a replay to its end, and in what it differs from the stored result; write nothing."""
    log = _LogPrinter(engine.log)
    engine.open()
    try:
        print(f"testbed: {engine.source.label}", flush=True)
        for problem in replay.problems:
            print(f"note: {terminal_safe(problem)}", flush=True)
        log.print_new()
        while engine.scored is None:
            engine.step(STEP)
            log.print_new()
    finally:
        engine.close()
    result = engine.scored.result
    for line in result_lines(result, engine.scored.flags):
        print(line)
    print(f"replay: {replay.view(result).comparison}; nothing was recorded")
    print(f"run folder: {engine.folder}", flush=True)
    return result.outcome


class UnattendedRun:
    """Drives an engine as a referee would, and prints what happens.

    Args:
        engine: not opened yet.
        reporting: makes the report; None = there shall be none.
    """

    def __init__(self, engine: Engine, reporting: Reporting | None) -> None:
        self._engine = engine
        self._reporting = reporting
        if reporting is not None:
            engine.on_result = reporting.report
        self._log = _LogPrinter(engine.log)
        self._signal: int | None = None

    def go(self, setup: SetupMaker, wait: float, waive: str | None) -> Outcome:
        """Do the run, to its report; how it ended.

        Args:
            setup: tells what is set, for a simulated testbed or a real one; asked when the engine
                is open.
            wait: for the pre-start checks, s.
            waive: why failing checks shall pass; None = they shall not.

        Raises:
            MadrobError: it did not start; nothing was recorded.
        """
        engine = self._engine
        engine.open()
        # the robot is getting ready: nobody should wait for imports when it is through the door
        engine.warm()
        try:
            self._prepare(setup, wait, waive)
            while engine.scored is None:
                self._step()
                self._heed_signal()
        finally:
            engine.close()
            self._log.print_new()
        return self._report()

    def _prepare(self, setup: SetupMaker, wait: float, waive: str | None) -> None:
        engine = self._engine
        simulated = self._set_up(setup)
        self._wait_for_checks(wait)
        if engine.source.announcement.simulated is not None and not simulated:
            self._set_up(setup)  # it is heard only now
        if problem := engine.source.sides_problem:
            print(f"note: {terminal_safe(problem)}", flush=True)
        for check in engine.situation().checks:
            if check.state is CheckState.WARNING:
                print(terminal_safe(f"note: {check.name}: {check.reason}"), flush=True)
        self._do(ZeroHandle())
        self._do(ConfirmPose())
        if waive is not None:
            for check in blocking(engine.situation().checks):
                self._do(Waive(check.name, waive))
        self._do(Start())

    def _set_up(self, setup: SetupMaker) -> bool:
        """Set the run up and say on what; whether that is known to be simulated."""
        simulated = self._engine.source.announcement.simulated is not None
        self._do(SetUp(setup(simulated=simulated)))
        print(f"testbed: {self._engine.snapshot().label}", flush=True)
        return simulated

    def _wait_for_checks(self, wait: float) -> None:
        """Let the handle rest for a while, and wait for the checks that time can mend."""
        by_hand = (CheckName.TEAM, CheckName.POSE, CheckName.HANDLE, CheckName.HANDLE_ZERO)
        begin = looked = self._engine.now()
        while (now := self._engine.now()) < begin + wait:
            self._step()
            if self._signal is not None:
                raise StoppedError("stopped before the start; nothing was recorded", self._signal)
            if now < begin:
                begin = looked = now  # the clock was set back: to that of a simulation, say
            if now < max(begin + _REST, looked + _LOOK_PERIOD):
                continue
            looked = now
            if all(c.name in by_hand for c in blocking(self._engine.situation().checks)):
                return

    def _do(self, act: Act) -> None:
        refused = self._engine.perform(act)
        self._log.print_new()
        if refused is not None:
            raise MadrobError(f"{act.name} refused: {refused}")

    def _step(self) -> None:
        self._engine.step(STEP, lambda: self._signal is not None)
        self._log.print_new()

    def _heed_signal(self) -> None:
        if self._signal is None:
            return
        if self._engine.run.active:
            self._engine.perform(Abort(f"madrob run was ended by {self._name_of_signal()}"))
        self._signal = None

    def _name_of_signal(self) -> str:
        return signal.Signals(self._signal or 0).name

    @contextmanager
    def stopping_on_signals(self) -> Iterator[None]:
        """INT, TERM and HUP abort the run; it is kept on record as invalid."""

        def note(number: int, _frame: FrameType | None) -> None:
            self._signal = number

        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        before = {number: signal.signal(number, note) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _report(self) -> Outcome:
        scored = self._engine.scored
        assert scored is not None
        for line in result_lines(scored.result, scored.flags):
            print(line)
        if self._engine.result_problem:
            print(self._engine.result_problem)
        if self._reporting is not None:
            self._wait_for_report(self._reporting)
        print(f"run folder: {self._engine.folder}", flush=True)
        return scored.result.outcome

    def _wait_for_report(self, reporting: Reporting) -> None:
        """Wait until the report is made; a signal ends the waiting, and it gets ready alone."""
        self._signal = None
        while not reporting.wait(_LOOK_PERIOD) and self._signal is None:
            pass
        if reporting.problem is not None:
            print(reporting.problem)
