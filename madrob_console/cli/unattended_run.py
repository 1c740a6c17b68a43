"""A run without screens: one plain line for each event."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TypeAlias

from madrob_console.cli.output import StoppedError
from madrob_console.cli.result_lines import result_lines
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.engine.core.event_log import EventLog
from madrob_console.engine.runtime.reports import Reporting
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    Act,
    ConfirmPose,
    SetUp,
    Start,
    Waive,
    ZeroHandle,
)
from madrob_console.referee.checks import CheckState, blocking, causes
from madrob_console.referee.records import CheckName
from madrob_console.referee.run_setup import RunSetup
from scoring.protocol import Outcome

STEP = 0.02
"""Interval at which the engine receives messages, s of its clock."""

SetupMaker: TypeAlias = Callable[[bool], RunSetup]
"""Makes the set-up of a run, which is simulated or not."""

_LISTS = (CheckName.TEAM, CheckName.PLAN)
_LOOK_PERIOD = 0.5
_REST = 1.5


class _LogPrinter:
    def __init__(self, log: EventLog) -> None:
        self._log = log
        self._printed = 0

    def print_new(self) -> None:
        for line in self._log.lines:
            if line.number < self._printed:
                continue
            self._printed = line.number + 1
            clock = "" if line.relative is None else f"{line.relative:+.3f} s"
            print(f"{clock:>12}  {line.origin:<8}  {line.text}", flush=True)


class UnattendedRun:
    """Drives an engine as a referee would, and prints what happens.

    The engine must not be open yet. Without `reporting` there is no report.
    """

    def __init__(self, engine: Engine, reporting: Reporting | None) -> None:
        self._engine = engine
        self._reporting = reporting
        if reporting is not None:
            engine.make_reports = reporting.report
        self._log = _LogPrinter(engine.log)
        self._signal: int | None = None

    def go(
        self, setup: SetupMaker, wait: float, waive: str | None, accept: str | None = None
    ) -> Outcome:
        """Do the run, to its report; returns how it ended.

        `setup` is called when the engine is open. `wait` is for the pre-start checks, s. `waive` is
        the reason to start despite failing checks; None = they must pass. `accept` is the
        reason to accept false starts; None = one aborts the run.

        Raises:
            MadrobError: it did not start; nothing was recorded.
        """
        engine = self._engine
        if self._reporting is not None:
            self._reporting.hold(held=True)
        engine.open()
        # the robot is getting ready: nobody should wait for imports when it is through the door
        engine.warm()
        try:
            self._prepare(setup, wait, waive)
            while engine.scored is None:
                self._step()
                self._decide_false_start(accept)
                self._heed_signal()
        finally:
            engine.close()
            self._log.print_new()
            if self._reporting is not None:
                self._reporting.hold(held=False)
        return self._report()

    def _prepare(self, setup: SetupMaker, wait: float, waive: str | None) -> None:
        engine = self._engine
        simulated = self._set_up(setup)
        until = engine.now() + wait
        self._wait_for_checks(wait)
        if engine.source.announcement.simulated is not None and not simulated:
            self._set_up(setup)  # it is heard only now
        if problem := engine.source.sides_problem:
            print(f"note: {terminal_safe(problem)}", flush=True)
        for check in engine.situation().checks:
            if check.state is CheckState.WARNING:
                print(terminal_safe(f"note: {check.name}: {check.reason}"), flush=True)
        self._do_when_possible(ZeroHandle(), until)
        self._do(ConfirmPose())
        if waive is not None:
            for check in blocking(engine.situation().checks):
                self._do(Waive(check.name, waive))
        for check in causes(engine.situation().checks):  # a program has no screen to look at
            print(terminal_safe(f"note: {check.name}: {check.reason}"), flush=True)
        self._do_when_possible(Start(), until)

    def _set_up(self, setup: SetupMaker) -> bool:
        """Set the run up and print the testbed; returns whether it is known to be simulated."""
        simulated = self._engine.source.announcement.simulated is not None
        self._do(SetUp(setup(simulated)))
        print(f"testbed: {self._engine.snapshot().label}", flush=True)
        return simulated

    def _wait_for_checks(self, wait: float) -> None:
        by_hand = (*_LISTS, CheckName.POSE, CheckName.HANDLE, CheckName.HANDLE_ZERO)
        begin = looked = self._engine.now()
        while (now := self._engine.now()) < begin + wait:
            self._step()
            self._heed_stop()
            if now < begin:
                begin = looked = now  # the clock was set back: to that of a simulation, say
            if now < max(begin + _REST, looked + _LOOK_PERIOD):
                continue
            looked = now
            if all(c.name in by_hand for c in blocking(self._engine.situation().checks)):
                return

    def _do_when_possible(self, act: Act, until: float) -> None:
        """Do an act that a sensor may forbid for a moment: a referee would press again."""
        engine = self._engine
        while act.refusal(engine.situation()) is not None and engine.now() < until:
            if all(check.name in _LISTS for check in blocking(engine.situation().checks)):
                break  # no waiting changes a list
            self._step()
            self._heed_stop()
        self._do(act)

    def _heed_stop(self) -> None:
        if self._signal is not None:
            raise StoppedError("stopped before the start; nothing was recorded", self._signal)

    def _do(self, act: Act) -> None:
        refused = self._engine.perform(act)
        self._log.print_new()
        if refused is not None:
            raise MadrobError(f"{act.name} refused: {refused}")

    def _step(self) -> None:
        self._engine.step(STEP, lambda: self._signal is not None)
        self._log.print_new()

    def _decide_false_start(self, accept: str | None) -> None:
        if self._engine.run.held is None:
            return
        if accept:
            self._do(AcceptFalseStart(accept))
            return
        print("note: --accept-false-start WHY lets a false start pass", flush=True)
        self._do(Abort("false start, and no referee to accept it"))

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
        """Let SIGINT, SIGTERM and SIGHUP abort the run while inside; it is kept as invalid."""

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
        if self._engine.refused:
            print(self._engine.refused)
        if self._reporting is not None:
            self._wait_for_report(self._reporting)
        print(f"run folder: {self._engine.folder}", flush=True)
        return scored.result.outcome

    def _wait_for_report(self, reporting: Reporting) -> None:
        self._signal = None
        while not reporting.wait(_LOOK_PERIOD) and self._signal is None:
            pass
        if reporting.problem is not None:
            print(reporting.problem)
