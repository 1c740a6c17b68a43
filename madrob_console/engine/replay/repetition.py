"""One pass through a recorded run: the sensors once more, the referee's acts at their times."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from madrob_console.archive.rescore import keep_stored_remarks, report_bag
from madrob_console.archive.results import Scored, ending_of
from madrob_console.clock import nanoseconds, seconds
from madrob_console.engine.live.course import Course, Happening
from madrob_console.engine.live.event_log import EventLog
from madrob_console.engine.live.limits import SensorLimits
from madrob_console.engine.live.observation import Observation
from madrob_console.engine.replay.tape import Tape
from madrob_console.engine.shown.playback import SAMPLE_STEP, PlaybackView
from madrob_console.engine.shown.snapshot import RecorderView, Snapshot
from madrob_console.kinds import SourceKind
from madrob_console.referee.acts import RestartCountdown, Start
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change, after
from madrob_console.referee.run import Run
from madrob_console.referee.transitions import stop
from scoring.protocol import Outcome

TICK_NS = nanoseconds(SAMPLE_STEP)
"""Everything is decided at whole ticks from the beginning of the bag, so that pauses, steps,
jumps and speed change nothing of what is shown at a time."""

_DECIDED_ANEW = (Change.RUN_STARTS, Change.EVENT, Change.TIMEOUT_ELAPSED, Change.RUN_STOPS)


class Repetition:
    """A recorded run as it goes on, tick by tick. Writes nothing.

    What sensors and clock decide is decided anew. What they could not is taken from the journal:
    the referee's acts, a failure of the machine, and what the bag cannot tell because it happened
    before or beside it (false starts, faults of the testbed). At the end of the bag comes what
    the referee said later, and then the result.

    Args:
        tape: the recorded run; its bag is opened anew.
        limits: what counts as healthy.
        log: the lines for people; it is cleared.

    Attributes:
        ticks: how many have passed.
        run: its state now.
        scored: its result, once the end is reached.
    """

    def __init__(self, tape: Tape, limits: SensorLimits, log: EventLog) -> None:
        source, recorded = tape.source, tape.recorded
        self._source, self._recorded, self._limits, self._log = source, recorded, limits, log
        record = recorded.record
        self._observation = Observation(record.mappings, record.thresholds, limits, tape.types)
        self._entries = deque(recorded.entries)
        self._now_ns = source.begin_ns
        self.ticks = 0
        self.last_tick = max(1, -(-(source.end_ns - source.begin_ns) // TICK_NS))
        self.run = Run(handle_zero=record.handle_zero)
        self.scored: Scored | None = None
        log.clear()
        source.open()
        self._go_to(self._now_ns)

    @property
    def now(self) -> float:
        """Recorded time, s since the epoch."""
        return seconds(self._now_ns)

    @property
    def ended(self) -> bool:
        """Whether the end of the recording is reached."""
        return self.scored is not None

    def tick(self) -> None:
        """Go on by one tick; at the last one the result comes. Nothing after that."""
        if self.ended:
            return
        if self.ticks < self.last_tick:
            self.ticks += 1
            self._go_to(self._source.begin_ns + self.ticks * TICK_NS)
        if self.ticks >= self.last_tick:
            self._finish()

    def _go_to(self, now_ns: int) -> None:
        """Take messages and repeat what was done up to an instant, in the order of time."""
        while self._entries and self._entries[0].time <= seconds(now_ns):
            entry = self._entries.popleft()
            if entry.time > self.now:
                self._take(nanoseconds(entry.time))
            self._repeat(entry)
        self._take(now_ns)

    def _take(self, now_ns: int) -> None:
        self._now_ns = now_ns
        for message in self._source.take(now_ns):
            self._observation.receive(message)
        self._advance()

    def _advance(self) -> None:
        before = self.run
        run, happened = self._observation.advance(before, self.now)
        self.run = replace(run, false_starts=before.false_starts)
        for one in happened:
            if one.change in _DECIDED_ANEW:
                self._log.add(self._entry(one), before.start)
        self._judge_stop(before)

    def _entry(self, one: Happening) -> Entry:
        return Entry(self.now, one.origin, one.change, reason=one.reason, details=one.details)

    def _repeat(self, entry: Entry) -> None:
        """What a line of the journal tells of happens again."""
        if entry.what in _DECIDED_ANEW and entry.origin is not Origin.SYSTEM:
            return
        before = self.run
        self.run = after(before, entry, self._recorded.record.handle_zero)
        self._log.add(entry, before.start)
        if self.run.start is not None and entry.what in (Start.name, RestartCountdown.name):
            self._count_down(self.run)
        self._judge_stop(before)
        self._advance()

    def _count_down(self, run: Run) -> None:
        if self._observation.course is None:
            self._observation.course = Course(self._recorded.record, run, self._limits.lost)
        else:
            self._observation.course.restart(run)

    def _judge_stop(self, before: Run) -> None:
        if before.active and not self.run.active:
            self._observation.judge(self.run)

    # ------------------------------------------------------------------ the end

    def _finish(self) -> None:
        """The recording is over: what was said later counts, and the result is made."""
        while self._entries:
            self._repeat(self._entries.popleft())
        self._take_official_ending()
        recorded, assessment, run = self._recorded, self._observation.assessment, self.run
        assert assessment is not None
        report_bag(assessment, recorded)
        keep_stored_remarks(assessment, run, self._source.path)
        self.scored = Scored(recorded.record, run, *self._observation.result(run))

    def _take_official_ending(self) -> None:
        """Where the recording ends during the run, the journal says how the run ended."""
        official = self._recorded.run
        if official.outcome is None:
            reason = ending_of(official).reason
            self.run = stop(self.run, Outcome.INTERRUPTED, self.now, reason)
        elif self.run.outcome is None:
            self.run = replace(
                self.run,
                phase=official.phase,
                outcome=official.outcome,
                outcome_reason=official.outcome_reason,
                stop=official.stop,
                timeout_at=None,
            )

    # ------------------------------------------------------------------ what it shows

    def snapshot(
        self, refusals: dict[str, str], problems: tuple[str, ...], playback: PlaybackView
    ) -> Snapshot:
        """Everything that a screen shows, now.

        Args:
            refusals: act name -> why it is not possible.
            problems: what is wrong with the recording, in words.
            playback: where the replay stands.
        """
        view = self._observation.view(
            self._source,
            self.run,
            self.now,
            self.now,
            recorder=RecorderView("closed"),
            dropped={},
            problems=(),
        )
        return replace(
            view,
            refusals=refusals,
            faults=(*problems, *view.faults),
            log=self._log.lines,
            result=self.scored.result if self.scored else None,
            result_source=SourceKind.REPLAY if self.scored else None,
            folder=str(self._source.path),
            playback=playback,
        )
