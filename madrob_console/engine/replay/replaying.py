"""The engine of a replay: a recorded run, paused, stepped, at any speed, from any time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from madrob_console.archive.folders import next_run_number
from madrob_console.archive.rescore import OpenedRun
from madrob_console.archive.results import Scored
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.live.event_log import EventLog
from madrob_console.engine.replay.repetition import TICK_NS, Repetition
from madrob_console.engine.replay.tape import Tape
from madrob_console.engine.shown.playback import (
    AnyCommand,
    Faster,
    JumpTo,
    PlaybackView,
    PlayOrPause,
    SetSpeed,
    Skip,
    Slower,
    faster,
    slower,
)
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import MessageTypes
from madrob_console.referee.acts import ACTS, Act
from madrob_console.referee.run import Run
from madrob_console.testbeds.recorded_bag import LONGEST

SLICE = 0.04
"""Work goes on for at most this long before keys are looked at, s of real time."""

FASTEST = 1000.0
"""Times as fast as it was."""

NO_ACTS = "a replay shows what was decided then: nothing can be done to the run"
"""Why every act is refused."""

OWN_RUN = "a replay shows its own run: leave it to open another one"

_LONGEST_LEAP = 0.1
_TICK = TICK_NS / 1e9


class ReplayingEngine:
    """Plays a recorded run and does what the screens ask of it. Writes nothing to any disk.

    Going back begins the run anew and runs to the time that was asked for, so that what is shown
    is always what the data up to then say.

    Args:
        path: a bag or a run folder.
        config: the results folder, for next run numbers; what counts as a healthy testbed. All
            other numbers are the recording's.
        types: the message types; those of the bag are registered.
        speed: how many times as fast as it was; 0 = as fast as possible.
        monotonic: real time, s.
        wait: lets real time pass, s.

    Attributes:
        log: the event log.
        source: the bag.

    Raises:
        MadrobError: there is no run to be replayed, or the speed is impossible.
    """

    def __init__(
        self,
        path: Path,
        config: EngineConfig,
        types: MessageTypes,
        speed: float = 1.0,
        monotonic: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        if (refused := _speed_problem(speed)) is not None:
            raise MadrobError(refused)
        self.config = config
        self.log = EventLog()
        self._tape = Tape(path, types)
        self.source = self._tape.source
        self._speed = speed
        self._monotonic, self._wait = monotonic, wait
        self._paused = False
        self._target: int | None = None
        self._due = 0.0
        self._looked = monotonic()
        self._pass = self._begin()
        self._offset = self._pass.now - self._tape.start

    def _begin(self) -> Repetition:
        return Repetition(self._tape, self.config.limits, self.log)

    # ------------------------------------------------------------------ for the owner

    @property
    def run(self) -> Run:
        """The state of the run."""
        return self._pass.run

    @property
    def scored(self) -> Scored | None:
        """The run's result, at the end of the recording."""
        return self._pass.scored

    @property
    def folder(self) -> Path:
        """Where the recorded run lies."""
        return self.source.path

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with the recording, in words."""
        return self._tape.problems

    @property
    def busy(self) -> bool:
        """Never: nothing is lost with a replay."""
        return False

    def open(self) -> None:
        """The clock of the replay begins to run."""
        self._looked = self._monotonic()

    def close(self) -> None:
        """Let go of the bag."""
        self.source.close()

    def step(self, timeout: float) -> None:
        """Go on for at most `timeout` s of real time, or work for a moment to catch up."""
        stands = self._paused or self._pass.ended
        if self._target is None and (stands or self._speed > 0):
            self._wait(timeout)
        now = self._monotonic()
        passed = min(now - self._looked, _LONGEST_LEAP)  # a machine that slept skips nothing
        self._looked = now
        if self._target is not None:
            self._work(self._target)
            if self._pass.ticks >= self._target or self._pass.ended:
                self._arrive()
        elif not stands:
            self._due += passed * self._speed / _TICK
            self._work(self._pass.last_tick if self._speed == 0 else math.floor(self._due))
            here = self._pass.ticks
            self._due = min(max(self._due, here), here + 1.0)

    def _work(self, ticks: int) -> None:
        """Go on to a tick, or as far as a moment of work brings it."""
        end = self._monotonic() + SLICE
        while self._pass.ticks < ticks and not self._pass.ended:
            self._pass.tick()
            if self._monotonic() >= end:
                return

    def _arrive(self) -> None:
        self._target = None
        self._due = float(self._pass.ticks)

    # ------------------------------------------------------------------ what is asked of it

    def control(self, command: AnyCommand) -> str | None:
        """Pause, step, jump, change the speed.

        Returns:
            Why that is not possible, in words; None when it is done or on its way.
        """
        match command:
            case PlayOrPause():
                return self._play_or_pause()
            case Faster():
                self._speed = faster(self._speed)
            case Slower():
                self._speed = slower(self._speed)
            case SetSpeed(speed):
                if (refused := _speed_problem(speed)) is not None:
                    return refused
                self._speed = speed
            case Skip(duration):
                if not abs(duration) < LONGEST:
                    return "give a number of seconds"
                self._paused = True
                now = self._pass.ticks if self._target is None else self._target
                self._go_to(now + round(duration / _TICK))
            case JumpTo(at):
                return self._jump(at)
        return None

    def _play_or_pause(self) -> str | None:
        if self._pass.ended:
            return "the recording is at its end: < goes back, j jumps to a time"
        self._paused = not self._paused
        self._arrive()  # a jump that goes on ends here
        return None

    def _jump(self, at: float) -> str | None:
        begin, end = self._time(0), self._time(self._pass.last_tick)
        if not begin - _TICK <= at <= end + _TICK:
            return f"the recording goes from {begin:.1f} to {end:.1f} s"
        self._go_to(round((at - begin) / _TICK))
        return None

    def _go_to(self, ticks: int) -> None:
        ticks = min(max(0, ticks), self._pass.last_tick)
        if ticks < self._pass.ticks or (self._pass.ended and ticks < self._pass.last_tick):
            self._pass = self._begin()
        self._target = ticks

    def _time(self, ticks: int) -> float:
        """A tick in s from the start of the run."""
        return self._offset + ticks * _TICK

    def perform(self, act: Act) -> str | None:
        """Refuse: no act changes what was."""
        return NO_ACTS

    def opening_refusal(self) -> str | None:
        """Always: a replay shows its own run."""
        return OWN_RUN

    def open_run(self, opened: OpenedRun, *, invalid: bool = False) -> str | None:
        """Refuse."""
        return OWN_RUN

    def next_run_number(self, subject: int, condition_number: int) -> int:
        """The next run number that was never used for this subject and condition.

        Raises:
            MadrobError: the results folder cannot be read, or all numbers are used.
        """
        return next_run_number(self.config.results, subject, condition_number)

    # ------------------------------------------------------------------ what it shows

    @property
    def comparison(self) -> str:
        """What the result is beside the stored one, in words; empty before the end."""
        scored = self._pass.scored
        return "" if scored is None else self._tape.compare(scored.result)

    def snapshot(self) -> Snapshot:
        """Everything that a screen shows, now."""
        refusals = {act.name: NO_ACTS for act in ACTS}
        return self._pass.snapshot(refusals, self.problems, self._view())

    def _view(self) -> PlaybackView:
        here = self._pass
        return PlaybackView(
            position=self._time(here.ticks),
            begin=self._time(0),
            end=self._time(here.last_tick),
            speed=self._speed,
            paused=self._paused,
            ended=here.ended,
            jumping_to=None if self._target is None else self._time(self._target),
            comparison=self.comparison,
        )


AnyEngine: TypeAlias = Engine | ReplayingEngine
"""What `madrob_console.engine.process.local` runs in its thread."""


def _speed_problem(speed: float) -> str | None:
    if 0 <= speed <= FASTEST:
        return None
    return f"replay speed {speed:g} is impossible: use 0 to {FASTEST:g}"
