"""The result of a run that was published as EUROBENCH files (protocol sections 6 to 9).

Events and acceleration are taken from the files as they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from scoring.assessment import completed_by_settling
from scoring.eurobench.run_files import EurobenchRun, door_stays_closed, recorded_until
from scoring.events import Evidence
from scoring.indicator_table import IndicatorName
from scoring.indicators import compute_indicators
from scoring.procedure import Procedure, follow_procedure
from scoring.protocol import Event, EventName, LockDetection, Outcome, Thresholds
from scoring.quality import Quality
from scoring.result import Ending, EventRecord, Result
from scoring.rows import Rows, cut_rows, process_rows
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, Ruleset, RulesetName
from scoring.rulesets import ruleset as ruleset_called
from scoring.signals import Edge

_AS_PUBLISHED = "scored from published files: events as they stand there"
_NO_UNCERTAINTY = (
    "no uncertainty is known of the values, and nothing is doubted of them: only the csv files are "
    "there, not the recording"
)


def evaluate_published(
    run: EurobenchRun, ruleset: Ruleset = PROTOCOL, thresholds: Thresholds | None = None
) -> tuple[Result, Rows]:
    """Score a published run, whose event file has no `benchmark_stop`.

    The stop is the time of step 6, judged from the door angle, if the steps are complete.
    Remarks say where the recording may give another outcome or another unsafety.
    """
    thresholds = thresholds or Thresholds()
    stop = _last(run.events, EventName.BENCHMARK_STOP)
    procedure = follow_procedure(
        _evidence(run, stop, thresholds),
        lock_detection=LockDetection.AUTO,
        settle_time=thresholds.settle_time,
    )
    ending = _ending(procedure, stop)
    events = run.events
    if stop is None and ending.stop is not None:
        until_stop = tuple(e for e in events if e.time <= ending.stop)
        events = (*until_stop, Event(ending.stop, EventName.BENCHMARK_STOP))
    elif stop is not None and not ruleset.passage_events_to_end:
        events = tuple(_until_stop(events, stop))
    wrench = run.wrench
    rows = process_rows(run.joint_state, wrench.time, wrench.force, ruleset, thresholds)
    end = math.inf if ending.stop is None else ending.stop
    if completed_by_settling(ending, procedure):
        end += thresholds.settle_time
    if ruleset.cut_rows:
        rows = cut_rows(rows, run.start_time, end)
    indicators = compute_indicators(events, procedure.done, rows, run.condition, ruleset)
    remarks = [_AS_PUBLISHED, _NO_UNCERTAINTY, *_missing_rows(run, ending.stop, thresholds)]
    remarks += _made_otherwise(run, ruleset)
    if indicators[IndicatorName.UNSAFETY_OF_DOOR_OPERATION].value is not None:
        remarks += _filter_edges(run, ruleset, end)
    result = Result(
        handle_zero=0.0,
        ruleset=ruleset.name,
        outcome=ending.outcome,
        outcome_reason=ending.reason,
        start=run.start_time,
        stop=ending.stop,
        indicators=indicators,
        lock_detection=procedure.lock_detection,
        steps=procedure.steps,
        events=tuple(EventRecord.of(event, run.start_time) for event in events),
        quality=Quality(remarks=tuple(remarks)),
    )
    return result, rows


def _missing_rows(run: EurobenchRun, stop: float | None, thresholds: Thresholds) -> Iterator[str]:
    limit = thresholds.largest_gap
    end = run.events[-1].time if stop is None else stop
    for name, times in (("jointState", run.joint_state.time), ("wrench", run.wrench.time)):
        if not times.size:
            yield f"{name}: no rows"
            continue
        intervals = np.diff(times)
        gaps = intervals[intervals > limit]
        if (late := float(times[0]) - run.start_time) > limit:
            yield f"{name}: no rows in the first {late:.1f} s of the run"
        if gaps.size:
            yield f"{name}: {gaps.size} gaps, the longest {gaps.max():.3f} s"
        if (early := end - float(times[-1])) > limit:
            yield f"{name}: no rows in the last {early:.1f} s of the run"


def _made_otherwise(run: EurobenchRun, ruleset: Ruleset) -> Iterator[str]:
    rules = _rules_of(run)
    name = "other rules" if rules is None else rules.name
    # the steps are always the protocol's
    if rules is None or _passage_rules(rules) != _passage_rules(PROTOCOL):
        yield (
            f"steps and outcome: judged by the passage events of {name}, which stand in the "
            "files; the recording may give another outcome"
        )
    if rules is None or _filter_rules(rules) != _filter_rules(ruleset):
        yield (
            f"unsafety and smoothness: from acceleration as {name} filters it, which stands "
            "in the files; the recording gives other values"
        )


def _filter_edges(run: EurobenchRun, ruleset: Ruleset, end: float) -> Iterator[str]:
    """A remark if the low-pass filter begins or ends within the run, where its files are cut."""
    joint = run.joint_state
    times = joint.time[np.isfinite(joint.acceleration)]
    rules = _rules_of(run)
    if not (ruleset.cut_rows or (rules is not None and rules.cut_rows)):
        return
    sides = []
    if times[0] >= run.start_time:
        sides.append("before")
    if times[-1] <= end:
        sides.append("after")
    if sides:
        yield (
            f"unsafety: the files have no acceleration from {' and '.join(sides)} the run, so the "
            "low-pass filter has an edge within it; the recording may give another value, by up to "
            "a quarter where the door slams there"
        )


def _rules_of(run: EurobenchRun) -> Ruleset | None:
    """The rules by which the files were made; None if they name others than these."""
    name = run.run_info.get("ruleset", EUROBENCH_2020.name)
    return ruleset_called(str(name)) if name in [*RulesetName] else None


def _passage_rules(rules: Ruleset) -> tuple[object, ...]:
    return (
        rules.present_height,
        rules.masked_is_absent,
        rules.passage_events_to_end,
    )


def _filter_rules(rules: Ruleset) -> tuple[object, ...]:
    return (
        rules.windows,
        rules.window_time,
        rules.savgol_window,
        rules.savgol_order,
    )


def _until_stop(events: Sequence[Event], stop: float) -> Iterator[Event]:
    """Events until the stop; who leaves later has left at it (section 7, "at the stop")."""
    left = {EventName.MOVES_TO_CW, EventName.MOVES_TO_CCW}
    for event in events:
        if event.name is EventName.BENCHMARK_STOP:
            yield from (Event(stop, e.name) for e in events if e.time > stop and e.name in left)
        if event.time <= stop:
            yield event


def _ending(procedure: Procedure, stop: float | None) -> Ending:
    if procedure.completed is not None:
        done = procedure.completed if stop is None else stop
        return Ending(Outcome.COMPLETED, "all six steps done", done)
    if stop is not None:
        return Ending(Outcome.TIMEOUT, "steps are missing at the stop", stop)
    return Ending(Outcome.INTERRUPTED, "steps are missing and no stop is recorded", None)


def _evidence(run: EurobenchRun, stop: float | None, thresholds: Thresholds) -> Evidence:
    closed = _last(run.events, EventName.DOOR_CLOSES)
    crossed = _last(run.events, EventName.moves_to(run.condition.destination_side))
    recorded_end = None
    if closed is not None and door_stays_closed(run.joint_state, closed, thresholds):
        recorded_end = recorded_until(run.joint_state, thresholds)
    return Evidence(
        start=run.start_time,
        stop=stop,
        touched=_last(run.events, EventName.HANDLE_IS_TOUCHED),
        door=_edges(run.events, EventName.DOOR_OPENS, EventName.DOOR_CLOSES),
        door_seen=recorded_end,
        latch=_edges(run.events, EventName.DOOR_IS_LOCKED, EventName.DOOR_IS_UNLOCKED),
        latch_before_start=any(e.name is EventName.DOOR_IS_UNLOCKED for e in run.events),
        crossed=crossed if crossed is None or stop is None else min(crossed, stop),
    )


def _edges(events: Sequence[Event], up: EventName, down: EventName) -> tuple[Edge, ...]:
    return tuple(Edge(e.time, e.name is up) for e in events if e.name in (up, down))


def _last(events: Sequence[Event], name: EventName) -> float | None:
    return max((e.time for e in events if e.name is name), default=None)
