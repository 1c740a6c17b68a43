from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import MISSING, fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoring import indicator_table
from scoring.indicator_table import IndicatorName
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
from scoring.kinematics import jerk, joint_state, low_pass
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
from scoring.rest import braking_table, door_controller_mode
from scoring.result import Indicator, Uncertainty, distinguishable, uncertainty_text, value_text
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, Ruleset, RulesetName, ruleset

CCW_TO_CW = Condition.from_number(1)
ALL_STEPS = frozenset(Step)
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
RULESETS = st.sampled_from([PROTOCOL, EUROBENCH_2020])


def without(*names: EventName) -> tuple[Event, ...]:
    return tuple(event for event in NOMINAL if event.name not in names)


def test_the_indicators_of_a_nominal_run_follow_from_its_events() -> None:
    assert execution_time(NOMINAL, CCW_TO_CW, PROTOCOL).value == 10.75
    assert time_to_handle(NOMINAL).value == 2.5
    assert door_occupation_time(NOMINAL, CCW_TO_CW, PROTOCOL).value == 4.0
    assert passage_time(NOMINAL, ALL_STEPS, PROTOCOL).value == 8.0
    assert capability_level(NOMINAL, CCW_TO_CW, ALL_STEPS, PROTOCOL).value == 6


def test_published_rules_end_the_execution_at_the_last_closing_or_crossing() -> None:
    assert execution_time(NOMINAL, CCW_TO_CW, EUROBENCH_2020).value == 10.5
    late = (*NOMINAL, Event(22.0, EventName.MOVES_TO_CW))
    assert execution_time(late, CCW_TO_CW, EUROBENCH_2020).value == 12.0


@pytest.mark.parametrize(
    ("ruleset", "lacking", "reason"),
    [
        (PROTOCOL, EventName.BENCHMARK_START, "no benchmark start"),
        (PROTOCOL, EventName.BENCHMARK_STOP, "no benchmark stop"),
        (EUROBENCH_2020, EventName.BENCHMARK_START, "no benchmark start"),
        (EUROBENCH_2020, EventName.DOOR_CLOSES, "door never closed"),
        (EUROBENCH_2020, EventName.MOVES_TO_CW, "robot never reached the destination side"),
    ],
)
def test_execution_time_names_the_event_that_is_missing(
    ruleset: Ruleset, lacking: EventName, reason: str
) -> None:
    assert execution_time(without(lacking), CCW_TO_CW, ruleset).reason == reason


def test_execution_time_of_published_rules_needs_no_stop() -> None:
    events = without(EventName.BENCHMARK_STOP)
    assert execution_time(events, CCW_TO_CW, EUROBENCH_2020).value == 10.5


def test_a_handle_never_touched_has_no_time_to_it() -> None:
    assert time_to_handle(without(EventName.HANDLE_IS_TOUCHED)).reason == "handle never touched"
    assert time_to_handle(without(EventName.BENCHMARK_START)).reason == "no benchmark start"


def test_occupation_counts_from_the_starting_to_the_destination_side_only() -> None:
    cw_to_ccw = Condition.from_number(11)
    approach = "robot never approached on the starting side"
    assert door_occupation_time(NOMINAL, cw_to_ccw, PROTOCOL).reason == approach
    back = (*without(EventName.MOVES_TO_CW), Event(18.0, EventName.MOVES_TO_CCW))
    through = "robot never reached the destination side"
    assert door_occupation_time(back, CCW_TO_CW, PROTOCOL).reason == through


@pytest.mark.parametrize("approach", [18.0, 18.5])
def test_published_rules_want_an_occupation_above_zero(approach: float) -> None:
    events = (Event(approach, EventName.APPROACHES_CCW), Event(18.0, EventName.MOVES_TO_CW))
    published = door_occupation_time(events, CCW_TO_CW, EUROBENCH_2020)
    assert published.reason == "robot left no later than it approached"
    assert door_occupation_time(events, CCW_TO_CW, PROTOCOL).value == 18.0 - approach


