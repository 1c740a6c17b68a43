"""From samples to a result."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from scoring.assessment import Assessment
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.procedure import Ruling
from scoring.protocol import (
    PASSAGE_SENSORS,
    EventName,
    Outcome,
    Side,
    Step,
    Thresholds,
)
from scoring.result import Ending, Result
from scoring.samples import DoorSample, HandleSample, PassageSample, Sample
from scoring.series import PassageSeries
from tests.scoring.clean_run import clean, scored
from tests.scoring.runs import (
    CONDITION,
    START,
    assessment,
    door,
    handle,
    latch,
    passage_through,
    sensor,
    under,
)

COMPLETED = Ending(Outcome.COMPLETED, "all six steps done", START + 6)


def steady_run() -> list[Sample]:
    """The whole run at 50 Hz: the door opens at 3 s to 1 rad and closes at 6 s."""
    others = [s for s in passage_through() if s.signal.name not in ("DOOR", "HANDLE")]
    times = [i / 50 for i in range(-50, 400)]
    samples: list[Sample] = [*others]
    samples += [
        door(t, max(0.0, math.sin((t - 3) * math.pi / 3) if 3 < t < 6 else 0)) for t in times
    ]
    samples += [handle(t, 20.0 if 2 <= t < 2.5 else 0.1) for t in times]
    return sorted(samples, key=lambda s: s.time)


STEADY = steady_run()


def result(ending: Ending = COMPLETED, ruleset: RulesetName = RulesetName.PROTOCOL) -> Result:
    return assessment(STEADY, ruleset=ruleset).result(ending)[0]


REASON = dict.fromkeys(IndicatorName, "run aborted: invalid")
NEVER = dict.fromkeys(IndicatorName, "the run never started")
CUT_OFF = Ending(Outcome.INTERRUPTED, "cut off", None)
DENIED = Ruling(Step.CROSS, False, START + 9, "arm only", "R")


@pytest.mark.parametrize(
    ("samples", "ending", "rulings", "found"),
    [
        pytest.param(
            STEADY, Ending(Outcome.ABORTED, "on fire", START + 4), [], REASON, id="aborted"
        ),
        pytest.param(
            STEADY,
            CUT_OFF,
            [],
            {
                IndicatorName.EXECUTION_TIME: "no benchmark stop",
                IndicatorName.TIME_TO_HANDLE: 2.0,
            },
            id="cut off, what can be computed stays",
        ),
        pytest.param(
            [door(-1, 0.5), handle(-1, 10.0)], CUT_OFF, [], NEVER, id="cut off in the countdown"
        ),
        pytest.param(
            STEADY,
            Ending(Outcome.TIMEOUT, "5.5 s elapsed", START + 5.5),
            [],
            {IndicatorName.PASSAGE_TIME: "door never closed", IndicatorName.CAPABILITY_LEVEL: 4},
            id="timeout before the closing",
        ),
        pytest.param(
            STEADY,
            COMPLETED,
            [DENIED],
            {
                IndicatorName.CAPABILITY_LEVEL: 3,
                IndicatorName.PASSAGE_TIME: "step 4 not done: denied by the referee",
                IndicatorName.EXECUTION_TIME: 6.0,
                IndicatorName.DOOR_OCCUPATION_TIME: 1.0,
            },
            id="denied",
        ),
    ],
)
def test_each_indicator_has_its_value_or_its_reason(
    samples: list[Sample],
    ending: Ending,
    rulings: list[Ruling],
    found: dict[IndicatorName, float | str],
) -> None:
    result, _ = assessment(samples).result(ending, rulings)
    told = {name: result.indicators[name].reason or result.indicators[name].value for name in found}
    assert told == found
    if found is NEVER:
        assert result.events == ()
        assert {step.final for step in result.steps} == {None}


@pytest.mark.parametrize(
    ("ending", "last"),
    [
        (Ending(Outcome.ABORTED, "robot on fire", START + 4), EventName.BENCHMARK_STOP),
        (Ending(Outcome.ABORTED, "", START - 1), None),
        (CUT_OFF, EventName.DOOR_CLOSES),
    ],
)
def test_a_run_without_a_stop_has_no_event_of_it(ending: Ending, last: EventName | None) -> None:
    events = [event.event for event in result(ending).events]
    assert events[-1:] == ([] if last is None else [last])


def test_rows_cover_the_run_and_its_settle_time() -> None:
    _, rows = assessment(STEADY).result(COMPLETED)
    assert rows.joint_state.time[0] >= START
    assert START + 6.9 < rows.joint_state.time[-1] <= START + 7
    assert math.isfinite(rows.joint_state.acceleration[0])  # the filters saw the pre-roll
    _, cut = assessment(STEADY).result(Ending(Outcome.TIMEOUT, "", START + 6))
    assert cut.joint_state.time[-1] <= START + 6


def test_a_ruling_changes_level_and_what_depends_on_it_and_nothing_else() -> None:
    run = assessment(STEADY)
    before, after = (run.result(COMPLETED, rulings)[0].indicators for rulings in ((), [DENIED]))
    changed = {name for name in IndicatorName if before[name] != after[name]}
    assert changed == {IndicatorName.CAPABILITY_LEVEL, IndicatorName.PASSAGE_TIME}


@pytest.mark.parametrize("ruleset", RulesetName)
def test_a_run_without_data_has_reasons_only(ruleset: RulesetName) -> None:
    found = assessment([], ruleset=ruleset).result(COMPLETED)[0]
    for name, indicator in found.indicators.items():
        if name is IndicatorName.CAPABILITY_LEVEL:
            assert indicator.value == 0
        elif name is not IndicatorName.EXECUTION_TIME:
            assert indicator.reason
    assert all("nothing recorded" in [*one.remarks()] for one in found.quality.signals)


def test_panel_against_the_opening_side_is_kept_in_the_quality() -> None:
    samples = [*STEADY, door(9, -0.05), door(9.02, -0.05)]
    assert assessment(samples).quality().against_opening == pytest.approx(0.05)
    assert assessment([*STEADY, door(9, -0.03)]).quality().against_opening == 0.0


@pytest.mark.parametrize(("limit", "remarked"), [(0.1, True), (0.2, False)])
def test_stamps_that_differ_from_reception_are_remarked_from_the_testbeds_limit_on(
    limit: float, remarked: bool
) -> None:
    times = [START + i / 50 for i in range(100)]
    samples = [DoorSample(time, time + 0.15, 0.0) for time in times]
    found = assessment(samples, thresholds=Thresholds(largest_skew=limit)).quality()
    told = "stamps differ from reception by up to 0.150 s"
    assert (told in found.signals[0].remarks()) is remarked


PLACE = PASSAGE_SENSORS.index(sensor(Side.CW, 2))


def passage(samples: list[Sample]) -> PassageSeries:
    return assessment(samples).series(Ending(Outcome.TIMEOUT, "", START + 1), ()).passage


def of(series: PassageSeries, place: int = PLACE) -> tuple[list[float], list[int], list[bool]]:
    rows = series.sensor == place
    return (
        series.distance[rows].tolist(),
        series.present[rows].tolist(),
        series.masked[rows].tolist(),
    )


def looked(time: float, distance: float) -> PassageSample:
    place = sensor(Side.CW, 2)
    ranges = [2.0] * 4
    ranges[place.element] = distance
    return PassageSample(START + time, START + time, place.strip, tuple(ranges), 0.0, 2.5)


def test_what_is_no_reading_is_empty_and_changes_no_state() -> None:
    series = passage([looked(0, math.nan), looked(1, math.inf), looked(2, 0.8), looked(3, 9.0)])
    distances, present, _ = of(series)
    np.testing.assert_array_equal(distances, [math.nan, math.inf, 0.8, math.nan])
    assert present == [-1, 0, 1, 1]


def test_a_masked_sensor_keeps_its_state() -> None:
    samples: list[Sample] = [
        looked(0, 0.8),
        door(0.5, -0.2),
        looked(1, 2.0),
        door(1.5, -0.6),
        looked(2, 2.0),
    ]
    assert Thresholds().masked(Side.CW, 2, -0.2)
    distances, present, masked = of(passage(samples))
    assert distances == [0.8, 2.0, 2.0]
    assert present == [1, 1, 0]
    assert masked == [False, True, False]


def test_stamps_are_those_that_count() -> None:
    late = DoorSample(START - 0.1, START + 0.1, 0.1)  # backward
    once = under(1, Side.CW)
    samples: list[Sample] = [door(0, 0.0), late, once, once, latch(2, True)]
    series = assessment(samples).series(Ending(Outcome.TIMEOUT, "", START + 1), ())
    assert series.rows.joint_state.time.tolist() == [START]
    strip = sensor(Side.CW, 2).strip
    assert series.passage.time.tolist() == [START + 1] * sum(
        one.strip is strip for one in PASSAGE_SENSORS
    )
    assert (series.latch_time.tolist(), series.latch_engaged.tolist()) == ([START + 2], [True])


@pytest.mark.parametrize(
    ("rules", "rows"),
    [
        (RulesetName.PROTOCOL, (START, START + 7.0)),
        (RulesetName.EUROBENCH_2020, (-math.inf, math.inf)),
    ],
)
def test_rows_that_count_end_with_the_settle_time(
    rules: RulesetName, rows: tuple[float, float]
) -> None:
    series = assessment(passage_through(), ruleset=rules).series(COMPLETED, ())
    assert (series.rows_from, series.rows_until) == rows


def test_a_late_message_scores_as_one_in_time() -> None:
    late = [replace(s, log_time=s.time + 0.2) if isinstance(s, DoorSample) else s for s in STEADY]
    late.sort(key=lambda sample: sample.log_time)

    found = Assessment(CONDITION, START)
    for sample in late:
        found.feed(sample)
        found.release(sample.log_time)

    assert found.result(COMPLETED)[0].events == result().events


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_number_of_numpy_is_a_number(kind: Callable[[float], float]) -> None:
    def typed(sample: Sample) -> Sample:
        match sample:
            case DoorSample():
                return replace(sample, angle=kind(sample.angle))
            case HandleSample():
                return replace(sample, force=kind(sample.force))
            case PassageSample():
                return replace(sample, ranges=tuple(map(kind, sample.ranges)))
        return sample

    plain, other = (scored(each) for each in (clean(), [typed(each) for each in clean()]))
    assert other.events == plain.events
    assert other.indicators[IndicatorName.CAPABILITY_LEVEL].value == 6
