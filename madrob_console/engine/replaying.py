"""A recorded run, gone through once more: its messages, and the referee's acts at their times."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from madrob_console.engine.config import EngineConfig
from madrob_console.engine.engine import Engine
from madrob_console.engine.record import RECORD_NAME, RunRecord
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import Act, Finalise, Reissue, SetUp
from madrob_console.referee.journal import Entry
from madrob_console.referee.rebuild import act_of
from madrob_console.referee.run import Run
from madrob_console.testbeds.messages import MessageTypes
from madrob_console.testbeds.replay import ReplaySource


class ReplayingEngine(Engine):
    """An engine on a `ReplaySource`: it repeats the acts of the recorded run.

    The run number is the next free one; a run whose recording was cut off is interrupted.

    Args:
        source: the recording.
        config: the results folder for the replayed run; the numbers are the recording's.
        types: the message types, shared with the source.

    Raises:
        MadrobError: the recording holds no run.
    """

    def __init__(self, source: ReplaySource, config: EngineConfig, types: MessageTypes) -> None:
        metadata = source.records.get(RECORD_NAME)
        if metadata is None:
            raise MadrobError(f"{source.path}: a bag without a MADROB run cannot be replayed")
        self._recorded = RunRecord.from_metadata(dict(metadata))
        config = replace(
            config,
            thresholds=self._recorded.thresholds,
            mappings=self._recorded.mappings,
            competition=self._recorded.competition,
        )
        super().__init__(source, source.clock, config, types)
        entries = (Entry.from_json(line.text) for line in source.journal_lines)
        acts = ((entry.time, act_of(entry)) for entry in entries)
        self._acts = deque((time, act) for time, act in acts if act is not None)
        self._run = Run(handle_zero=self._recorded.handle_zero)

    def opening_refusal(self) -> str | None:
        """Always: a replay shows its own run."""
        return "a replay shows its own run: leave it to open another one"

    def step(self, timeout: float) -> None:
        """Go on by `timeout` s of recorded time, or to the next act."""
        while self._acts and self._acts[0][0] <= self.now() + timeout:
            time, act = self._acts.popleft()
            if time > self.now():
                super().step(time - self.now())
            self._repeat(act, time)
        super().step(timeout)
        if self.source.ended and self._run.active:
            self._interrupt("the recording ends during the run")

    def _repeat(self, act: Act, time: float) -> None:
        if isinstance(act, (Finalise, Reissue)):
            return  # the result of a replay is nobody's official one
        if isinstance(act, SetUp):
            setup = act.setup
            number = self.next_run_number(setup.subject, setup.condition.number)
            act = SetUp(replace(setup, run_number=number))
        self.repeat(act, time, self._recorded.handle_zero)
