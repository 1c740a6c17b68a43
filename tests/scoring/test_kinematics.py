"""Motion of the panel by the filters of protocol section 5."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scoring.kinematics import Array, JointState, jerk, joint_state, low_pass
from scoring.protocol import Thresholds

EPOCH = 1_580_487_388.0
NUMBERS = Thresholds()


def grid(rate: float, duration: float) -> Array:
    return np.arange(round(rate * duration) + 1) / rate


def motion(time: Array, thresholds: Thresholds = NUMBERS) -> JointState:
    return joint_state(time, np.sin(time), thresholds)


def defined(joint: JointState) -> NDArray[np.bool_]:
    return np.isfinite(joint.acceleration)


def gains(rate: float, window: int, omega: float) -> tuple[float, float]:
    """What the two filters make of a sinusoid: factor of its velocity and its acceleration."""
    step = omega / rate
    mean = math.sin(window * step / 2) / (window * math.sin(step / 2))
    k = np.arange(-(window // 2), window // 2 + 1)
    slope = float(np.sum(k * np.sin(k * step)) / np.sum(k**2)) / step
    square = k**2 - np.mean(k**2)
    curvature = -2 * float(np.sum(square * np.cos(k * step)) / np.sum(square**2)) / step**2
    return mean * slope, mean * curvature


@pytest.mark.parametrize(("rate", "window"), [(50, 9), (100, 19), (55, 11), (11, 3)])
def test_a_swinging_door_keeps_what_the_windows_pass(rate: int, window: int) -> None:
    omega = 2 * math.pi * 0.5
    time = grid(rate, 8)
    velocity_gain, acceleration_gain = gains(rate, window, omega)
    edge = 2 * (window // 2)
    inner = slice(edge, time.size - edge)

    joint = joint_state(time, 0.8 * np.sin(omega * time), NUMBERS)

    assert np.flatnonzero(defined(joint)).tolist() == list(range(edge, time.size - edge))
    velocity = velocity_gain * 0.8 * omega * np.cos(omega * time)
    acceleration = -acceleration_gain * 0.8 * omega**2 * np.sin(omega * time)
    np.testing.assert_allclose(joint.velocity[inner], velocity[inner], atol=1e-9)
    np.testing.assert_allclose(joint.acceleration[inner], acceleration[inner], atol=1e-8)


@pytest.mark.parametrize("frequency", [0.5, 1.0, 2.0, 3.0])
def test_the_low_pass_is_a_butterworth_without_delay(frequency: float) -> None:
    time = grid(50, 60)
    acceleration = np.sin(2 * math.pi * frequency * time)
    joint = JointState(time, np.ones(time.size), acceleration.copy(), acceleration)
    ratio = math.tan(math.pi * frequency / 50) / math.tan(math.pi * 2 / 50)
    middle = slice(1000, 2000)

    filtered, problem = low_pass(joint, NUMBERS)

    assert problem is None
    expected = acceleration[middle] / (1 + ratio**10)
    np.testing.assert_allclose(filtered[middle], expected, atol=1e-8)


@given(st.integers(0, 2**32 - 1), st.sampled_from([(50, 9), (100, 19), (49.6, 9), (50.6, 11)]))
def test_the_windows_follow_the_rate_in_whole_hertz(seed: int, rate: tuple[float, int]) -> None:
    hertz, window = rate
    jitter = np.random.default_rng(seed).uniform(-0.2, 0.2, 400) * (hertz in (50, 100))
    joint = motion(EPOCH + (np.arange(400) + jitter) / hertz)
    edge = 2 * (window // 2)
    assert np.flatnonzero(~defined(joint)).tolist() == [*range(edge), *range(400 - edge, 400)]


def test_a_gap_empties_the_rows_whose_windows_span_it() -> None:
    time = grid(50, 3)[np.r_[0:60, 66:150]]
    joint = motion(time)
    empty = [*range(8), *range(52, 68), *range(136, 144)]
    assert np.flatnonzero(~defined(joint)).tolist() == empty
    assert np.isfinite(low_pass(joint, NUMBERS)[0]).tolist() == defined(joint).tolist()
    times, _ = jerk(joint, NUMBERS)
    assert not ((times > time[51]) & (times <= time[68])).any()


def test_an_interval_as_long_as_the_largest_gap_is_none() -> None:
    time = grid(64, 3)[np.r_[0:60, 64:150]]  # the interval across is 5/64 s
    assert defined(motion(time, replace(NUMBERS, largest_gap=5 / 64)))[50:70].all()
    assert not defined(motion(time, replace(NUMBERS, largest_gap=4.9 / 64)))[58:62].any()


def test_a_gap_stays_out_of_the_sampling_interval() -> None:
    first = grid(50, 2)
    time = np.r_[first, first + 30]
    velocity = joint_state(time, 0.5 * time, NUMBERS).velocity
    np.testing.assert_allclose(velocity[np.isfinite(velocity)], 0.5, atol=1e-9)


def test_a_stretch_too_short_for_the_low_pass_is_empty() -> None:
    long, short = grid(50, 2), 10 + grid(50, 0.66)
    joint = motion(np.r_[long, short])  # 34 rows: 18 with an acceleration, one too few
    low = np.isfinite(low_pass(joint, NUMBERS)[0])
    assert low[: long.size].any()
    assert not low[long.size :].any()


NO_STRETCH = "no stretch of acceleration without gaps is long enough for the low-pass filter"


@pytest.mark.parametrize(
    ("rate", "rows", "reason", "problem"),
    [
        (10, 201, "door angle at 10 Hz: too slow for the filters", None),
        (1, 21, "door angle at 1 Hz: too slow for the filters", None),
        (8000, 8001, None, "door angle at 8000 Hz: too fast for the low-pass filter"),
        (50, 34, None, NO_STRETCH),
        (50, 0, "no door angle recorded", None),
        (50, 5, "too few door angles recorded for the filters", None),
        (50, 16, "no stretch of the door angle without gaps is long enough for the filters", None),
    ],
)
def test_what_the_filters_cannot_do_has_a_reason(
    rate: int, rows: int, reason: str | None, problem: str | None
) -> None:
    joint = motion(np.arange(rows) / rate)
    low, why = low_pass(joint, NUMBERS)
    assert (joint.reason, why) == (reason, problem or reason)
    assert np.isnan(low).all()
    assert bool(defined(joint).any()) == (reason is None)


def test_positions_out_of_range_leak_no_infinity() -> None:
    time = grid(50, 4)
    position = np.sin(time)
    position[100:110] = 1.7e308
    joint = joint_state(time, position, NUMBERS)
    for values in (joint.velocity, joint.acceleration, low_pass(joint, NUMBERS)[0]):
        assert not np.isinf(values).any()


def test_the_cut_keeps_digits_and_has_no_filter_edge() -> None:
    time = grid(50, 4)
    joint = motion(time)
    cut = joint.cut(1.0, 2.0)
    assert cut.time.tolist() == time[50:101].tolist()
    np.testing.assert_array_equal(cut.acceleration, joint.acceleration[50:101])
    assert defined(cut).all()
    assert joint.cut(9.0, 8.0).time.size == 0


@pytest.mark.parametrize(
    ("time", "position", "acceleration", "times", "jerks"),
    [
        ([0, 1, 2, 3, 4], [1, 1, 0, 1, -1], [0, 1, 10, 4, 2], [1, 3, 4], [1, -6, -2]),
        ([0, 1, 16, 17, 18], [1] * 5, [0, 1, 5, 6, 8], [1, 17, 18], [1, 1, 2]),
    ],
)
def test_jerk_is_of_open_rows_and_over_no_gap(
    time: list[float],
    position: list[float],
    acceleration: list[float],
    times: list[float],
    jerks: list[float],
) -> None:
    columns = [np.array(column, dtype=np.float64) for column in (time, position, acceleration)]
    joint = JointState(columns[0], columns[1], np.zeros(5), columns[2])
    found = jerk(joint, replace(NUMBERS, largest_gap=1.0))
    assert [column.tolist() for column in found] == [times, jerks]
