"""From the samples of one run to its result: live, and the same again from a recording.

An `Assessment` is fed sample by sample while the run goes on; at the stop it gives the result.
Feeding it the samples of a bag in the order in which the bag stores them gives the same result.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from scoring import indicators as pi
from scoring.doubts import Grounds, by_indicator, doubted, edge_doubts, information
from scoring.events import EventDetector
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.procedure import Procedure, Ruling, follow_procedure
from scoring.protocol import Condition, Event, EventName, LockDetection, Outcome, Signal, Thresholds
from scoring.quality import Quality
from scoring.rest import RestForce, rest_force
from scoring.result import Ending, EventRecord, Indicator, Result
from scoring.rows import Rows, process_rows
from scoring.samples import HandleSample, Sample
from scoring.series import SignalLog, Signals, WholeSeries, passage_series, signal_quality
from scoring.stamps import ReorderBuffer, StampGuard
from scoring.uncertainty import Recorded, uncertainties

_MOST_PROBLEMS = 20
"""Limit of different problems that are listed; random bytes make a new one each time."""

_OTHER_PROBLEMS = "other problems with the recording"

_CERTAIN = 0.2
"""How long an edge may still turn out to rest on few samples, s."""


class Assessment:
    """Follows one run from the opening of the recording to its result.

    `start` is the (planned) start, s since the epoch, and `handle_zero` in N. `ruleset` makes the
    result. The protocol's rules find the steps that stop a run, whatever the ruleset (section 9).

    Attributes:
        newest: time of the newest sample, s since the epoch; None before the first.
        lost: what did not get into the recording, in words of the engine that made it.
    """

    def __init__(
        self,
        condition: Condition,
        start: float,
        *,
        ruleset: RulesetName = RulesetName.PROTOCOL,
        thresholds: Thresholds | None = None,
        lock_detection: LockDetection = LockDetection.AUTO,
        handle_zero: float = 0.0,
    ) -> None:
        self.condition = condition
        self.start = start
        self.newest: float | None = None
        self.lost: tuple[str, ...] = ()
        self._ruleset = ruleset
        self._thresholds = thresholds or Thresholds()
        self._lock_detection = lock_detection
        self._zero = handle_zero
        self._detector = EventDetector(condition, start, self._thresholds, handle_zero)
        self._guards = {signal: StampGuard() for signal in Signal}
        self._logs = {signal: SignalLog() for signal in Signal}
        self._buffer = ReorderBuffer()
        self._problems: dict[str, int] = {}
        self._misread: dict[str, Signal] = {}
        self._top_force = 0.0
        self._recorded: tuple[float, float] | None = None

    @property
    def largest_force(self) -> float | None:
        """Largest abs(force) since the start, N.

        None before any.
        """
        return self._top_force or None

    @property
    def is_in_order(self) -> bool:
        """Whether events were found in the order of stamps, as from a recording.

        Where a sample came too late for that, the recording has to be read.
        """
        return self._buffer.is_in_order

    @property
    def changes(self) -> int:
        """How often events changed. Steps also change where a settle time ends."""
        return self._detector.changes

    def feed(self, sample: Sample) -> None:
        """Take the next sample, in the order of the recording."""
        began = sample.log_time if self._recorded is None else self._recorded[0]
        self._recorded = (began, sample.log_time)
        admitted = self._guards[sample.signal].admit(sample)
        if admitted is not None:
            self.newest = max(self.newest or admitted.time, admitted.time)
            self._logs[sample.signal].add(admitted)
            if isinstance(admitted, HandleSample) and admitted.time >= self.start:
                force = abs(admitted.force)
                if self._top_force < force <= self._thresholds.impossible_force:
                    self._top_force = force
            self._buffer.add(admitted)

    def release(self, now: float) -> None:
        """Find the events of what was received 0.25 s before log time `now`, s.

        With inf, of all.
        """
        for sample in self._buffer.release(now):
            self._detector.feed(sample)

    def report_problem(self, text: str, doubts: Signal | None = None) -> None:
        """Count something wrong with the recording that no sample shows.

        What is computed of the signal that it `doubts` has a doubt, too.
        """
        if doubts is not None:
            self._misread[text] = doubts
        if text not in self._problems and len(self._problems) >= _MOST_PROBLEMS:
            text = _OTHER_PROBLEMS
        self._problems[text] = self._problems.get(text, 0) + 1

    def procedure(self, rulings: Sequence[Ruling] = (), stop: float | None = None) -> Procedure:
        """The six steps as far as samples were released, or of a run stopped at `stop`."""
        return follow_procedure(
            self._detector.evidence(stop),
            lock_detection=self._lock_detection,
            settle_time=self._thresholds.settle_time,
            rulings=rulings,
        )

    def events(self, newest: int | None = None) -> tuple[Event, ...]:
        """Return the events so far (see `EventDetector.events`)."""
        return self._detector.events(newest=newest)

    def provisional(self, procedure: Procedure) -> dict[str, float]:
        """The time indicators known so far, by file name, s.

        The run can still change them.
        """
        events = self._detector.events(newest=2)  # the last closing is one of them
        indicators = {
            IndicatorName.TIME_TO_HANDLE: pi.time_to_handle(events),
            IndicatorName.DOOR_OCCUPATION_TIME: pi.door_occupation_time(events, self.condition),
            IndicatorName.PASSAGE_TIME: pi.passage_time(events, procedure.done),
        }
        return {str(name): float(i.value) for name, i in indicators.items() if i.value is not None}

    def provisional_doubts(self) -> dict[str, tuple[str, ...]]:
        """Doubts on edges so far, by file name (section 11)."""
        until = (self.newest or self.start) - _CERTAIN
        edges = [edge for edge in self._detector.deciding() if edge.time <= until]
        doubts = edge_doubts(edges, self._logs, self._zero, self._thresholds)
        return {str(name): sentences for name, sentences in by_indicator(doubts).items()}

    def quality(self) -> Quality:
        return self._quality(self._signals(), ())

    def result(
        self,
        ending: Ending,
        rulings: Sequence[Ruling] = (),
        remarks: Iterable[str] = (),
        answered: float | None = None,
    ) -> tuple[Result, Rows]:
        """Return the result and its rows.

        A robot may have `answered` the start, s since the epoch.
        """
        self.release(math.inf)
        end = self._end(ending)
        procedure = self.procedure(rulings, end)
        signals = self._signals()
        events = self._events(ending, signals)
        rest = self._rest(ending, signals)
        rows_end = self._rows_end(ending, procedure)
        rows = self._whole_rows(signals)
        if self._ruleset is RulesetName.PROTOCOL:
            rows = rows.cut(self.start, rows_end)

        if ending.outcome is Outcome.ABORTED:
            indicators = _no_indicators("run aborted: invalid")
        elif end < self.start:
            indicators = _no_indicators("the run never started")
        elif self._ruleset is RulesetName.EUROBENCH_2020:
            from scoring.eurobench import values_2020  # it loads pandas

            indicators = values_2020(events, rows, self.condition)
        else:
            values = self._indicators(events, procedure, rows)
            run = self._recorded_run(ending, rows_end, signals, rest, answered)
            grounds = self._grounds(run, end, procedure, values)
            indicators = doubted(grounds)
            remarks = (*remarks, *information(grounds))
        result = Result(
            handle_zero=self._zero,
            ruleset=self._ruleset,
            outcome=ending.outcome,
            outcome_reason=ending.reason,
            start=self.start,
            stop=ending.stop,
            indicators=indicators,
            lock_detection=procedure.lock_detection,
            steps=procedure.steps,
            events=tuple(EventRecord.of(event, self.start) for event in events),
            quality=self._quality(signals, remarks),
            rest=rest,
        )
        return result, replace(rows, occupied=self._detector.presences())

    def series(self, ending: Ending, rulings: Sequence[Ruling]) -> WholeSeries:
        """All that was measured.

        Call it once the recording has been read to its end.
        """
        self.release(math.inf)
        signals = self._signals()
        end = self._rows_end(ending, self.procedure(rulings, self._end(ending)))
        door, latch = self._readings(signals)[Signal.DOOR], signals[Signal.LATCH]
        rows, rows_from = self._whole_rows(signals), self.start
        if self._ruleset is RulesetName.EUROBENCH_2020:
            rows_from, end = -math.inf, math.inf
        return WholeSeries(
            rows=rows,
            rows_from=rows_from,
            rows_until=end,
            passage=passage_series(signals, door, self._thresholds),
            latch_time=latch.time,
            latch_engaged=latch.value > 0,
        )

    def _signals(self) -> Signals:
        return {signal: log.series(signal) for signal, log in self._logs.items()}

    def _readings(self, signals: Signals) -> Signals:
        """With door angles and forces that a sensor can say alone."""
        door = signals[Signal.DOOR].within(self._thresholds.largest_angle)
        handle = signals[Signal.HANDLE].within(self._thresholds.impossible_force)
        return {**signals, Signal.DOOR: door, Signal.HANDLE: handle}

    def _whole_rows(self, signals: Signals) -> Rows:
        if self._ruleset is RulesetName.EUROBENCH_2020:
            from scoring.eurobench import whole_rows_2020

            return whole_rows_2020(signals, self._thresholds)
        read = self._readings(signals)
        door, handle = read[Signal.DOOR], read[Signal.HANDLE]
        return process_rows(door.time, door.value, handle.time, handle.value, self._thresholds)

    def _indicators(
        self, events: Sequence[Event], procedure: Procedure, rows: Rows
    ) -> dict[IndicatorName, Indicator]:
        indicators = pi.compute_indicators(events, procedure.done, rows, self.condition)
        passage = indicators[IndicatorName.PASSAGE_TIME]
        denied = next((record for record in procedure.steps if not record.done), None)
        if passage.value is None and denied is not None and denied.denied:
            reason = f"step {denied.step} not done: denied by the referee"
            indicators[IndicatorName.PASSAGE_TIME] = replace(passage, reason=reason)
        return indicators

    def _events(self, ending: Ending, signals: Signals) -> Sequence[Event]:
        end = self._end(ending)
        if end < self.start:  # it ended in the countdown
            return ()
        if self._ruleset is RulesetName.EUROBENCH_2020:
            from scoring.eurobench import Recording, events_2020

            latch_events = self._detector.latch_events()
            recording = Recording(signals, self.start, end, self._zero, latch_events)
            events: Sequence[Event] = events_2020(recording, self.condition, self._thresholds)
        else:
            events = self._detector.events(end)
        if ending.stop is None:
            events = [event for event in events if event.name is not EventName.BENCHMARK_STOP]
        return events

    def _recorded_run(
        self,
        ending: Ending,
        rows_end: float,
        signals: Signals,
        rest: RestForce,
        answered: float | None,
    ) -> Recorded:
        by_hand = self._thresholds.start_uncertainty
        if answered and answered <= self.start + by_hand:
            by_hand = 0.0  # the robot answered the start at once
        return Recorded(
            start=self.start,
            rows_end=rows_end,
            by_hand=by_hand,
            completed=ending.outcome is Outcome.COMPLETED,
            signals=self._readings(signals),
            edges=self._detector.deciding(self._end(ending)),
            rest=rest,
            thresholds=self._thresholds,
        )

    def _grounds(
        self,
        run: Recorded,
        end: float,
        procedure: Procedure,
        values: Mapping[IndicatorName, Indicator],
    ) -> Grounds:
        return Grounds(
            run=run,
            end=end,
            condition=self.condition,
            handle_zero=self._zero,
            logs=self._logs,
            presences=self._detector.presences(),
            procedure=procedure,
            evidence=self._detector.evidence(end),
            misread=self._misread,
            values=values,
            uncertainty=uncertainties(run),
        )

    def _end(self, ending: Ending) -> float:
        if ending.stop is not None:
            return ending.stop
        return -math.inf if self.newest is None else self.newest

    def _rows_end(self, ending: Ending, procedure: Procedure) -> float:
        """The end of motion and force: a slam ends after the panel has closed (section 5)."""
        settled = procedure.lock_detection is LockDetection.SETTLE
        if settled and ending.outcome is Outcome.COMPLETED:
            return self._end(ending) + self._thresholds.settle_time
        return self._end(ending)

    def _rest(self, ending: Ending, signals: Signals) -> RestForce:
        handle = self._readings(signals)[Signal.HANDLE]
        rest = rest_force(
            handle.time,
            handle.value,
            self.start,
            zero=self._zero,
            end=self.newest or self.start,
            thresholds=self._thresholds,
        )
        if ending.outcome is Outcome.COMPLETED:
            return rest
        why = "the run was not completed, the robot may hold the handle"
        return replace(rest, after=None, drift=None, no_after=why)

    def _quality(self, signals: Signals, more: Iterable[str]) -> Quality:
        recorded = self._recorded or (self.start, self.start)
        qualities = [
            signal_quality(signal, series, self._guards[signal], recorded, self._thresholds)
            for signal, series in signals.items()
            if series.time.size or not signal.optional
        ]
        remarks = [
            text if count == 1 else f"{text} ({count} times)"
            for text, count in self._problems.items()
        ]
        angles = signals[Signal.DOOR].within(self._thresholds.largest_angle).value
        against = float((-self.condition.opening_side.sign * angles).max(initial=0.0))
        return Quality(
            tuple(qualities),
            remarks=(*remarks, *more),
            lost=self.lost,
            against_opening=against if against > self._thresholds.closed_angle else 0.0,
        )


def _no_indicators(reason: str) -> dict[IndicatorName, Indicator]:
    return {name: Indicator.missing(name, reason) for name in IndicatorName}
