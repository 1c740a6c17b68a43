"""The result of a run that was published as EUROBENCH files (protocol sections 6 to 9).

Events and acceleration are taken from the files as they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from scoring.eurobench.run_files import EurobenchRun, door_stays_closed, recorded_until
from scoring.evaluate import completed_by_settling
from scoring.events import Evidence
from scoring.indicators import compute_indicators
from scoring.procedure import Procedure, follow_procedure
from scoring.protocol import Event, EventName, LockDetection, Outcome, Thresholds
from scoring.quality import Quality
from scoring.result import Ending, EventRecord, Result
from scoring.rows import Rows, cut_rows, process_rows
from scoring.rulesets import PROTOCOL, Ruleset
from scoring.signals import Edge

_AS_PUBLISHED = "scored from published files: events as they stand there"


def evaluate_published(
    run: EurobenchRun, ruleset: Ruleset = PROTOCOL, thresholds: Thresholds | None = None
) -> tuple[Result, Rows]:
    """Score a published run.

    Published event files have no `benchmark_stop`: the stop is then the time of step 6 where the
    steps are complete (judged from the door angle); else there is none.

    Args:
        run: as read from its files.
        ruleset: whose rules.
        thresholds: the testbed's numbers.
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
        kept = tuple(e for e in events if e.time <= ending.stop)
        events = (*kept, Event(ending.stop, EventName.BENCHMARK_STOP))
    wrench = run.wrench
    rows = process_rows(run.joint_state, wrench.time, wrench.force, ruleset, thresholds)
    if ruleset.cut_rows:
        end = math.inf if ending.stop is None else ending.stop
        if completed_by_settling(ending, procedure):
            end += thresholds.settle_time
        rows = cut_rows(rows, run.start_time, end)
    indicators = compute_indicators(events, procedure.done, rows, run.condition, ruleset)
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
        quality=Quality(remarks=(_AS_PUBLISHED, *_missing_rows(run, ending.stop, thresholds))),
    )
    return result, rows


def _missing_rows(run: EurobenchRun, stop: float | None, thresholds: Thresholds) -> Iterator[str]:
    """Where the files have no rows, in words: files can be cut off, and rows get lost."""
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
    seen = None
    if closed is not None and door_stays_closed(run.joint_state, closed, thresholds):
        seen = recorded_until(run.joint_state, thresholds)
    return Evidence(
        start=run.start_time,
        stop=stop,
        touched=_last(run.events, EventName.HANDLE_IS_TOUCHED),
        door=_edges(run.events, EventName.DOOR_OPENS, EventName.DOOR_CLOSES),
        door_seen=seen,
        latch=_edges(run.events, EventName.DOOR_IS_LOCKED, EventName.DOOR_IS_UNLOCKED),
        latch_before_start=any(e.name is EventName.DOOR_IS_UNLOCKED for e in run.events),
        crossed=crossed,
    )


def _edges(events: Sequence[Event], up: EventName, down: EventName) -> tuple[Edge, ...]:
    return tuple(Edge(e.time, e.name is up) for e in events if e.name in (up, down))


def _last(events: Sequence[Event], name: EventName) -> float | None:
    return max((e.time for e in events if e.name is name), default=None)
