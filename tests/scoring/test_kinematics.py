from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scoring.kinematics import JointState, jerk, joint_state, low_pass, low_pass_problem
from scoring.protocol import ScoringError, Thresholds
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, Ruleset

Array = NDArray[np.float64]

EPOCH = 1_580_487_388.0
BOTH = pytest.mark.parametrize("ruleset", [PROTOCOL, EUROBENCH_2020], ids=lambda r: str(r.name))


def grid(rate: float, duration: float) -> Array:
    return np.arange(round(rate * duration) + 1) / rate


NUMBERS = Thresholds()


def defined(joint: JointState) -> NDArray[np.bool_]:
    return np.isfinite(joint.acceleration)


def gains(rate: float, average: int, savgol: int, omega: float) -> tuple[float, float]:
    """What the two filters make of a sinusoid: factor of its velocity and its acceleration."""
    step = omega / rate
    mean = math.sin(average * step / 2) / (average * math.sin(step / 2))
    k = np.arange(-(savgol // 2), savgol // 2 + 1)
    slope = float(np.sum(k * np.sin(k * step)) / np.sum(k**2)) / step
    square = k**2 - np.mean(k**2)
    curvature = -2 * float(np.sum(square * np.cos(k * step)) / np.sum(square**2)) / step**2
    return mean * slope, mean * curvature


@pytest.mark.parametrize(
    ("ruleset", "rate", "average", "savgol"),
    [
        (PROTOCOL, 50, 9, 9),
        (PROTOCOL, 100, 19, 19),
        (PROTOCOL, 55, 11, 11),
        (PROTOCOL, 11, 3, 3),
        (EUROBENCH_2020, 50, 11, 11),
        (EUROBENCH_2020, 100, 21, 11),
        (EUROBENCH_2020, 12, 5, 11),
    ],
)
def test_a_swinging_door_keeps_what_the_windows_let_through(
    ruleset: Ruleset, rate: int, average: int, savgol: int
) -> None:
    amplitude, omega = 0.8, 2 * math.pi * 0.5
    time = grid(rate, 8)
    joint = joint_state(time, amplitude * np.sin(omega * time), ruleset, NUMBERS)
    velocity_gain, acceleration_gain = gains(rate, average, savgol, omega)
    velocity = velocity_gain * amplitude * omega * np.cos(omega * time)
    acceleration = -acceleration_gain * amplitude * omega**2 * np.sin(omega * time)
    edge = average // 2 + savgol // 2
    assert np.flatnonzero(defined(joint)).tolist() == list(range(edge, time.size - edge))
    inner = slice(edge, time.size - edge)
    np.testing.assert_allclose(joint.velocity[inner], velocity[inner], atol=1e-9)
    np.testing.assert_allclose(joint.acceleration[inner], acceleration[inner], atol=1e-8)


@pytest.mark.parametrize("frequency", [0.5, 1.0, 2.0, 3.0])
def test_the_low_pass_attenuates_like_a_butterworth_of_order_five_and_in_place(
    frequency: float,
) -> None:
    rate = 50
    time = grid(rate, 60)
    acceleration = np.sin(2 * math.pi * frequency * time)
    joint = JointState(time, np.ones(time.size), acceleration.copy(), acceleration)
    ratio = math.tan(math.pi * frequency / rate) / math.tan(math.pi * 2 / rate)
    middle = slice(1000, 2000)
    expected = acceleration[middle] / (1 + ratio**10)
    np.testing.assert_allclose(low_pass(joint, PROTOCOL, NUMBERS)[middle], expected, atol=1e-8)
    once = low_pass(joint, EUROBENCH_2020, NUMBERS)[middle]  # forward only: delayed
    gain = 1 / math.sqrt(1 + ratio**10)
    assert np.max(np.abs(once)) == pytest.approx(gain, rel=2e-3)
    assert np.max(np.abs(once - gain * acceleration[middle])) > 0.4 * gain


@given(st.integers(0, 2**32 - 1), st.sampled_from([(50, 9), (100, 19), (49.6, 9), (50.6, 11)]))
def test_the_windows_follow_the_rate_rounded_to_whole_hertz_whatever_the_jitter(
    seed: int, rate: tuple[float, int]
) -> None:
    hertz, window = rate
    jitter = np.random.default_rng(seed).uniform(-0.2, 0.2, 400) * (hertz in (50, 100))
    time = EPOCH + (np.arange(400) + jitter) / hertz
    joint = joint_state(time, np.sin(time), PROTOCOL, NUMBERS)
    edge = 2 * (window // 2)
    assert np.flatnonzero(~defined(joint)).tolist() == [*range(edge), *range(400 - edge, 400)]
    assert np.array_equal(np.isnan(joint.velocity), ~defined(joint))


def test_a_gap_empties_the_rows_whose_windows_span_it() -> None:
    kept = np.r_[0:60, 66:150]
    time = grid(50, 3)[kept[kept < 151]]
    position = np.sin(time)
    joint = joint_state(time, position, PROTOCOL, NUMBERS)
    empty = [*range(8), *range(52, 68), *range(136, 144)]
    assert np.flatnonzero(~defined(joint)).tolist() == empty
    assert np.isfinite(low_pass(joint, PROTOCOL, NUMBERS)).tolist() == defined(joint).tolist()
    times, _ = jerk(joint, PROTOCOL, NUMBERS)
    assert not ((times > time[51]) & (times <= time[68])).any()
    # the published scripts know one series only
    assert np.flatnonzero(~defined(joint_state(time, position, EUROBENCH_2020, NUMBERS))).size == 20


def test_an_interval_as_long_as_the_largest_gap_is_none() -> None:
    time = grid(64, 3)[np.r_[0:60, 64:150]]  # the interval across is 5/64 s
    whole = joint_state(time, np.sin(time), PROTOCOL, replace(NUMBERS, largest_gap=5 / 64))
    assert defined(whole)[50:70].all()
    split = joint_state(time, np.sin(time), PROTOCOL, replace(NUMBERS, largest_gap=4.9 / 64))
    assert not defined(split)[58:62].any()


def test_a_gap_stays_out_of_the_sampling_interval() -> None:
    first = grid(50, 2)
    time = np.r_[first, first + 30]
    joint = joint_state(time, 0.5 * time, PROTOCOL, NUMBERS)
    np.testing.assert_allclose(joint.velocity[np.isfinite(joint.velocity)], 0.5, atol=1e-9)


def test_a_stretch_too_short_for_the_low_pass_has_no_values_of_it() -> None:
    long, short = grid(50, 2), 10 + grid(50, 0.66)
    time = np.r_[long, short]  # 34 rows: 18 with an acceleration, one too few
    joint = joint_state(time, np.sin(time), PROTOCOL, NUMBERS)
    assert defined(joint)[long.size :].sum() == 18
    low = np.isfinite(low_pass(joint, PROTOCOL, NUMBERS))
    assert low[: long.size].any()
    assert not low[long.size :].any()


NO_STRETCH = "no stretch of acceleration without gaps is long enough for the low-pass filter"


@pytest.mark.parametrize(
    ("ruleset", "rate", "rows", "reason", "low_reason"),
    [
        *(
            (
                PROTOCOL,
                rate,
                20 * rate + 1,
                f"door angle at {rate} Hz: too slow for the filters",
                "",
            )
            for rate in (10, 8, 1)
        ),
        (EUROBENCH_2020, 4, 121, None, "door angle at 4 Hz: too slow for the filters"),
        (PROTOCOL, 50, 34, None, NO_STRETCH),
        *(
            (ruleset, 50, rows, reason, "")
            for ruleset in (PROTOCOL, EUROBENCH_2020)
            for rows, reason in (
                (0, "no door angle recorded"),
                (1, "too few door angles recorded for the filters"),
                (5, "too few door angles recorded for the filters"),
                (16, "no stretch of the door angle without gaps is long enough for the filters"),
            )
        ),
    ],
)
def test_what_the_filters_cannot_do_has_a_reason(
    ruleset: Ruleset, rate: int, rows: int, reason: str | None, low_reason: str
) -> None:
    time = np.arange(rows) / rate
    joint = joint_state(time, np.sin(time), ruleset, NUMBERS)
    assert (joint.reason, joint.acceleration.size) == (reason, rows)
    low = low_pass(joint, ruleset, NUMBERS)
    assert low.size == np.isnan(low).sum() == rows
    assert low_pass_problem(joint, ruleset, NUMBERS) == (low_reason or reason)
    assert bool(defined(joint).any()) == (reason is None)
    assert (jerk(joint, ruleset, NUMBERS)[1].size > 0) == (reason is None)


@BOTH
def test_rows_without_a_reading_are_left_out(ruleset: Ruleset) -> None:
    time = grid(50, 4)
    position = np.sin(time)
    position[[0, 70, 71]], position[120] = np.nan, np.inf
    read = np.isfinite(position)
    joint = joint_state(time, position, ruleset, NUMBERS)
    same = joint_state(time[read], position[read], ruleset, NUMBERS)
    assert joint.time.tolist() == time[read].tolist()
    np.testing.assert_array_equal(joint.acceleration, same.acceleration)


@BOTH
def test_positions_out_of_range_leak_no_infinity(ruleset: Ruleset) -> None:
    time = grid(50, 4)
    position = np.sin(time)
    position[100:110] = 1.7e308
    joint = joint_state(time, position, ruleset, NUMBERS)
    for values in (joint.velocity, joint.acceleration, low_pass(joint, ruleset, NUMBERS)):
        assert not np.isinf(values).any()
    assert np.isfinite(jerk(joint, ruleset, NUMBERS)[1]).all()


def test_times_that_do_not_increase_are_refused() -> None:
    with pytest.raises(ScoringError, match="drop duplicate and backward stamps"):
        joint_state(np.array([0.0, 0.02, 0.02]), np.zeros(3), PROTOCOL, NUMBERS)
    with pytest.raises(ScoringError, match="one of each a row"):
        joint_state(np.zeros(3), np.zeros(2), PROTOCOL, NUMBERS)


def test_the_cut_keeps_the_rows_of_the_run_and_their_digits() -> None:
    time = grid(50, 4)
    joint = joint_state(time, np.sin(time), PROTOCOL, NUMBERS)
    cut = joint.cut(1.0, 2.0)
    assert cut.time.tolist() == time[50:101].tolist()
    np.testing.assert_array_equal(cut.acceleration, joint.acceleration[50:101])
    assert defined(cut).all()  # filtered before it was cut: no filter edge inside
    assert joint.cut(9.0, 8.0).time.size == 0


OPEN = np.ones(5)


@pytest.mark.parametrize(
    ("ruleset", "time", "position", "acceleration", "times", "jerks"),
    [
        (PROTOCOL, [0, 1, 2, 3, 4], [1, 1, 0, 1, -1], [0, 1, 10, 4, 2], [1, 3, 4], [1, -6, -2]),
        (
            EUROBENCH_2020,
            *([0, 1, 2, 3, 4], [1, 1, 0, 1, -1], [0, 1, 10, 4, 2]),
            *([1, 3, 4], [1, 1.5, -2]),
        ),
        # none across a gap of a recorded acceleration
        (PROTOCOL, [0, 1, 16, 17, 18], OPEN, [0, 1, 5, 6, 8], [1, 17, 18], [1, 1, 2]),
    ],
)
def test_jerk_is_derived_before_or_after_the_closed_rows_go(
    ruleset: Ruleset,
    time: list[float],
    position: list[float],
    acceleration: list[float],
    times: list[float],
    jerks: list[float],
) -> None:
    columns = [np.array(column, dtype=np.float64) for column in (time, position, acceleration)]
    joint = JointState(columns[0], columns[1], np.zeros(5), columns[2])
    found = jerk(joint, ruleset, replace(NUMBERS, largest_gap=1.0))
    assert [column.tolist() for column in found] == [times, jerks]


@given(
    st.lists(st.integers(1, 12), min_size=0, max_size=120),
    st.integers(0, 2**31),
    st.integers(0, 2**32 - 1),
    st.sampled_from([PROTOCOL, EUROBENCH_2020]),
)
def test_a_shift_in_time_changes_nothing(
    steps: list[int], shift: int, seed: int, ruleset: Ruleset
) -> None:
    time = np.cumsum([0, *steps]) / 64.0  # exact in binary, shifted too
    position = np.random.default_rng(seed).uniform(-1.5, 1.5, time.size)
    here, there = (joint_state(time + offset, position, ruleset, NUMBERS) for offset in (0, shift))
    assert here.reason == there.reason
    for values in (
        lambda joint: joint.velocity,
        lambda joint: joint.acceleration,
        lambda joint: low_pass(joint, ruleset, NUMBERS),
        lambda joint: jerk(joint, ruleset, NUMBERS)[1],
    ):
        np.testing.assert_array_equal(values(here), values(there))


@given(
    st.lists(st.floats(0.001, 0.3), min_size=1, max_size=150),
    st.integers(0, 2**32 - 1),
    st.sampled_from([PROTOCOL, EUROBENCH_2020]),
)
def test_values_and_reasons_exclude_each_other(
    intervals: list[float], seed: int, ruleset: Ruleset
) -> None:
    time = EPOCH + np.cumsum(intervals)
    position = np.random.default_rng(seed).uniform(-1.5, 1.5, time.size)
    joint = joint_state(time, position, ruleset, NUMBERS)
    assert (joint.reason is None) == bool(defined(joint).any())
    low = low_pass(joint, ruleset, NUMBERS)
    assert (low_pass_problem(joint, ruleset, NUMBERS) is None) == bool(np.isfinite(low).any())
    assert not np.isfinite(low[~defined(joint)]).any()
    if ruleset is PROTOCOL:
        for row in np.flatnonzero(defined(joint)):  # the shortest windows reach two rows far
            assert 2 <= row < time.size - 2
            assert np.diff(time[row - 2 : row + 3]).max() <= 0.1
