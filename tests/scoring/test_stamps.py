"""Stamps and data quality (protocol section 8)."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoring.protocol import Signal, Thresholds
from scoring.quality import QualityCounter
from scoring.samples import DoorSample
from scoring.stamps import KEPT_STEPS, StampGuard

PERIOD = 0.02


def stream(offsets: list[float], begin: float = 1000.0) -> list[DoorSample]:
    """Samples every 20 ms of log time, their stamps off by `offsets`."""
    times = [begin + i * PERIOD for i in range(len(offsets))]
    return [DoorSample(t + o, t, 0.0) for t, o in zip(times, offsets, strict=True)]


def admitted(samples: list[DoorSample]) -> tuple[StampGuard, list[float]]:
    guard = StampGuard()
    kept = [guard.admit(sample) for sample in samples]
    return guard, [sample.time for sample in kept if sample is not None]


def test_good_stamps_pass_unchanged() -> None:
    samples = stream([0.0, 0.001, -0.001, 0.0])
    guard, times = admitted(samples)
    assert times == [s.time for s in samples]
    assert (guard.dropped, guard.shifted) == (0, 0)


def test_repeated_and_backward_stamps_are_dropped_and_counted() -> None:
    guard, times = admitted(stream([0.0, -0.02, -0.1, 0.0]))
    assert len(times) == 2
    assert guard.dropped == 2


@pytest.mark.parametrize("jump", [3600.0, -3600.0, 0.7, -0.7])
def test_a_stepped_clock_is_shifted_back(jump: float) -> None:
    guard, times = admitted(stream([0.0] * 5 + [jump] * 5))
    assert times == pytest.approx([1000.0 + i * PERIOD for i in range(10)], abs=1e-6)
    assert guard.shifted == 5
    assert [step.jump for step in guard.steps] == pytest.approx([jump], abs=1e-6)


def test_a_clock_stepped_there_and_back_ends_where_it_was() -> None:
    guard, times = admitted(stream([0.0] * 3 + [3600.0] * 3 + [0.0] * 3))
    assert times == pytest.approx([1000.0 + i * PERIOD for i in range(9)], abs=1e-6)
    assert len(guard.steps) == 2


def test_messages_delivered_late_keep_their_stamps() -> None:
    begin = 1000.0
    stamps = [begin + i * PERIOD for i in range(100)]
    logs = [t if i < 20 else max(t, begin + 1.6) for i, t in enumerate(stamps)]
    samples = [DoorSample(t, log, 0.0) for t, log in zip(stamps, logs, strict=True)]
    guard, times = admitted(samples)
    assert times == stamps
    assert guard.steps == []


def test_slow_drift_is_no_step() -> None:
    guard, _ = admitted(stream([i * 0.005 for i in range(400)]))
    assert guard.steps == []


def test_a_stamp_that_stood_still_is_no_step_when_it_goes_on() -> None:
    still = [-i * PERIOD for i in range(100)]
    guard, times = admitted(stream([*still, *[0.0] * 100]))
    assert times == [1000.0] + [1000.0 + i * PERIOD for i in range(100, 200)]
    assert (guard.dropped, guard.shifted, guard.steps) == (99, 0, [])


def test_a_missing_stamp_is_dropped_and_is_no_step() -> None:
    unset = [-(1000.0 + i * PERIOD) for i in range(100)]
    guard, times = admitted(stream([*unset, *[0.0] * 100]))
    assert times == [1000.0 + i * PERIOD for i in range(100, 200)]
    assert (guard.dropped, guard.shifted, guard.steps) == (100, 0, [])


def test_a_clock_that_jumps_all_the_time_is_told_in_a_few_words() -> None:
    counter = QualityCounter(Signal.DOOR, Thresholds())
    for sample in stream([5.0 * (i % 2) for i in range(1000)]):
        counter.admit(sample)
    assert len(counter.guard.steps) == KEPT_STEPS
    assert counter.quality().clock_steps == 999
    assert counter.quality().remarks(largest_skew=0.1) == [
        "door angle: clock stepped 999 times, of which the first 5 are told"
    ]


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=50))
def test_whatever_the_stamps_what_is_kept_increases(offsets: list[float]) -> None:
    guard, times = admitted(stream(offsets))
    assert all(a < b for a, b in pairwise(times))
    assert len(times) + guard.dropped == len(offsets)


def test_quality_counts_rate_gaps_and_jitter() -> None:
    counter = QualityCounter(Signal.DOOR, Thresholds())
    times = [0.0, 0.019, 0.04, 0.06, 0.56, 0.58]
    for time in times:
        counter.admit(DoorSample(1000 + time, 1000 + time + 0.003, 0.0))
    quality = counter.quality()
    assert quality.samples == 6
    assert quality.rate == pytest.approx(50.0)
    assert quality.gaps == 1
    assert quality.largest_gap == pytest.approx(0.5)
    assert quality.jitter == pytest.approx(math.sqrt(2 * 0.001**2 / 4), rel=1e-3)
    assert quality.skew == pytest.approx(0.003, abs=1e-6)


def test_quality_of_nothing_has_no_numbers() -> None:
    quality = QualityCounter(Signal.HANDLE, Thresholds()).quality()
    assert (quality.samples, quality.rate, quality.jitter, quality.skew) == (0, None, None, None)


def counted(times: list[float]) -> QualityCounter:
    counter = QualityCounter(Signal.HANDLE, Thresholds())
    for time in times:
        counter.admit(DoorSample(time, time, 0.0))
    return counter


def test_a_signal_that_begins_late_or_ends_early_is_told() -> None:
    counter = counted([12.0 + i * PERIOD for i in range(100)])
    quality = counter.quality(begin=10.0, end=20.0)
    assert quality.begins_late == pytest.approx(2.0)
    assert quality.ends_early == pytest.approx(6.02)
    assert quality.remarks(largest_skew=0.1) == [
        "handle force: nothing in the first 2.0 s of the recording",
        "handle force: nothing in the last 6.0 s of the recording",
    ]
    assert counter.quality(begin=11.9, end=14.0).remarks(largest_skew=0.1) == []


def test_a_flood_and_a_second_publisher_show_in_the_intervals() -> None:
    calm = [1000.0 + i * PERIOD for i in range(100)]
    assert counted(calm).quality().remarks(largest_skew=0.1) == []
    flooded = counted([*calm, *(1002.0 + i * PERIOD / 30 for i in range(3000))])
    doubled = counted(sorted([*calm, *(time + 0.006 for time in calm)]))
    for counter in (flooded, doubled):
        assert "handle force: uneven intervals of" in "".join(
            counter.quality().remarks(largest_skew=0.1)
        )
