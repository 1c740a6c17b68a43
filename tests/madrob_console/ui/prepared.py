"""A set-up, results and curves that tests of screens prepare, and what scores a run by them."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import chain, repeat

import msgspec

from madrob_console.archive.folders import RESULT_FILE
from madrob_console.engine.core.scored_run import PastRun, RenderedResult, ScoringRequest
from madrob_console.engine.curves import Curve, Curves
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.referee.run_setup import RunSetup
from scoring.assessment import Assessment
from scoring.figure_table import Quantity
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.protocol import (
    BenchmarkType,
    Condition,
    EventName,
    LockDetection,
    Outcome,
    Side,
    Signal,
    StartPose,
)
from scoring.quality import Quality, SignalQuality
from scoring.result import Indicator, Result


def indicators(*, missing: bool = False) -> dict[IndicatorName, Indicator]:
    """All indicators; without a crossing where `missing`."""
    values = chain((17.432, 3.214, 4.5, 12.25, 1.875, 0.0625, 14.75, 6), repeat(1.5))
    gone = (IndicatorName.DOOR_OCCUPATION_TIME, IndicatorName.PASSAGE_TIME)
    return {
        name: Indicator(None, name.spec.unit, "robot never reached the destination side")
        if missing and name in gone
        else Indicator(value, name.spec.unit, None)
        for name, value in zip(IndicatorName, values, strict=False)
    }


def quality(signal: Signal) -> SignalQuality:
    """A good signal."""
    return SignalQuality(signal, 1221, 50.0, 0.0213, 0, 0.0008, 0, 0, 0, 0.004)


def a_setup(run_number: int = 1) -> RunSetup:
    """Condition 1, as the screens propose it at first."""
    return RunSetup(
        subject=1,
        team="Door Bots",
        run_number=run_number,
        condition=Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW),
        start_pose=StartPose(1.5, 0.0, 180.0),
        referee="Ada",
        timeout=300.0,
        countdown=5.0,
        ruleset=RulesetName.PROTOCOL,
        lock_detection=LockDetection.AUTO,
    )


DURATION = 14.0


def wave(height: float, count: int = 752) -> tuple[Curve, ...]:
    """15 s; the largest value, `height`, at 3.75 s."""
    times = [15.0 * i / count for i in range(count)]
    heights = [height * math.sin(t / 15 * math.tau) for t in times]
    return (Curve(tuple(times), tuple(heights)),)


CURVES = Curves(
    DURATION,
    stretches={
        Quantity.POSITION: wave(1.2),
        Quantity.ACCELERATION: wave(-0.68),
        Quantity.JERK: wave(12.5),
        Quantity.FORCE: wave(18.1),
    },
    events=(
        (0.0, EventName.BENCHMARK_START),
        (2.25, EventName.HANDLE_IS_TOUCHED),
        (3.22, EventName.DOOR_OPENS),
        (8.97, EventName.MOVES_TO_CW),
        (13.86, EventName.DOOR_CLOSES),
        (14.0, EventName.BENCHMARK_STOP),
    ),
)


class PreparedScorer(Scorer):
    """Answers a prepared result, with the steps that the engine found."""

    def __init__(self) -> None:
        super().__init__()
        self.indicators: dict[IndicatorName, Indicator] | None = None
        self._data: Assessment | None = None

    def score(self, wanted: ScoringRequest, done: Callable[[RenderedResult], None]) -> None:
        run, data = wanted.run, wanted.assessment or self._data
        setup, start = run.setup, run.start
        assert data is not None
        assert setup is not None
        assert start is not None
        self._data = data
        past = PastRun.of(run, data, run.stop)
        missing = run.outcome is not Outcome.COMPLETED
        result = Result(
            handle_zero=run.handle_zero,
            ruleset=setup.ruleset,
            outcome=run.outcome or Outcome.COMPLETED,
            outcome_reason=run.outcome_reason,
            start=start,
            stop=run.stop,
            indicators=self.indicators or indicators(missing=missing),
            steps=past.procedure.steps,
            lock_detection=LockDetection.SETTLE,
            events=(),
            quality=Quality(tuple(quality(s) for s in list(Signal)[:-1]), ()),
        )
        files = {RESULT_FILE: memoryview(msgspec.json.encode({"issue": run.issue}))}
        curves = memoryview(msgspec.msgpack.encode(CURVES))
        record = wanted.record.corrected(run)
        done(RenderedResult(record, run, result, past, files, curves))