@pytest.mark.parametrize(
    ("done", "lacking", "reason"),
    [
        ((), EventName.HANDLE_IS_TOUCHED, "handle never touched"),
        ((Step.TOUCH,), EventName.DOOR_OPENS, "door never opened"),
        ((Step.TOUCH,), EventName.DOOR_IS_LOCKED, "step 3 not done: open the door"),
        (
            (Step.TOUCH, Step.UNLOCK, Step.OPEN),
            EventName.MOVES_TO_CW,
            "robot never reached the destination side",
        ),
        (
            (Step.TOUCH, Step.UNLOCK, Step.OPEN, Step.CROSS),
            EventName.DOOR_CLOSES,
            "door never closed",
        ),
        (
            (Step.TOUCH, Step.UNLOCK, Step.OPEN, Step.CROSS),
            EventName.DOOR_IS_LOCKED,
            "step 5 not done: close the door",
        ),
        (tuple(Step), EventName.HANDLE_IS_TOUCHED, "touch not detected"),
        (tuple(Step), EventName.DOOR_CLOSES, "closing not detected"),
    ],
)
def test_a_passage_needs_touch_opening_crossing_and_closing(
    done: tuple[Step, ...], lacking: EventName, reason: str
) -> None:
    assert passage_time(without(lacking), done, PROTOCOL).reason == reason


def test_a_passage_needs_no_locking() -> None:
    assert passage_time(NOMINAL, ALL_STEPS - {Step.LOCK}, PROTOCOL).value == 8.0


def test_published_rules_time_the_passage_wherever_the_robot_is() -> None:
    events = without(EventName.MOVES_TO_CW)
    assert passage_time(events, (), EUROBENCH_2020).value == 8.0
    events = without(EventName.HANDLE_IS_TOUCHED)
    assert passage_time(events, (), EUROBENCH_2020).reason == "handle never touched"
    events = without(EventName.DOOR_CLOSES)
    assert passage_time(events, (), EUROBENCH_2020).reason == "door never closed"


@pytest.mark.parametrize(
    ("done", "level"),
    [
        (frozenset(), 0),
        ({Step.TOUCH}, 1),
        ({Step.UNLOCK, Step.OPEN, Step.CROSS}, 0),
        ({Step.TOUCH, Step.UNLOCK, Step.OPEN, Step.CLOSE, Step.LOCK}, 3),
        (tuple(Step), 6),
    ],
)
def test_a_step_counts_only_after_all_before_it(
    done: frozenset[Step] | tuple[Step, ...], level: int
) -> None:
    assert capability_level(NOMINAL, CCW_TO_CW, done, PROTOCOL).value == level


def test_published_rules_count_four_events_in_any_order() -> None:
    assert capability_level(NOMINAL, CCW_TO_CW, (), EUROBENCH_2020).value == 4
    backwards = tuple(reversed(without(EventName.HANDLE_IS_TOUCHED)))
    assert capability_level(backwards, CCW_TO_CW, (), EUROBENCH_2020).value == 3
    assert capability_level(NOMINAL, Condition.from_number(11), (), EUROBENCH_2020).value == 2
    assert capability_level((), CCW_TO_CW, ALL_STEPS, EUROBENCH_2020).value == 0


def test_unsafety_is_the_largest_acceleration_of_either_sign() -> None:
    values = np.array([np.nan, 0.5, -2.25, np.inf])
    assert unsafety_of_door_operation(values).value == 2.25
    nothing = np.full(3, np.nan)
    assert unsafety_of_door_operation(nothing, "too slow").reason == "too slow"
    assert (
        unsafety_of_door_operation(nothing).reason == "no acceleration of the door during the run"
    )


def test_smoothness_is_ten_over_the_mean_absolute_jerk() -> None:
    assert smoothness_of_door_actuation(np.array([2.0, -3.0, np.nan]), opened=True).value == 4.0
    none = np.array([])
    assert smoothness_of_door_actuation(none, opened=False).reason == "door never opened"
    unknown = "no acceleration while the door was open"
    assert smoothness_of_door_actuation(none, opened=True).reason == unknown
    assert smoothness_of_door_actuation(none, opened=True, problem="too slow").reason == "too slow"
    still = smoothness_of_door_actuation(np.zeros(4), opened=True)
    assert still.reason == "door stood still while open"


def test_roughness_is_the_largest_force_of_either_sign() -> None:
    assert roughness_of_door_actuation(np.array([5.9, -32.5, np.nan, -np.inf])).value == 32.5
    for nothing in (np.array([]), np.full(2, np.nan)):
        assert roughness_of_door_actuation(nothing).reason == "no handle force recorded"


