from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from scoring import indicator_table
from scoring.indicator_table import IndicatorName, RulesetName, ruleset
from scoring.indicators import (
    capability_level,
    door_occupation_time,
    execution_time,
    passage_time,
    roughness_of_door_actuation,
    smoothness_of_door_actuation,
    time_to_handle,
    unsafety_of_door_operation,
)
from scoring.kinematics import JointState
from scoring.protocol import (
    BenchmarkType,
    Condition,
    Event,
    EventName,
    ScoringError,
    Side,
    Step,
    Thresholds,
)
from scoring.result import Indicator, Uncertainty, distinguishable, uncertainty_text, value_text
from scoring.rows import Rows
from scoring.run_info import braking_table, door_controller_mode

CCW_TO_CW, CW_TO_CCW = Condition.from_number(1), Condition.from_number(11)
NOMINAL = (
    Event(10.0, EventName.BENCHMARK_START),
    Event(12.5, EventName.HANDLE_IS_TOUCHED),
    Event(13.0, EventName.DOOR_OPENS),
    Event(14.0, EventName.APPROACHES_CCW),
    Event(18.0, EventName.MOVES_TO_CW),
    Event(19.0, EventName.DOOR_CLOSES),
    Event(19.2, EventName.DOOR_OPENS),
    Event(20.5, EventName.DOOR_CLOSES),
    Event(20.75, EventName.BENCHMARK_STOP),
)
FOUR = {Step.TOUCH, Step.UNLOCK, Step.OPEN, Step.CROSS}
NAN = np.full(2, np.nan)


def without(*names: EventName) -> tuple[Event, ...]:
    return tuple(event for event in NOMINAL if event.name not in names)


BACK = (*without(EventName.MOVES_TO_CW), Event(18.0, EventName.MOVES_TO_CCW))


def rows(
    *,
    low: list[float] | None = None,
    jerk: list[float] | None = None,
    opened: bool = True,
    problem: str | None = None,
) -> Rows:
    time = np.arange(2.0)
    joint = JointState(time, np.full(2, 0.5 if opened else 0.0), NAN, NAN, problem)
    low_passed, jerks = np.array(low or NAN), np.array(jerk or [])
    return Rows(joint, low_passed, jerks, jerks, time, time, problem, Thresholds())


@pytest.mark.parametrize(
    ("indicator", "found"),
    [
        (lambda: execution_time(NOMINAL), 10.75),
        (lambda: execution_time(without(EventName.BENCHMARK_START)), "no benchmark start"),
        (lambda: execution_time(without(EventName.BENCHMARK_STOP)), "no benchmark stop"),
        (lambda: time_to_handle(NOMINAL), 2.5),
        (lambda: time_to_handle(without(EventName.HANDLE_IS_TOUCHED)), "handle never touched"),
        (lambda: door_occupation_time(NOMINAL, CCW_TO_CW), 4.0),
        (
            lambda: door_occupation_time(NOMINAL, CW_TO_CCW),
            "robot never approached on the starting side",
        ),
        (
            lambda: door_occupation_time(BACK, CCW_TO_CW),
            "robot never reached the destination side",
        ),
        (lambda: passage_time(NOMINAL, set(Step)), 8.0),
        (lambda: passage_time(NOMINAL, set(Step) - {Step.LOCK}), 8.0),  # it needs no locking
        (lambda: passage_time(without(EventName.HANDLE_IS_TOUCHED), set()), "handle never touched"),
        (lambda: passage_time(NOMINAL, {Step.TOUCH}), "step 3 not done: open the door"),
        (
            lambda: passage_time(NOMINAL, FOUR - {Step.CROSS}),
            "robot never reached the destination side",
        ),
        (lambda: passage_time(without(EventName.DOOR_CLOSES), FOUR), "door never closed"),
        (
            lambda: passage_time(without(EventName.HANDLE_IS_TOUCHED), set(Step)),
            "touch not detected",
        ),
        (lambda: capability_level(set()), 0),  # a step counts only after all before it
        (lambda: capability_level({Step.UNLOCK, Step.OPEN}), 0),
        (lambda: capability_level(set(Step) - {Step.CROSS}), 3),
        (lambda: capability_level(set(Step)), 6),
        (lambda: unsafety_of_door_operation(rows(low=[0.5, -2.25])), 2.25),
        (lambda: unsafety_of_door_operation(rows(problem="too slow")), "too slow"),
        (
            lambda: unsafety_of_door_operation(rows()),
            "no acceleration of the door during the run",
        ),
        (lambda: smoothness_of_door_actuation(rows(jerk=[2.0, -3.0])), 4.0),
        (lambda: smoothness_of_door_actuation(rows(opened=False)), "door never opened"),
        (
            lambda: smoothness_of_door_actuation(rows()),
            "no acceleration while the door was open",
        ),
        (
            lambda: smoothness_of_door_actuation(rows(jerk=[0.0] * 4)),
            "door stood still while open",
        ),
        (lambda: roughness_of_door_actuation(np.array([5.9, -32.5, np.nan, -np.inf])), 32.5),
        (lambda: roughness_of_door_actuation(NAN), "no handle force recorded"),
        (
            lambda: Indicator.of(IndicatorName.EXECUTION_TIME, math.inf),
            "out of the range of numbers",
        ),
    ],
)
def test_an_indicator_has_its_value_or_the_reason(
    indicator: Callable[[], Indicator], found: float | str
) -> None:
    told = (None, found) if isinstance(found, str) else (found, None)
    assert (indicator().value, indicator().reason) == told


