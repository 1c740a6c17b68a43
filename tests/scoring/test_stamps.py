"""Stamps and data quality (protocol section 8)."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoring.protocol import Signal
from scoring.quality import QualityCounter
from scoring.samples import DoorSample
from scoring.stamps import StampGuard

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


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=50))
def test_whatever_the_stamps_what_is_kept_increases(offsets: list[float]) -> None:
    guard, times = admitted(stream(offsets))
    assert all(a < b for a, b in pairwise(times))
    assert len(times) + guard.dropped == len(offsets)


def test_quality_counts_rate_gaps_and_jitter() -> None:
    counter = QualityCounter(Signal.DOOR, 0.1)
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
    quality = QualityCounter(Signal.HANDLE, 0.1).quality()
    assert (quality.samples, quality.rate, quality.jitter, quality.skew) == (0, None, None, None)
