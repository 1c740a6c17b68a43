"""The course of one run, from its countdown to its stop: what the sensors and the clock decide."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from madrob_console.archive.run_record import RunRecord
from madrob_console.referee.journal import Origin
from madrob_console.referee.on_record import FalseStart
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.transitions import begin_run, stop, time_out
from scoring.evaluate import LiveAssessment
from scoring.events import EventDetector
from scoring.procedure import Procedure, Ruling
from scoring.protocol import Event, EventName, Outcome, Step
from scoring.samples import Sample

IN_FLIGHT = 0.1
"""A timeout is judged this much later, s: by then what was measured before it has arrived."""

MOST_NOTED = 500
"""Events of a run that are noted one by one. More come of a signal that flickers (two publishers,
a loose contact); each costs a synced line of the journal, and all of them would delay the stop."""

MOST_FALSE_STARTS = 20
"""False starts of a countdown that are noted; for the same reason."""

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
    """Something that no act brought about, for the journal."""

    origin: Origin
    change: Change
    reason: str = ""
    details: dict[str, Any] = field(default_factory=dict)


class Course:
    """Follows a run sample by sample and decides when it starts and stops. Writes nothing.

    Args:
        record: what is set for the run.
        run: its state as the countdown begins.
        assess: a new assessment of a run that is planned to start then, s since the epoch.
        silence: how long a settle time may wait for a door that went silent, s.
        before: the newest sample of each signal; what is up before the countdown is no false
            start. None: what was a false start is known already, nothing is taken for one.
    """

    def __init__(
        self,
        record: RunRecord,
        run: Run,
        assess: Callable[[RunRecord, float], LiveAssessment],
        silence: float,
        before: Sequence[Sample] | None = (),
    ) -> None:
        self._record = record
        self._assess = assess
        self._patience = record.thresholds.settle_time + silence
        self._before = before
        self._preroll: list[Sample] = []
        self.restart(run)

    def restart(self, run: Run) -> None:
        """The countdown begins (again): the run has another planned start."""
        assert run.start is not None
        assert run.countdown_began is not None
        self.assessment: LiveAssessment = self._assess(self._record, run.start)
        for sample in self._preroll:
            self.assessment.feed(sample)
        self.procedure: Procedure = self.assessment.procedure()
        self._known: set[Event] = set()
        self._judged: tuple[int, tuple[Ruling, ...]] = (-1, ())
        self._counting_down = True
        self._watch: EventDetector | None = None
        if self._before is None:
            return
        self._watch = EventDetector(
            self._record.setup.condition,
            run.countdown_began,
            self._record.thresholds,
            handle_zero=self._record.handle_zero,
        )
        for sample in (*self._before, *self._preroll):
            self._watch.feed(sample)

    def feed(self, sample: Sample) -> None:
        """Take the next sample of the recording."""
        self.assessment.feed(sample)
        if self._counting_down:
            self._preroll.append(sample)
        if self._watch is not None:
            self._watch.feed(sample)

    def advance(self, run: Run, now: float, seen: float) -> tuple[Run, list[Happening]]:
        """What has become of the run, and what happened.

        Args:
            run: its state.
            now: s since the epoch.
            seen: up to when all that was measured has been fed, s since the epoch: what depends on
                that is not judged before.
        """
        happened: list[Happening] = []
        if run.phase is Phase.COUNTDOWN:
            run = self._count_down(run, now, happened)
        if run.phase is Phase.RUNNING:
            run = self._follow(run, now, seen, happened)
        return run, happened

    def _count_down(self, run: Run, now: float, happened: list[Happening]) -> Run:
        start, began = run.start, run.countdown_began
        assert start is not None
        assert began is not None
        seen: Sequence[Event] = ()
        if self._watch is not None and len(self._known) < MOST_FALSE_STARTS:
            seen = self._watch.events()
        for event in seen:
            if len(self._known) >= MOST_FALSE_STARTS:
                break
            inside = began < event.time < start
            if event.name in FALSE_STARTS and inside and event not in self._known:
                self._known.add(event)
                mark = FalseStart(event.time, event.name)
                run = replace(run, false_starts=(*run.false_starts, mark))
                happened.append(_seen(Change.FALSE_START, event))
        if now < start:
            return run
        self._watch, self._preroll, self._known, self._counting_down = None, [], set(), False
        details = {"time": start}
        happened.append(Happening(Origin.CLOCK, Change.RUN_STARTS, details=details))
        return begin_run(run)

    def _follow(self, run: Run, now: float, seen: float, happened: list[Happening]) -> Run:
        assert run.setup is not None
        assert run.start is not None
        judged = (self.assessment.changes, run.rulings)
        if judged != self._judged or self.procedure.settling:
            self._judged = judged
            self._note_events(happened, now)
            self.procedure = self.assessment.procedure(run.rulings)
        limit = run.start + run.setup.timeout
        if run.timeout_at is None and now >= limit:
            run = time_out(run, limit, f"{run.setup.timeout:g} s elapsed")
            details = {"time": limit}
            change = Change.TIMEOUT_ELAPSED
            happened.append(Happening(Origin.CLOCK, change, run.outcome_reason, details))
        completed = self.procedure.completed
        if run.timeout_at is not None and seen >= run.timeout_at + IN_FLIGHT:
            return self._time_out(run, run.timeout_at, seen, happened)
        if run.timeout_at is None and completed is not None:
            return _stop(run, Outcome.COMPLETED, completed, "all six steps done", happened)
        return run

    def _note_events(self, happened: list[Happening], now: float) -> None:
        if len(self._known) >= MOST_NOTED:
            return
        for event in self.assessment.events():
            if event not in self._known and event.name is not EventName.BENCHMARK_START:
                self._known.add(event)
                happened.append(_seen(Change.EVENT, event))
            if len(self._known) >= MOST_NOTED:
                details = {"time": now}
                happened.append(Happening(Origin.SYSTEM, Change.FAULT, FLICKERS, details))
                return

    def _time_out(self, run: Run, limit: float, seen: float, happened: list[Happening]) -> Run:
        """Section 2: a timeout that falls into the settle time waits for its end."""
        completed = self.procedure.completed
        closed = self.procedure.steps[Step.CLOSE - 1].final
        if completed is not None and completed <= limit:
            return _stop(run, Outcome.COMPLETED, completed, "all six steps done", happened)
        settling = self.procedure.settling and closed is not None and closed <= limit
        if settling and seen < limit + self._patience:
            return run
        return _stop(run, Outcome.TIMEOUT, limit, run.outcome_reason, happened)


def _seen(change: Change, event: Event) -> Happening:
    return Happening(Origin.SENSOR, change, details={"event": event.name, "time": event.time})


def _stop(run: Run, outcome: Outcome, at: float, reason: str, happened: list[Happening]) -> Run:
    details = {"outcome": outcome, "time": at}
    happened.append(Happening(Origin.CLOCK, Change.RUN_STOPS, reason, details))
    return stop(run, outcome, at, reason)