@pytest.mark.parametrize(
    ("value", "reason", "words"),
    [
        (None, None, "either a value or the reason"),
        (1.0, "why", "either a value or the reason"),
        (math.nan, None, "nan is no value"),
    ],
)
def test_an_indicator_has_either_a_value_or_a_reason(
    value: float | None, reason: str | None, words: str
) -> None:
    with pytest.raises(ScoringError, match=words):
        Indicator(value, "s", reason)


def test_the_indicators_of_eurobench_keep_their_names_and_their_order() -> None:
    names = (
        *("execution_time", "time_to_handle", "door_occupation_time", "passage_time"),
        *("unsafety_of_door_operation", "smoothness_of_door_actuation"),
        *("roughness_of_door_actuation", "capability_level"),
    )
    assert tuple(str(name) for name in IndicatorName if name in names) == names
    assert time_to_handle(NOMINAL).unit == "s"


def test_an_indicator_without_its_row_cannot_be_imported() -> None:
    source = Path(indicator_table.__file__).read_text(encoding="utf-8")
    end = "    @property\n    def words"
    forgotten = source.replace(end, f'    FORGOTTEN = "forgotten"\n\n{end}')
    assert forgotten != source
    with pytest.raises(AttributeError, match="name"):
        exec(
            compile(forgotten, "indicator_table.py", "exec"), {"__name__": indicator_table.__name__}
        )


@pytest.mark.parametrize(
    ("value", "expanded", "value_words", "uncertainty_words"),
    [
        (13.8621, 0.018, "13.86", "+- 0.02"),
        (13.8621, 0.012, "13.86", "+- 0.02"),  # rounded up: never less than there is
        (13.4, 0.43, "13.4", "+- 0.5"),
        (1.0, 0.096, "1.0", "+- 0.1"),
        (130.4, 12.0, "130", "+- 20"),
        (0.0, 0.02, "0.00", "+- 0.02"),
        (0.001, 1e-5, "1.00e-03", "+- 1e-05"),
        (60.0, 0.0, "60", ""),  # a timeout: exact
        (47.12, 0.0, "47.12", ""),
        (12.7602, 0.0, "12.76", ""),  # declared: no more digits than beside it
        (0.0, 0.0, "0", ""),
        (1e-3, 0.0, "1.0000e-03", ""),
        (4, 0.0, "4", ""),
    ],
)
def test_a_value_has_the_digits_that_its_uncertainty_leaves(
    value: float, expanded: float, value_words: str, uncertainty_words: str
) -> None:
    uncertainty = Uncertainty(expanded / 2, expanded)
    assert value_text(value, uncertainty) == value_words
    assert uncertainty_text(uncertainty) == uncertainty_words


