"""`madrob run`: one run without screens, a plain line per event."""

from __future__ import annotations

import argparse
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from types import FrameType

from madrob_console.cli import aside
from madrob_console.cli.attaching import engine_place
from madrob_console.cli.log_printer import LogPrinter
from madrob_console.cli.replaying import replay
from madrob_console.cli.score_table import result_lines
from madrob_console.cli.session import open_engine
from madrob_console.config import Settings, load_settings
from madrob_console.engine.live.core import Engine
from madrob_console.engine.process.reporting import Papers
from madrob_console.engine.replay.replaying import ReplayingEngine
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.names import clean_name
from madrob_console.referee.acts import Abort, Act, ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.preflight import blocking
from madrob_console.referee.run import CheckName, RunSetup
from scoring.kinematics import load_filters
from scoring.protocol import Condition, Outcome, StartPose

EXIT_CODES = {
    Outcome.COMPLETED: 0,
    Outcome.TIMEOUT: 3,
    Outcome.ABORTED: 4,
    Outcome.INTERRUPTED: 5,
}

STEP = 0.02
"""The engine waits this long for messages, s of its clock."""

_LOOK_PERIOD = 0.5
_REST = 1.5


def main(arguments: argparse.Namespace) -> int:
    """One run from the set-up to its result."""
    settings = load_settings(arguments.settings)
    engine = open_engine(arguments, settings)
    if isinstance(engine, ReplayingEngine):
        return EXIT_CODES[replay(engine)]
    live = engine.source.kind is SourceKind.ROS
    reports = settings.results.reports and not arguments.no_report
    papers = Papers(aside.COMMAND, lambda: engine.busy) if reports else None
    runner = _Runner(engine, papers)
    alone = engine_place(arguments, settings).taken() if live else nullcontext()
    with alone, runner.stopping_on_signals():
        return runner.go(arguments, settings)


class _Runner:
    """Drives an engine as a referee would, and prints what happens."""

    def __init__(self, engine: Engine, papers: Papers | None) -> None:
        self._engine = engine
        self._papers = papers
        if papers is not None:
            engine.on_result = papers.report
        self._log = LogPrinter(engine.log)
        self._signal: int | None = None

    def go(self, arguments: argparse.Namespace, settings: Settings) -> int:
        engine = self._engine
        engine.open()
        # the robot is getting ready: nobody should wait for imports when it is through the door
        threading.Thread(target=load_filters, name="filters", daemon=True).start()
        try:
            print(f"testbed: {engine.source.label}", flush=True)
            self._prepare(arguments, settings)
            while engine.scored is None:
                self._step()
                self._heed_signal()
        finally:
            engine.close()
            self._log.print_new()
        return self._report()

    def _prepare(self, arguments: argparse.Namespace, settings: Settings) -> None:
        engine = self._engine
        setup = _setup(arguments, settings, engine)
        self._do(SetUp(setup))
        begin = engine.now()
        self._wait_for_checks(begin + _REST, begin + arguments.wait)
        if problem := engine.source.sides_problem:
            print(f"note: {problem}", flush=True)
        self._do(ZeroHandle())
        self._do(ConfirmPose())
        if arguments.waive is not None:
            for check in blocking(engine.situation().checks):
                self._do(Waive(check.name, arguments.waive))
        self._do(Start())

    def _wait_for_checks(self, rest: float, end: float) -> None:
        """Let the handle rest for a while, and wait for the checks that time can mend."""
        by_hand = (CheckName.POSE, CheckName.HANDLE)
        looked = 0.0
        while (now := self._engine.now()) < end:
            self._step()
            if self._signal is not None:
                raise MadrobError("stopped before the start; nothing was recorded")
            if now < max(rest, looked + _LOOK_PERIOD):
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
        self._engine.step(STEP)
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

    def _report(self) -> int:
        scored = self._engine.scored
        assert scored is not None
        for line in result_lines(scored.result):
            print(line)
        if self._engine.result_problem:
            print(self._engine.result_problem)
        if self._papers is not None:
            self._wait_for_report(self._papers)
        print(f"run folder: {self._engine.folder}", flush=True)
        return EXIT_CODES[scored.result.ending.outcome]

    def _wait_for_report(self, papers: Papers) -> None:
        """Wait until the report is made; a signal ends the waiting, and it gets ready alone."""
        self._signal = None
        while not papers.wait(_LOOK_PERIOD) and self._signal is None:
            pass
        if papers.problem is not None:
            print(papers.problem)


def _setup(arguments: argparse.Namespace, settings: Settings, engine: Engine) -> RunSetup:
    condition = Condition(arguments.benchmark_type, arguments.opening_side, arguments.starting_side)
    number = arguments.run
    if number is None:
        number = engine.next_run_number(arguments.subject, condition.number)
    referee = arguments.referee
    if referee is None:
        referee = settings.competition.referee
    defaults = settings.run
    pose = arguments.start_pose
    start_pose = StartPose(*pose) if pose else settings.start_pose(condition.starting_side)
    return RunSetup(
        subject=arguments.subject,
        team=clean_name(arguments.team, "--team"),
        run_number=number,
        condition=condition,
        start_pose=start_pose,
        referee=clean_name(referee, "--referee"),
        timeout=defaults.timeout if arguments.timeout is None else arguments.timeout,
        countdown=defaults.countdown if arguments.countdown is None else arguments.countdown,
        ruleset=arguments.ruleset or defaults.ruleset,
        lock_detection=arguments.lock_detection or defaults.lock_detection,
    )
