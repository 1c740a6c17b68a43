"""A recorded run that an engine goes through again."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path

from madrob_console.archive.appeal import Comparison, compared, stored_result
from madrob_console.archive.moments import moments_called
from madrob_console.archive.scored import keep_stored_losses, read_recorded_run, report_bag
from madrob_console.common.clock import NS, nanoseconds, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.recorded_clock import LONGEST, TICK
from madrob_console.engine.core.current_run import DECIDED_ANEW, ReplayedRun
from madrob_console.engine.core.effects import Score, ToPerform
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.core.inputs import Input, RunScored
from madrob_console.engine.playback import (
    Faster,
    JumpTo,
    PlaybackCommand,
    PlaybackView,
    PlayOrPause,
    SetSpeed,
    Skip,
    Slower,
    faster,
    slower,
)
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from madrob_console.testbeds.recorded_bag import RecordedBag
from recorder import RecorderError
from scoring.assessment import Assessment
from scoring.result import Result

_NO_TIME = 1e12  # s: from here on


class Replay:
    """Replaces referee and recorder for a recorded run. Writes nothing to any disk.

    The message types of the bag are registered in `types`. `speed` is times real time; 0 =
    as fast as possible. `monotonic` and `wait` read and pass real time, s.
    """

    def __init__(
        self,
        path: Path,
        types: MessageTypes,
        speed: float = 1.0,
        monotonic: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self.source = RecordedBag(path, types, speed, monotonic, wait)
        try:
            self.recorded = read_recorded_run(path)
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        entries, start = self.recorded.entries, self.recorded.run.start
        assert start is not None
        self.source.expect(self.recorded.record.mappings)
        # In the journal's order, even where a line says that it is older than the one before. All
        # up to the countdown was done when the bag begins: until then the clock may have been set
        # back, and the first messages may have waited for the countdown.
        times, begin = [_instant(entry.time) for entry in entries], self.source.begin_ns
        said = [entry.what for entry in entries]
        opened = said.index(Change.COUNTDOWN_BEGINS) + 1 if Change.COUNTDOWN_BEGINS in said else 0
        times[:opened] = [min(each, begin) for each in times[:opened]]
        self._times = tuple(accumulate(times, max))
        self.source.clock.stop_at(self._times)
        self._begin = seconds(self.source.begin_ns) - start
        self._stored = stored_result(path)
        self._lost = tuple(_lost_lines(entries, self.source.journal_lines))
        self.begin_replay()

    def begin_replay(self) -> None:
        self._waiting = deque(zip(self._times, self.recorded.entries, strict=True))

    def instant(self, named: str) -> float:
        """A time named as for `moments_called`, s from the start; of several the first."""
        run = self.recorded.run
        assert run.start is not None
        of_events = (entry.details for entry in self.recorded.entries if entry.what == Change.EVENT)
        events = [
            (str(details.get("event")), float(time))
            for details in of_events
            if isinstance(time := details.get("time"), int | float)
            and abs(time) < _NO_TIME  # a journal may be hostile
        ]
        return moments_called(named, events, run, run.start)[0].since_start

    @property
    def recorded_run(self) -> ReplayedRun:
        return ReplayedRun(self.recorded.recorded_as, self.source.path, self.recorded.run)

    def config(self, config: EngineConfig) -> EngineConfig:
        record = self.recorded.record
        return replace(config, mappings=record.mappings, thresholds=record.thresholds)

    @property
    def problems(self) -> tuple[str, ...]:
        return (*self.recorded.remarks, *self.source.problems, *self._lost)

    # ------------------------------------------------------------------ what was decided

    def due(self) -> Iterator[Entry]:
        """Journal lines up to now, each once; at the end also those written after the run."""
        clock = self.source.clock
        while self._waiting and (clock.ended or self._waiting[0][0] <= clock.now_ns()):
            _, entry = self._waiting.popleft()
            if entry.what not in DECIDED_ANEW or entry.origin is Origin.SYSTEM:
                yield entry

    @property
    def ended(self) -> bool:
        return self.source.clock.ended

    def report(self, assessment: Assessment) -> None:
        report_bag(assessment, self.recorded)
        keep_stored_losses(assessment, self.source.path)

    # ------------------------------------------------------------------ how it goes

    def control(self, command: PlaybackCommand) -> str | None:
        """Why the command is not possible, in words; None when it is done or on its way."""
        clock = self.source.clock
        match command:
            case PlayOrPause():
                return clock.play_or_pause()
            case Faster():
                return clock.set_speed(faster(clock.speed))
            case Slower():
                return clock.set_speed(slower(clock.speed))
            case SetSpeed(speed):
                return clock.set_speed(speed)
            case Skip(duration):
                return clock.skip(duration)
            case JumpTo(at):
                return self._jump(at)
        raise NotImplementedError(f"nobody carries out {command}")

    def _jump(self, at: float) -> str | None:
        clock = self.source.clock
        begin, end = self._time(0), self._time(clock.last_tick)
        if not begin - TICK <= at <= end + TICK:
            return f"the recording goes from {begin:.1f} to {end:.1f} s"
        clock.go_to(round((at - begin) / TICK))
        return None

    def _time(self, ticks: int) -> float:
        """A tick in s from the start of the run."""
        return self._begin + ticks * TICK

    def view(self, result: Result | None) -> PlaybackView:
        """Where the replay stands; at the end, how `result` compares with the stored one."""
        clock = self.source.clock
        comparison = Comparison("") if result is None else compared(self._stored, result)
        return PlaybackView(
            position=self._time(clock.ticks),
            begin=self._time(0),
            end=self._time(clock.last_tick),
            speed=clock.speed,
            paused=clock.paused,
            ended=clock.ended,
            jumping_to=None if clock.target is None else self._time(clock.target),
            comparison=comparison.words,
            agrees=comparison.agrees,
        )


class ReplayPerformer:
    """Carries out the effects of a core that replays: the run is scored, all else was done then.

    Attributes:
        inputs: what came of the effects, oldest first.
    """

    def __init__(self, replay: Replay, scorer: Scorer) -> None:
        self.inputs: deque[Input] = deque()
        self._replay = replay
        self._scorer = scorer

    def carry_out(self, effect: ToPerform) -> None:
        if not isinstance(effect, Score):
            return
        request = effect.request
        assert request.assessment is not None
        self._replay.report(request.assessment)
        self._scorer.score(request, lambda scored: self.inputs.append(RunScored(request, scored)))


def _instant(time: float) -> int:
    """A line's time in ns since the epoch; an invalid time never comes."""
    return nanoseconds(time) if math.isfinite(time) else LONGEST * NS**2


def _lost_lines(entries: Sequence[Entry], recorded: Sequence[str]) -> Iterator[str]:
    lines = {entry.to_json() for entry in entries}
    if lost := sum(line not in lines for line in recorded):
        yield f"the journal lacks {lost} of the {len(recorded)} lines that the bag has of it"