def test_a_sinusoidal_door_has_the_unsafety_of_its_closed_form() -> None:
    amplitude, omega = 0.5, 2 * math.pi * 0.25
    time = np.arange(2001) / 50
    joint = joint_state(time, 1 + amplitude * np.sin(omega * time), PROTOCOL, Thresholds())
    unsafety = unsafety_of_door_operation(low_pass(joint, PROTOCOL, Thresholds())[500:1500])
    smoothing = 1 - (omega * 0.02) ** 2 * (9**2 - 1) / 24  # of the moving average alone
    assert unsafety.value == pytest.approx(amplitude * omega**2 * smoothing, rel=0.01)
    times, jerks = jerk(joint, PROTOCOL, Thresholds())
    run = (times > 10) & (times <= 30)  # whole periods
    smoothness = smoothness_of_door_actuation(jerks[run], opened=True)
    mean = 2 / math.pi * amplitude * omega**3
    assert smoothness.value == pytest.approx(10 / (mean * smoothing), rel=0.01)


def test_the_indicators_of_eurobench_keep_their_names_and_their_order() -> None:
    names = (
        *("execution_time", "time_to_handle", "door_occupation_time", "passage_time"),
        *("unsafety_of_door_operation", "smoothness_of_door_actuation"),
        *("roughness_of_door_actuation", "capability_level"),
    )
    assert tuple(str(name) for name in IndicatorName if name in names) == names
    assert time_to_handle(NOMINAL).unit == "s"
    assert unsafety_of_door_operation(np.ones(1)).unit == "rad/s^2"


def test_an_indicator_without_its_row_cannot_be_imported() -> None:
    source = Path(indicator_table.__file__).read_text(encoding="utf-8")
    end = "    @property\n    def words"
    forgotten = source.replace(end, f'    FORGOTTEN = "forgotten"\n\n{end}')
    assert forgotten != source
    with pytest.raises(AttributeError, match="name"):
        exec(
            compile(forgotten, "indicator_table.py", "exec"), {"__name__": indicator_table.__name__}
        )


def test_an_indicator_has_either_a_value_or_a_reason() -> None:
    name = IndicatorName.EXECUTION_TIME
    with pytest.raises(ScoringError, match="either a value or the reason"):
        Indicator(None, "s", None)
    with pytest.raises(ScoringError, match="either a value or the reason"):
        Indicator(1.0, "s", "why")
    with pytest.raises(ScoringError, match="nan is no value"):
        Indicator(math.nan, "s", None)
    assert Indicator.of(name, math.inf).reason == "out of the range of numbers"


EVENTS = st.lists(
    st.builds(
        Event,
        st.floats(allow_nan=True, allow_infinity=True).map(np.float64),
        st.sampled_from(EventName),
    ),
    max_size=12,
)
NUMBERS = st.lists(st.floats(width=64), max_size=20).map(lambda rows: np.array(rows, np.float64))


@given(
    EVENTS,
    st.integers(1, 20),
    st.frozensets(st.sampled_from(Step)),
    RULESETS,
    NUMBERS,
    st.booleans(),
)
def test_values_are_plain_finite_numbers_whatever_comes_in(
    events: list[Event],
    number: int,
    done: frozenset[Step],
    ruleset: Ruleset,
    rows: np.ndarray[tuple[int], np.dtype[np.float64]],
    opened: bool,
) -> None:
    condition = Condition.from_number(number)
    indicators = {
        IndicatorName.EXECUTION_TIME: execution_time(events, condition, ruleset),
        IndicatorName.TIME_TO_HANDLE: time_to_handle(events),
        IndicatorName.DOOR_OCCUPATION_TIME: door_occupation_time(events, condition, ruleset),
        IndicatorName.PASSAGE_TIME: passage_time(events, done, ruleset),
        IndicatorName.UNSAFETY_OF_DOOR_OPERATION: unsafety_of_door_operation(rows),
        IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION: smoothness_of_door_actuation(rows, opened),
        IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION: roughness_of_door_actuation(rows),
        IndicatorName.CAPABILITY_LEVEL: capability_level(events, condition, done, ruleset),
    }
    for name, indicator in indicators.items():
        assert indicator.unit == name.spec.unit
        whole = name is IndicatorName.CAPABILITY_LEVEL
        if indicator.value is None:
            assert indicator.reason
        else:
            assert indicator.reason is None
            assert type(indicator.value) is (int if whole else float)
            assert math.isfinite(indicator.value)


@given(st.integers(-(2**40), 2**40), st.integers(1, 20), RULESETS)
def test_a_shift_in_time_changes_no_indicator(shift: int, number: int, ruleset: Ruleset) -> None:
    condition = Condition.from_number(number)
    later = tuple(Event(event.time + shift, event.name) for event in NOMINAL)
    assert execution_time(later, condition, ruleset).value == pytest.approx(
        execution_time(NOMINAL, condition, ruleset).value, abs=1e-3
    )
    here, there = (passage_time(events, ALL_STEPS, ruleset) for events in (NOMINAL, later))
    assert there.value == pytest.approx(here.value, abs=1e-3)


