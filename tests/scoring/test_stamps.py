"""Stamps and data quality (protocol section 8)."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoring.protocol import Outcome, Signal, Thresholds
from scoring.quality import KEPT_STEPS, QualityCounter, StampGuard
from scoring.rest import HandleRest, RestForce, moved, rest_force, rest_of
from scoring.result import Ending
from scoring.signals import DoorSample
from tests.scoring.runs import START, assessment, handle, passage_through

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


Force = Callable[[float], float]
"""Force, N, by the time since the start, s."""

TIMES = np.arange(-100, 400) / 50 + 0.003
"""Since the start, s: 50 Hz, from 2 s before it to 8 s after."""


def found(
    force: Force, *, noise: float = 0.05, zero: float = 5.9, keep: Force = lambda _: 1
) -> RestForce:
    """Of a recording with this force and as much noise, and only the samples that `keep` wants."""
    random = np.random.default_rng(7)
    forces = np.array([force(t) for t in TIMES]) + noise * random.standard_normal(TIMES.size)
    kept = np.array([keep(t) for t in TIMES], bool)
    return rest_force(TIMES[kept] + START, forces[kept], START, zero=zero, end=START + TIMES[-1])


def pushed(t: float) -> float:
    """Free at 5.9 N, but for a push from 2 s to 4 s."""
    return 25.9 if 2 <= t < 4 else 5.9


def rest(told: HandleRest | None) -> HandleRest:
    assert told is not None
    return told


def test_samples_are_told_by_number_mean_standard_deviation_span_and_time() -> None:
    assert rest_of([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]) == HandleRest(3, 5.0, 1.0, 2.0, 1.0, 3.0)
    assert rest(rest_of([1.0], [4.0])).deviation == 0.0


def test_a_handle_that_comes_back_to_its_zero_has_no_drift() -> None:
    told = found(pushed)
    before, after = rest(told.before), rest(told.after)
    assert (before.number, after.number) == (25, 25)
    assert before.end < START
    assert after.end == START + TIMES[-1]
    assert (before.mean, after.mean) == pytest.approx((5.9, 5.9), abs=0.05)
    assert (before.deviation, after.deviation) == pytest.approx((0.05, 0.05), rel=0.4)
    assert told.drift == pytest.approx(0, abs=0.05)
    assert not told.drifted(Thresholds().touch_force)
    assert (told.no_before, told.no_after) == (None, None)


def test_a_drift_is_the_rest_force_after_the_run_less_the_zero() -> None:
    told = found(lambda t: pushed(t) - 5.54 * (t > 3))
    assert told.drift == pytest.approx(-5.54, abs=0.05)
    assert told.drifted(Thresholds().touch_force)


def test_half_the_threshold_is_no_drift_yet() -> None:
    assert not moved(-0.98, 1.96)
    assert moved(-0.981, 1.96)


def test_a_handle_that_trembles_in_a_hand_is_not_free() -> None:
    told = found(lambda t: 8.0 + 0.4 * np.sin(12 * t) if t > 3 else 5.9)
    assert (told.after, told.drift) == (None, None)
    assert told.no_after == "the handle was not free at the end of the recording"


def test_a_handle_that_is_let_go_at_the_very_end_is_not_free() -> None:
    assert found(lambda t: 25.9 if 2 <= t < 7.8 else 5.9).after is None


def test_what_is_steady_is_measured_by_the_noise_before_the_run() -> None:
    def trembles(t: float) -> float:
        return 5.9 + (0.4 * np.sin(40 * t) if t > 3 else 0)

    assert found(trembles, noise=0.05).after is None
    assert found(trembles, noise=0.3).after is not None


def test_a_free_handle_is_never_taken_for_a_held_one_by_its_noise() -> None:
    for noise in (0.0, 0.01, 0.1, 0.3):
        assert found(pushed, noise=noise).drift is not None


def test_a_force_that_does_not_change_any_more_is_no_rest() -> None:
    times = TIMES + START
    forces = np.where(TIMES < 3, 5.9 + 0.05 * np.sin(37 * TIMES), 21.25)
    told = rest_force(times, forces, START, zero=5.9)
    assert told.after is None
    assert told.no_after == "the force does not change any more at the end of the recording"


@pytest.mark.parametrize(
    "keep",
    [
        lambda t: t < 7.3,  # silent at the end
        lambda t: not 7.6 < t < 7.75,  # a gap
        lambda t: t < 7 or round(t * 50) % 4 == 0,  # six samples in half a second
    ],
)
def test_too_few_samples_and_gaps_tell_nothing(keep: Force) -> None:
    told = found(pushed, keep=keep)
    assert (told.after, told.drift) == (None, None)
    assert told.no_after == "too few samples, or a gap, in the last half second of the recording"


def test_a_touch_in_the_countdown_is_no_rest() -> None:
    before = rest(found(lambda t: 12.0 + np.sin(20 * t) if -0.7 < t < 3 else 5.9).before)
    assert before.end < START - 0.69
    assert before.mean == pytest.approx(5.9, abs=0.05)


def test_a_hand_that_bears_on_the_handle_evenly_before_the_start_moves_no_rest_force() -> None:
    before = rest(found(lambda t: 12.0 if -0.9 < t < 3 else 5.9).before)
    assert before.mean == pytest.approx(5.9, abs=0.05)


def test_a_handle_that_was_never_zeroed_has_a_rest_force_all_the_same() -> None:
    told = found(pushed, zero=0.0)
    assert rest(told.before).mean == pytest.approx(5.9, abs=0.05)
    assert told.drift == pytest.approx(5.9, abs=0.05)


def test_a_handle_that_is_never_quiet_before_the_start_has_no_rest_force_there() -> None:
    told = found(lambda t: 5.9 + (3 * np.sin(20 * t) if t < 1 else 0))
    assert told.before is None
    assert told.no_before == "the handle was not quiet for half a second before the start"
    assert told.drift == pytest.approx(0, abs=0.05)


def test_a_recording_that_ends_in_the_countdown_has_nothing_after_the_run() -> None:
    told = found(pushed, keep=lambda t: t < 0.2)
    assert told.after is None
    times = TIMES[TIMES < 0.2] + START
    forces = np.sin(times)
    assert rest_force(times, forces, START).no_after == (
        "the recording ends within half a second of the start"
    )


@pytest.mark.parametrize("force", [1e308, -1e308])
def test_forces_that_no_handle_bears_tell_nothing(force: float) -> None:
    told = rest_force(TIMES + START, np.full(TIMES.size, force), START)
    assert (told.before, told.after, told.drift) == (None, None, None)


def test_nothing_recorded_tells_nothing() -> None:
    assert rest_force([], [], START).drift is None


def test_a_stamp_of_long_ago_costs_nothing() -> None:
    times = np.concatenate([[1.0], TIMES + START * 1000])
    assert rest_force(times, np.full(times.size, 5.9), START * 1000, zero=5.9).drift == 0


def test_a_result_has_the_rest_force_and_the_drift() -> None:
    forces = [handle(t, 10.0 if 2 <= t < 2.5 else 0.1 + 1.2 * (t > 2)) for t in TIMES]
    others = [s for s in passage_through() if s.signal.name != "HANDLE"]
    samples = sorted([*others, *forces], key=lambda s: s.time)
    result, _ = assessment(samples).result(Ending(Outcome.COMPLETED, "done", START + 6))
    assert result.rest is not None
    assert rest(result.rest.before).mean == pytest.approx(0.1)
    assert result.rest.drift == pytest.approx(1.3)