def test_a_value_of_which_no_uncertainty_is_known_has_four_decimals() -> None:
    assert value_text(13.86214) == "13.8621"
    assert uncertainty_text(None) == ""


@pytest.mark.parametrize(
    ("one", "two", "expanded", "apart"),
    [
        (10.0, 10.3, (0.1, 0.1), True),
        (10.0, 10.3, (0.1, 0.25), False),
        (10.0, 10.0, (0.1, 0.1), False),
        (5, 6, (0.0, 0.0), True),
        (6, 6, (0.0, 0.0), True),  # equal is more than not distinguishable
        (10.0, 10.3, (0.2, None), True),  # nothing is known of one
    ],
)
def test_values_whose_uncertainties_overlap_are_not_distinguishable(
    one: float, two: float, expanded: tuple[float, float | None], apart: bool
) -> None:
    first, second = (None if each is None else Uncertainty(each / 2, each) for each in expanded)
    assert distinguishable(one, two, first, second) is apart
    assert distinguishable(two, one, second, first) is apart


FOURFOLD = [Uncertainty(0.01, 0.02)] * 4


@pytest.mark.parametrize(
    ("parts", "scatter", "mean"),
    [
        ([Uncertainty(0.3, 0.6), Uncertainty(0.4, 0.8)], 0.0, (0.25, 0.5)),  # better known
        ([Uncertainty(0.3, 0.6)], 0.0, (0.3, 0.6)),
        ([Uncertainty(0.3, 0.6), None], 0.0, None),
        ([], 0.0, None),
        (FOURFOLD, 0.006, (0.005, 0.01)),
        (FOURFOLD, 3.0, (1.5, 3.19 * 1.5)),  # no better than they repeat
        ([*FOURFOLD, None], 3.0, None),
    ],
)
def test_a_mean_is_known_as_its_values_are_and_as_they_repeat(
    parts: list[Uncertainty | None], scatter: float, mean: tuple[float, float] | None
) -> None:
    found = Uncertainty.of_mean(parts, scatter)
    assert (found and (found.u, found.expanded)) == (mean and pytest.approx(mean))


def test_every_name_finds_its_ruleset_and_another_is_refused_with_them() -> None:
    assert {ruleset(name) for name in RulesetName} == set(RulesetName)
    with pytest.raises(ScoringError, match=r"'eurobench'.*protocol or eurobench-2020"):
        ruleset("eurobench")


@pytest.mark.parametrize(
    ("kind", "mode", "steps"),
    [
        (BenchmarkType.NO_FORCE, 0, {0: 0}),
        (BenchmarkType.CONSTANT_FORCE, 1, {0: 4000}),
        (BenchmarkType.SUDDEN_FORCE, 1, {0: 0, 112: 4000}),
        (
            BenchmarkType.SUDDEN_RAMP,
            1,
            {0: 0, 112: 2000, 114: 3000, 116: 5000, 118: 8000, 121: 12000, 124: 20000, 129: 0},
        ),
        (
            BenchmarkType.WIND_RAMP,
            1,
            {
                0: 0,
                7: 1000,
                18: 2000,
                33: 3000,
                53: 4000,
                130: 3000,
                150: 2000,
                165: 1000,
                176: 0,
            },
        ),
    ],
)
def test_braking_tables_brake_where_the_protocol_says(
    kind: BenchmarkType, mode: int, steps: dict[int, int]
) -> None:
    table = braking_table(kind, Side.CW)
    found = {i: force for i, force in enumerate(table) if i == 0 or force != table[i - 1]}
    assert (found, len(table), door_controller_mode(kind)) == (steps, 181, mode)
    assert braking_table(kind, Side.CCW) == tuple(reversed(table))