def test_the_sides_of_the_condition_decide_which_passage_events_count() -> None:
    for number in range(1, 21):
        condition = Condition.from_number(number)
        valued = door_occupation_time(NOMINAL, condition, PROTOCOL).value is not None
        assert valued == (condition.starting_side is Side.CCW)


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


def test_a_mean_is_known_better_than_its_values() -> None:
    mean = Uncertainty.of_mean([Uncertainty(0.3, 0.6), Uncertainty(0.4, 0.8)])
    assert mean is not None
    assert mean.u == pytest.approx(0.25)
    assert mean.expanded == pytest.approx(0.5)
    assert Uncertainty.of_mean([Uncertainty(0.3, 0.6)]) == Uncertainty(0.3, 0.6)
    assert Uncertainty.of_mean([Uncertainty(0.3, 0.6), None]) is None
    assert Uncertainty.of_mean([]) is None


def test_a_mean_of_values_that_scatter_is_known_no_better_than_they_repeat() -> None:
    parts = [Uncertainty(0.01, 0.02)] * 4
    assert Uncertainty.of_mean(parts, 3.0) == Uncertainty(1.5, 3.0)
    measured = Uncertainty.of_mean(parts)
    assert measured == Uncertainty.of_mean(parts, 0.0) == Uncertainty.of_mean(parts, 0.0099)
    assert Uncertainty.of_mean([*parts, None], 3.0) is None


def test_every_name_finds_its_ruleset() -> None:
    assert ruleset("protocol") is PROTOCOL
    assert ruleset("eurobench-2020") is EUROBENCH_2020
    assert {ruleset(name).name for name in RulesetName} == set(RulesetName)


def test_an_unknown_name_is_refused_with_the_allowed_ones() -> None:
    with pytest.raises(ScoringError, match=r"'eurobench'.*protocol or eurobench-2020"):
        ruleset("eurobench")


def test_the_two_differ_in_every_choice_but_share_filter_orders_and_frequencies() -> None:
    shared = {"window_time", "savgol_order", "low_pass_order", "low_pass_frequency"}
    for field in fields(Ruleset):
        same = getattr(PROTOCOL, field.name) == getattr(EUROBENCH_2020, field.name)
        has_default = field.default is not MISSING  # what further rulesets choose between
        assert same == (field.name in shared) or has_default, field.name
    assert PROTOCOL.savgol_window != EUROBENCH_2020.savgol_window


@pytest.mark.parametrize("benchmark_type", BenchmarkType)
def test_braking_tables_have_a_force_for_each_of_181_degrees(benchmark_type: BenchmarkType) -> None:
    table = braking_table(benchmark_type, Side.CW)
    assert len(table) == 181
    assert braking_table(benchmark_type, Side.CCW) == tuple(reversed(table))


def test_braking_tables_brake_where_the_protocol_says() -> None:
    sudden_force = braking_table(BenchmarkType.SUDDEN_FORCE, Side.CW)
    assert (sudden_force[111], sudden_force[112], sudden_force[180]) == (0, 4000, 4000)
    sudden_ramp = braking_table(BenchmarkType.SUDDEN_RAMP, Side.CW)
    assert sudden_ramp[112:130] == (
        *(2000, 2000, 3000, 3000, 5000, 5000),
        *(8000,) * 3,
        *(12000,) * 3,
        *(20000,) * 5,
        0,
    )
    wind = braking_table(BenchmarkType.WIND_RAMP, Side.CW)
    borders = [i for i in range(1, 181) if wind[i] != wind[i - 1]]
    assert borders == [7, 18, 33, 53, 130, 150, 165, 176]
    assert [wind[i] for i in (0, *borders)] == [0, 1000, 2000, 3000, 4000, 3000, 2000, 1000, 0]


def test_only_no_force_switches_the_brake_off() -> None:
    off = [kind for kind in BenchmarkType if door_controller_mode(kind) == 0]
    assert off == [BenchmarkType.NO_FORCE]
    assert set(braking_table(BenchmarkType.NO_FORCE, Side.CW)) == {0}
    assert set(braking_table(BenchmarkType.CONSTANT_FORCE, Side.CCW)) == {4000}


@pytest.mark.machine
def test_what_screens_import_loads_no_slow_library() -> None:
    code = (
        "import sys, scoring.rulesets, scoring.rest, scoring.indicators;"
        "import scoring.eurobench.run_info;"
        "print(sorted({'scipy', 'pandas'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
