"""From the samples of one run to its result: live, and the same again from a recording.

An `Assessment` is fed sample by sample while the run goes on; at the stop it gives the result.
Feeding it the samples of a bag in the order in which the bag stores them gives the same result.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from scoring import indicators as pi
from scoring.deciding_edges import DecidingEdge, EdgeKind
from scoring.door_angle import DoorAngle
from scoring.doubts import all_doubts, by_indicator, edge_doubts, information
from scoring.events import EventDetector
from scoring.grounds import Grounds
from scoring.indicator_table import IndicatorName
from scoring.kinematics import JointState, joint_state
from scoring.procedure import Procedure, Ruling, follow_procedure
from scoring.protocol import Condition, Event, EventName, LockDetection, Outcome, Signal, Thresholds
from scoring.quality import AGAINST_OPENING, Quality, QualityCounter
from scoring.rest import RestForce, rest_force
from scoring.result import Ending, EventRecord, Indicator, Result
from scoring.rows import Rows, cut_rows, process_rows
from scoring.rulesets import PROTOCOL, Ruleset
from scoring.samples import DoorSample, HandleSample, Sample
from scoring.uncertainty import uncertainties

_MOST_PROBLEMS = 20
"""Limit of different problems that are listed; random bytes make a new one each time."""
_OTHER_PROBLEMS = "other problems with the recording"


def completed_by_settling(ending: Ending, procedure: Procedure) -> bool:
    """Whether the run was completed by a door that stayed closed (section 5)."""
    settled = procedure.lock_detection is LockDetection.SETTLE
    return settled and ending.outcome is Outcome.COMPLETED


class Assessment:
    """Follows one run from the opening of the recording to its result.

    `start` is the (planned) start, s since the epoch, and `handle_zero` in N. `ruleset` makes the
    result. The protocol's rules find the steps that stop a run, whatever the ruleset (section 9).
    """

    def __init__(
        self,
        condition: Condition,
        start: float,
        *,
        ruleset: Ruleset = PROTOCOL,
        thresholds: Thresholds | None = None,
        lock_detection: LockDetection = LockDetection.AUTO,
        handle_zero: float = 0.0,
    ) -> None:
        self.condition = condition
        self.start = start
        self._ruleset = ruleset
        self._thresholds = thresholds or Thresholds()
        self._lock_detection = lock_detection
        self._zero = handle_zero
        self._live = EventDetector(condition, start, self._thresholds, PROTOCOL, handle_zero)
        self._largest_angle = ruleset.largest_angle(self._thresholds)
        self._largest_force = ruleset.largest_force(self._thresholds)
        self._counters: dict[Signal, QualityCounter] = {}
        self._problems: dict[str, int] = {}
        self._doubted: dict[str, Signal] = {}
        self._top_force = 0.0
        self._against = 0.0
        self._newest: float | None = None
        self._began: float | None = None
        self._ended: float | None = None
        self._prepare()

    def _prepare(self) -> None:
        self._scoring = self._live
        if self._ruleset is not PROTOCOL:
            self._scoring = EventDetector(
                self.condition, self.start, self._thresholds, self._ruleset, self._zero
            )
        self._door_time, self._door_angle = array("d"), array("d")
        self._impossible_angles = array("d")
        self._force_time, self._force = array("d"), array("d")

    @property
    def newest(self) -> float | None:
        """Time of the newest sample, s since the epoch; None before the first."""
        return self._newest

    @property
    def largest_force(self) -> float | None:
        """Largest abs(force) since the start, N; None before any."""
        return self._top_force or None

    def feed(self, sample: Sample) -> None:
        """Take the next sample, in the order of the recording."""
        self._began = sample.log_time if self._began is None else self._began
        self._ended = sample.log_time
        signal = sample.signal
        counter = self._counters.get(signal)
        if counter is None:
            counter = self._counters[signal] = QualityCounter(signal, self._thresholds)
        admitted = counter.admit(sample)
        if admitted is None:
            return
        self._newest = max(self._newest or admitted.time, admitted.time)
        self._admit(admitted)

    def _admit(self, sample: Sample) -> None:
        self._live.feed(sample)
        match sample:
            case DoorSample() if abs(sample.angle) <= self._largest_angle:
                self._door_time.append(sample.time)
                self._door_angle.append(sample.angle)
                against = -sample.angle * self.condition.opening_side.sign
                self._against = max(self._against, against)
            case DoorSample() if math.isfinite(sample.angle):
                self._impossible_angles.append(sample.time)
            case HandleSample() if abs(sample.force) <= self._largest_force:
                self._force_time.append(sample.time)
                self._force.append(sample.force)
                if sample.time >= self.start:
                    self._top_force = max(self._top_force, abs(sample.force))
        if self._scoring is not self._live:
            self._scoring.feed(sample)

    def report_problem(self, text: str, doubts: Signal | None = None) -> None:
        """Count something wrong with the recording that no sample shows.

        What is computed of the signal that it `doubts` has a doubt, too.
        """
        if doubts is not None:
            self._doubted[text] = doubts
        if text not in self._problems and len(self._problems) >= _MOST_PROBLEMS:
            text = _OTHER_PROBLEMS
        self._problems[text] = self._problems.get(text, 0) + 1

    def procedure(self, rulings: Sequence[Ruling] = (), stop: float | None = None) -> Procedure:
        """The six steps as they stand, or of a run stopped at `stop`."""
        return follow_procedure(
            self._live.evidence(stop),
            lock_detection=self._lock_detection,
            settle_time=self._thresholds.settle_time,
            rulings=rulings,
        )

    @property
    def changes(self) -> int:
        """See `EventDetector.changes`; steps also change when a settle time ends."""
        return self._live.changes

    def events(self, newest: int | None = None) -> tuple[Event, ...]:
        """The events so far; see `EventDetector.events`."""
        return self._live.events(newest=newest)

    def provisional(self, procedure: Procedure) -> dict[str, float]:
        """The time indicators known so far, by file name, s; the run can still change them."""
        events = self._live.events(newest=2)  # the last closing is one of them
        indicators = {
            IndicatorName.TIME_TO_HANDLE: pi.time_to_handle(events),
            IndicatorName.DOOR_OCCUPATION_TIME: pi.door_occupation_time(
                events, self.condition, self._ruleset
            ),
            IndicatorName.PASSAGE_TIME: pi.passage_time(events, procedure.done, self._ruleset),
        }
        return {str(name): float(i.value) for name, i in indicators.items() if i.value is not None}

    def provisional_doubts(self) -> dict[str, tuple[str, ...]]:
        """Doubts so far, by file name (section 11); the newest state may not hold yet."""
        certain_until = (self._newest or self.start) - self._thresholds.doubt.gap_reach
        edges = (edge for edge in self._live.deciding() if edge.time <= certain_until)
        doubts = edge_doubts(edges, self._counters, self._thresholds)
        return {str(name): sentences for name, sentences in by_indicator(doubts).items()}

    def quality(self, more: Iterable[str] = ()) -> Quality:
        expected = [s for s in Signal if not s.optional or s in self._counters]
        signals = []
        remarks = []
        for signal in expected:
            counter = self._counters.get(signal)
            if counter is None:
                remarks.append(f"{signal.value}: nothing recorded")
                counter = QualityCounter(signal, self._thresholds)
            quality = counter.quality(self._began, self._ended)
            signals.append(quality)
            remarks += quality.remarks(self._thresholds.largest_skew)
            remarks += [
                f"{signal.value}: clock stepped by {step:+.3f} s, later stamps shifted back"
                for step in counter.guard.steps
            ]
        if self._against > self._thresholds.closed_angle:
            side = self.condition.opening_side.opposite
            remarks.append(
                f"panel turned {self._against:.3f} rad to the {side.upper()} side, "
                f"{AGAINST_OPENING}"
            )
        remarks += [
            text if count == 1 else f"{text} ({count} times)"
            for text, count in self._problems.items()
        ]
        return Quality(tuple(signals), (*remarks, *more))

    def result(
        self,
        ending: Ending,
        rulings: Sequence[Ruling] = (),
        remarks: Iterable[str] = (),
        answered: float | None = None,
    ) -> tuple[Result, Rows]:
        """The result, and its rows. A robot may have `answered` the start, s since the epoch."""
        self._finish()
        end = self._end(ending)
        events = self._scoring.events(end)
        if ending.stop is None:
            events = tuple(e for e in events if e.name is not EventName.BENCHMARK_STOP)
        problem = "run aborted: invalid" if ending.outcome is Outcome.ABORTED else None
        if end < self.start:  # it ended in the countdown
            events, end = (), -math.inf
            problem = problem or "the run never started"
        procedure = self.procedure(rulings, end)
        rest, by_hand = self._rest(ending), self._thresholds.start_uncertainty
        door, joint, whole = self._rows()
        rows_end = end
        if completed_by_settling(ending, procedure):
            rows_end += self._thresholds.settle_time  # a slam ends after the panel has closed
        rows = cut_rows(whole, self.start, rows_end) if self._ruleset.cut_rows else whole
        if problem is not None:
            indicators = {name: Indicator.missing(name, problem) for name in IndicatorName}
        else:
            indicators = pi.compute_indicators(
                events, procedure.done, rows, self.condition, self._ruleset
            )
            passage = indicators[IndicatorName.PASSAGE_TIME]
            denied = next((record for record in procedure.steps if not record.done), None)
            if passage.value is None and denied is not None and denied.denied:
                reason = f"step {denied.step} not done: denied by the referee"
                indicators[IndicatorName.PASSAGE_TIME] = replace(passage, reason=reason)
            grounds = Grounds(
                condition=self.condition,
                start=self.start,
                end=end,
                start_uncertainty=0.0 if answered and answered <= self.start + by_hand else by_hand,
                completed=ending.outcome is Outcome.COMPLETED,
                procedure=procedure,
                evidence=self._live.evidence(end),
                presences=self._live.presences(),
                events=events,
                edges=self._deciding(ending, rulings, end),
                counters=self._counters,
                doubted=self._doubted,
                door=door,
                impossible_angles=np.array(self._impossible_angles),
                guessed=np.array(self._scoring.angles.guesses).reshape(-1, 2),
                force_time=whole.force_time,
                force=whole.force,
                joint=joint,
                rows=rows,
                rows_end=rows_end,
                rest=rest,
                handle_zero=self._zero,
                ruleset=self._ruleset,
                thresholds=self._thresholds,
            )
            indicators = self._trusted(indicators, procedure, grounds)
            remarks = (*remarks, *information(grounds))
        result = Result(
            handle_zero=self._zero,
            ruleset=self._ruleset.name,
            outcome=ending.outcome,
            outcome_reason=ending.reason,
            start=self.start,
            stop=ending.stop,
            indicators=indicators,
            lock_detection=procedure.lock_detection,
            steps=procedure.steps,
            events=tuple(EventRecord.of(event, self.start) for event in events),
            quality=self.quality(remarks),
            rest=rest,
        )
        return result, replace(rows, occupied=self._scoring.presences())

    def _finish(self) -> None:
        for detector in {self._live, self._scoring}:
            detector.finish()

    def _deciding(
        self, ending: Ending, rulings: Sequence[Ruling], end: float
    ) -> tuple[DecidingEdge, ...]:
        """The edges on which indicators depend; only the stop, if seen after a torn recording."""
        edges, thresholds = self._scoring.deciding(end), self._thresholds
        lost = self._newest is not None and self._newest < end
        ruled = any(ruling.time == end for ruling in rulings)
        if ending.outcome is not Outcome.COMPLETED or not lost or ruled:
            return edges
        since, often = end - 1 / thresholds.rate, thresholds.doubt.least_readings
        return (*edges, DecidingEdge(EdgeKind.LOCKING, Signal.LATCH, end, since, often))

    def _trusted(
        self,
        indicators: Mapping[IndicatorName, Indicator],
        procedure: Procedure,
        grounds: Grounds,
    ) -> dict[IndicatorName, Indicator]:
        def times(events: Sequence[Event]) -> dict[IndicatorName, Indicator]:
            done, rows = procedure.done, grounds.rows
            return pi.compute_indicators(
                events, done, rows, self.condition, self._ruleset, pi.TIMES
            )

        uncertain = partial(uncertainties, times=times)
        uncertainty = uncertain(grounds, indicators)
        doubts = all_doubts(grounds, indicators, uncertainty, uncertain)
        return {
            name: replace(
                indicator,
                uncertainty=None if indicator.value is None else uncertainty[name],
                doubts=doubts.get(name, ()),
            )
            for name, indicator in indicators.items()
        }

    def _end(self, ending: Ending) -> float:
        if ending.stop is not None:
            return ending.stop
        return -math.inf if self._newest is None else self._newest

    def _rest(self, ending: Ending) -> RestForce:
        times, forces, thresholds = self._force_time, self._force, self._thresholds
        rest = rest_force(
            times, forces, self.start, zero=self._zero, end=self._newest, thresholds=thresholds
        )
        if ending.outcome is Outcome.COMPLETED:
            return rest
        why = "the run was not completed, the robot may hold the handle"
        return replace(rest, after=None, drift=None, no_after=why)

    def _rows(self) -> tuple[DoorAngle, JointState, Rows]:
        time, angle = np.array(self._door_time), np.array(self._door_angle)
        door = DoorAngle.of(time, angle, self.start, self._thresholds)
        joint = joint_state(time, angle, self._ruleset, self._thresholds)
        force_time, force = np.array(self._force_time), np.array(self._force)
        return door, joint, process_rows(joint, force_time, force, self._ruleset, self._thresholds)
