"""Follows a run from its countdown to its stop: what sensors and clock decide."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.clock import seconds
from madrob_console.messages.codec import ROBOT_STARTED_TOPIC, robot_words
from madrob_console.referee.journal import Origin
from madrob_console.referee.rebuild import Change
from madrob_console.referee.records import FalseStart, FaultKind
from madrob_console.referee.run import Phase, Run, begin_run, stop, time_out
from recorder.bag import RawMessage
from scoring.events import EventDetector
from scoring.procedure import Procedure, Ruling
from scoring.protocol import Event, EventName, Outcome, Step
from scoring.samples import Sample
from scoring.stamps import REORDERED

IN_FLIGHT = 0.1 + REORDERED
"""A timeout is judged this much later, s: all earlier measurements have arrived and waited then."""

MOST_NOTED = 500
"""Most events of a run that are noted one by one. A signal that flickers (two publishers, a loose
contact) makes more; each costs a synced journal line, and all of them would delay the stop.
"""

MOST_FALSE_STARTS = 20
"""Most undecided false starts that are noted; for the same reason."""

MOST_ROBOT_WORDS = 20
"""Most different words of the robot that are noted; for the same reason."""

FLICKERS = f"more than {MOST_NOTED} events: a signal flickers; the others stand in the result only"

FALSE_STARTS = frozenset(
    {
        EventName.HANDLE_IS_TOUCHED,
        EventName.DOOR_OPENS,
        EventName.APPROACHES_CW,
        EventName.APPROACHES_CCW,
    }
)
"""What counts as a false start during the countdown (section 7)."""


@dataclass(frozen=True, slots=True)
class Happening:
    """A journal event that no act caused."""

    origin: Origin
    change: Change
    reason: str = ""
    details: dict[str, Any] = field(default_factory=dict)


class RunTracker:
    """Follows a run sample by sample and decides when it starts and stops. Writes nothing.

    Args:
        silence: how long a settle time may wait for a door that went silent, s.
        before: the newest sample of each signal: signals already high are no false start. None:
            false starts are known already, no new ones are judged.
        not_before: the run does not start before this, s since the epoch.
    """

    def __init__(
        self,
        record: RunRecord,
        run: Run,
        silence: float,
        before: Sequence[Sample] | None = (),
        not_before: float = -math.inf,
    ) -> None:
        self._record = record
        self._not_before = not_before
        self._patience = record.thresholds.settle_time + silence
        self._before = before
        self._preroll: list[Sample] = []
        assert run.countdown_began is not None
        self.restart(run, run.countdown_began)

    def restart(self, run: Run, counts_from: float) -> None:
        """The countdown begins or goes on at `counts_from`, s since the epoch."""
        assert run.start is not None
        self._start = run.start
        self.assessment = self._record.assessment(run.start)
        for sample in self._preroll:
            self.assessment.feed(sample)
        self.procedure: Procedure = self.assessment.procedure()
        self.robot_start: float | None = None
        self._robot_words: dict[str, float] = {}
        self._words_noted = 0
        self._noted: set[Event] = set()
        self._early: set[Event] = set()
        self._counts_from = counts_from
        self._judged_from: tuple[int, tuple[Ruling, ...]] = (-1, ())
        self._counting_down = True
        self._watch: EventDetector | None = None
        if self._before is None:
            return
        self._watch = EventDetector(
            self._record.setup.condition,
            counts_from,
            self._record.thresholds,
            handle_zero=self._record.handle_zero,
        )
        for sample in (*self._before, *self._preroll):
            self._watch.feed(sample)

    def feed(self, sample: Sample) -> None:
        self.assessment.feed(sample)
        if self._counting_down:
            self._preroll.append(sample)
        if self._watch is not None:
            self._watch.feed(sample)

    def hear_robot(self, message: RawMessage) -> None:
        """Take the robot's word that it sets out, or its words on its end: the same ones once.

        Before the start neither counts.
        """
        at = seconds(message.receive_ns)
        if at < self._start:
            return
        if message.topic == ROBOT_STARTED_TOPIC:
            self.robot_start = self.robot_start or at
        elif len(self._robot_words) < MOST_ROBOT_WORDS:
            self._robot_words.setdefault(robot_words(message.data), at)

    def advance(self, run: Run, now: float, fed_until: float) -> tuple[Run, list[Happening]]:
        """The run's new state, and what happened.

        `fed_until` is the time up to which all measurements have been fed. Nothing that depends on
        later ones is decided yet. Both times are s since the epoch.
        """
        happened: list[Happening] = []
        self.assessment.release(fed_until)
        if self._watch is not None:
            run = self._hold_at_false_start(run, self._watch, now, happened)
        due = run.held is None and now >= max(self._start, self._not_before)
        if run.phase is Phase.COUNTDOWN and due:
            self._preroll, self._counting_down = [], False
            event = Event(self._start, EventName.BENCHMARK_START)
            happened.append(_event_line(Change.RUN_STARTS, event, Origin.CLOCK))
            run = begin_run(run)
        if run.phase is Phase.RUNNING:
            if fed_until >= self._start + IN_FLIGHT:
                self._watch = None
            run = self._follow(run, now, fed_until, happened)
        return run, happened

    def _hold_at_false_start(
        self, run: Run, watch: EventDetector, now: float, happened: list[Happening]
    ) -> Run:
        """Notes false starts; the first one holds the countdown, if the run has not begun."""
        room = MOST_FALSE_STARTS - sum(mark.accepted is None for mark in run.false_starts)
        for event in watch.events() if room > 0 else ():
            counts = self._start if run.held is None else math.inf
            inside = self._counts_from < event.time < counts
            if event.name not in FALSE_STARTS or not inside or event in self._early or not room:
                continue
            room -= 1
            self._early.add(event)
            mark = FalseStart(event.time, event.name)
            run = replace(run, false_starts=(*run.false_starts, mark))
            happened.append(_event_line(Change.FALSE_START, event))
            if run.phase is Phase.COUNTDOWN and run.held is None:
                run = replace(run, held=min(now, self._start))
                held = {"time": run.held}
                happened.append(Happening(Origin.CLOCK, Change.COUNTDOWN_HELD, details=held))
        return run

    def _follow(self, run: Run, now: float, fed_until: float, happened: list[Happening]) -> Run:
        if run.robot_start is None and self.robot_start is not None:
            run = replace(run, robot_start=self.robot_start)
            answered = {"time": self.robot_start}
            happened.append(Happening(Origin.REMOTE, Change.ROBOT_STARTS, details=answered))
        for words, at in [*self._robot_words.items()][self._words_noted :]:
            self._words_noted += 1
            run = replace(run, robot_words=words)
            happened.append(Happening(Origin.REMOTE, Change.ROBOT_SAYS, words, {"time": at}))
        assert run.setup is not None
        assert run.start is not None
        basis = (self.assessment.changes, run.rulings)
        if basis != self._judged_from or self.procedure.settling:
            self._judged_from = basis
            self._note_events(happened, now)
            self.procedure = self.assessment.procedure(run.rulings)
        limit = run.start + run.setup.timeout
        if run.timeout_at is None and now >= limit:
            run = time_out(run, limit, f"{run.setup.timeout:g} s elapsed")
            details = {"time": limit}
            change = Change.TIMEOUT_ELAPSED
            happened.append(Happening(Origin.CLOCK, change, run.outcome_reason, details))
        completed = self.procedure.completed
        if run.timeout_at is not None and fed_until >= run.timeout_at + IN_FLIGHT:
            return self._time_out(run, run.timeout_at, fed_until, happened)
        if run.timeout_at is None and completed is not None and completed <= limit:
            return _stop(run, Outcome.COMPLETED, completed, "all six steps done", happened)
        return run

    def _note_events(self, happened: list[Happening], now: float) -> None:
        if len(self._noted) >= MOST_NOTED:
            return
        for event in self.assessment.events():
            if event not in self._noted and event.name is not EventName.BENCHMARK_START:
                self._noted.add(event)
                happened.append(_event_line(Change.EVENT, event))
            if len(self._noted) >= MOST_NOTED:
                details = {"time": now, "kind": FaultKind.FLICKERS}
                happened.append(Happening(Origin.SYSTEM, Change.FAULT, FLICKERS, details))
                return

    def _time_out(self, run: Run, limit: float, fed_until: float, happened: list[Happening]) -> Run:
        """Section 2: a timeout that falls into the settle time waits for its end."""
        completed = self.procedure.completed
        closed = self.procedure.steps[Step.CLOSE - 1].final
        if completed is not None and completed <= limit:
            return _stop(run, Outcome.COMPLETED, completed, "all six steps done", happened)
        settling = self.procedure.settling and closed is not None and closed <= limit
        if settling and fed_until < limit + self._patience:
            return run
        return _stop(run, Outcome.TIMEOUT, limit, run.outcome_reason, happened)


def _event_line(change: Change, event: Event, origin: Origin = Origin.SENSOR) -> Happening:
    return Happening(origin, change, details={"event": event.name, "time": event.time})


def _stop(run: Run, outcome: Outcome, at: float, reason: str, happened: list[Happening]) -> Run:
    details = {"outcome": outcome, "time": at}
    happened.append(Happening(Origin.CLOCK, Change.RUN_STOPS, reason, details))
    return stop(run, outcome, at, reason)
