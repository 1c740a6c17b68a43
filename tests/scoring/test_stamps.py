"""Stamps and data quality (protocol section 8)."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scoring.protocol import Signal, Thresholds
from scoring.quality import SignalQuality
from scoring.rest import HandleRest, RestForce, moved, rest_force, rest_of
from scoring.samples import DoorSample
from scoring.series import SignalLog, signal_quality
from scoring.stamps import StampGuard
from tests.scoring.runs import START

PERIOD = 0.02


def stream(offsets: list[float], begin: float = 1000.0) -> list[DoorSample]:
    """Samples every 20 ms of log time, their stamps off by `offsets`."""
    times = [begin + i * PERIOD for i in range(len(offsets))]
    return [DoorSample(t + o, t, 0.0) for t, o in zip(times, offsets, strict=True)]


def admitted(samples: list[DoorSample]) -> tuple[StampGuard, list[float]]:
    guard = StampGuard()
    kept = [guard.admit(sample) for sample in samples]
    return guard, [sample.time for sample in kept if sample is not None]


BEGIN = 1000.0
UNSET = [-(BEGIN + i * PERIOD) for i in range(100)]


@pytest.mark.parametrize(
    ("offsets", "kept", "dropped", "shifted", "steps"),
    [
        (
            [0.0, 0.001, -0.001, 0.0],
            [0.0, 0.001 + PERIOD, 2 * PERIOD - 0.001, 3 * PERIOD],
            0,
            0,
            [],
        ),
        ([0.0, -0.02, -0.1, 0.0], [0.0, 3 * PERIOD], 2, 0, []),  # repeated and backward
        *(
            ([0.0] * 5 + [jump] * 5, [i * PERIOD for i in range(10)], 0, 5, [jump])
            for jump in (3600.0, -3600.0, 0.7, -0.7)  # a stepped clock is shifted back
        ),
        (
            [0.0] * 3 + [3600.0] * 3 + [0.0] * 3,
            [i * PERIOD for i in range(9)],
            0,
            6,
            [3600.0, -3600.0],
        ),
        (  # slow drift is no step
            [i * 0.005 for i in range(400)],
            [i * (PERIOD + 0.005) for i in range(400)],
            0,
            0,
            [],
        ),
        (  # nor a stamp that stood still and goes on
            [-i * PERIOD for i in range(100)] + [0.0] * 100,
            [0.0, *(i * PERIOD for i in range(100, 200))],
            99,
            0,
            [],
        ),
        ([*UNSET, *[0.0] * 100], [i * PERIOD for i in range(100, 200)], 100, 0, []),  # missing
    ],
)
def test_stamps_are_kept_dropped_or_shifted_back(
    offsets: list[float], kept: list[float], dropped: int, shifted: int, steps: list[float]
) -> None:
    guard, times = admitted(stream(offsets))
    assert times == pytest.approx([BEGIN + time for time in kept], abs=1e-6)
    assert (guard.dropped, guard.shifted) == (dropped, shifted)
    assert guard.steps == pytest.approx(steps, abs=1e-6)


def test_messages_delivered_late_keep_their_stamps() -> None:
    stamps = [BEGIN + i * PERIOD for i in range(100)]
    logs = [t if i < 20 else max(t, BEGIN + 1.6) for i, t in enumerate(stamps)]
    samples = [DoorSample(t, log, 0.0) for t, log in zip(stamps, logs, strict=True)]
    guard, times = admitted(samples)
    assert (times, guard.steps) == (stamps, [])


def test_messages_lost_and_delivered_late_are_no_step() -> None:
    """As of an engine that stood still: the first messages waited, those after them are lost."""
    waited = [DoorSample(BEGIN + 2 + i * PERIOD, BEGIN + 5.5, 0.0) for i in range(50)]
    prompt = stream([0.0] * 100, BEGIN + 5.5)
    guard, times = admitted([*stream([0.0] * 100), *waited, *prompt])
    assert (guard.shifted, len(times)) == (0, 250)


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=50))
def test_whatever_the_stamps_what_is_kept_increases(offsets: list[float]) -> None:
    guard, times = admitted(stream(offsets))
    assert all(a < b for a, b in pairwise(times))
    assert len(times) + guard.dropped == len(offsets)


def numbers(of: SignalQuality) -> tuple[float | None, ...]:
    return of.samples, of.rate, of.gaps, of.largest_gap, of.jitter, of.skew


def quality(
    signal: Signal, samples: list[DoorSample], begin: float = BEGIN, end: float = BEGIN
) -> SignalQuality:
    guard = StampGuard()
    log = SignalLog()
    for sample in samples:
        admitted = guard.admit(sample)
        if admitted is not None:
            log.add(admitted)
    return signal_quality(signal, log.series(signal), guard, (begin, end), Thresholds())


def test_quality_counts_rate_gaps_and_jitter() -> None:
    times = (0.0, 0.019, 0.04, 0.06, 0.56, 0.58)
    samples = [DoorSample(1000 + time, 1000 + time + 0.003, 0.0) for time in times]
    jitter = math.sqrt(2 * 0.001**2 / 4)
    found = numbers(quality(Signal.DOOR, samples))
    assert found == pytest.approx((6, 50.0, 1, 0.5, jitter, 0.003), rel=1e-3)
    assert numbers(quality(Signal.HANDLE, [])) == (0, None, 0, None, None, None)


def test_a_clock_that_jumps_is_told_once() -> None:
    found = quality(Signal.DOOR, stream([5.0 * (i % 2) for i in range(1000)]), end=BEGIN + 20)
    assert [*found.remarks()] == ["clock steps: 999, later stamps shifted back"]


CALM = [BEGIN + i * PERIOD for i in range(100)]


@pytest.mark.parametrize(
    ("times", "begin", "end", "remarks"),
    [
        (CALM, None, None, []),
        (
            CALM,
            BEGIN - 2.0,
            BEGIN + 8.0,
            ["nothing in the first 2.0 s of", "nothing in the last 6.0 s of"],
        ),
        (CALM, BEGIN - 0.09, BEGIN + 2.0, []),
        (
            [*CALM, *(1002.0 + i * PERIOD / 30 for i in range(3000))],
            None,
            None,
            ["uneven"],
        ),  # flood
        (sorted([*CALM, *(time + 0.006 for time in CALM)]), None, None, ["uneven"]),  # two publish
    ],
)
def test_what_is_uneven_or_begins_late_or_ends_early_is_told(
    times: list[float], begin: float | None, end: float | None, remarks: list[str]
) -> None:
    samples = [DoorSample(time, time, 0.0) for time in times]
    begin, end = begin or times[0], end or times[-1]
    told = quality(Signal.HANDLE, samples, begin, end).remarks()
    assert all(say in line for say, line in zip(remarks, told, strict=True))


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
    return rest_of_run(TIMES[kept] + START, forces[kept], zero, START + TIMES[-1])


def rest_of_run(
    times: NDArray[np.float64],
    forces: NDArray[np.float64],
    zero: float = 0.0,
    end: float = START,
    start: float = START,
) -> RestForce:
    return rest_force(times, forces, start, zero=zero, end=end, thresholds=Thresholds())


def pushed(t: float) -> float:
    """Free at 5.9 N, but for a push from 2 s to 4 s."""
    return 25.9 if 2 <= t < 4 else 5.9


def rest(told: HandleRest | None) -> HandleRest:
    assert told is not None
    return told


def test_samples_are_told_by_number_mean_standard_deviation_span_and_time() -> None:
    assert rest_of([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]) == HandleRest(3, 5.0, 1.0, 2.0, 1.0, 3.0)
    assert rest(rest_of([1.0], [4.0])).deviation == 0.0
    assert [moved(force, 1.96) for force in (-0.98, -0.981)] == [False, True]  # half of a touch


def trembling(size: float, rate: float) -> Force:
    """Free until 3 s, then in a hand that trembles."""
    return lambda t: 8.0 + size * np.sin(rate * t) if t > 3 else 5.9


NOT_FREE = "the handle was not free at the end of the recording"
TOO_FEW = "too few samples, or a gap, in the last half second of the recording"


@pytest.mark.parametrize(
    ("force", "told", "drift"),
    [
        pytest.param(pushed, {}, 0.0, id="back to its zero"),
        pytest.param(lambda t: pushed(t) - 5.54 * (t > 3), {}, -5.54, id="drifted"),
        pytest.param(pushed, {"zero": 0.0}, 5.9, id="never zeroed"),
        pytest.param(trembling(0.4, 12), {}, NOT_FREE, id="trembles in a hand"),
        pytest.param(trembling(0.4, 40), {"noise": 0.3}, 2.1, id="no more than the noise before"),
        pytest.param(lambda t: 25.9 if 2 <= t < 7.8 else 5.9, {}, NOT_FREE, id="let go at the end"),
        pytest.param(pushed, {"keep": lambda t: t < 7.3}, TOO_FEW, id="silent at the end"),
        pytest.param(pushed, {"keep": lambda t: not 7.6 < t < 7.75}, TOO_FEW, id="a gap"),
        pytest.param(
            pushed, {"keep": lambda t: t < 7 or round(t * 50) % 4 == 0}, TOO_FEW, id="six samples"
        ),
        *(
            pytest.param(pushed, {"noise": noise}, 0.0, id=f"free, noise of {noise} N")
            for noise in (0.0, 0.01, 0.1, 0.3)
        ),
        pytest.param(
            lambda t: 5.9 + 3 * np.sin(20 * t) * (t < 1), {}, 0.0, id="never quiet before the start"
        ),
        pytest.param(
            lambda t: 21.25 if t > 3 else 5.9 + np.sin(37 * t), {"noise": 0.0},
            "the force does not change any more at the end of the recording", id="stuck",
        ),
    ],
)  # fmt: skip
def test_a_drift_is_the_rest_force_after_the_run_less_the_zero(
    force: Force, told: dict[str, Any], drift: float | str
) -> None:
    measured = found(force, **told)
    if isinstance(drift, str):
        assert (measured.after, measured.drift, measured.no_after) == (None, None, drift)
    else:
        assert measured.drift == pytest.approx(drift, abs=0.15)
        assert measured.drifted(Thresholds().touch_force) == (abs(drift) > 0.98)
        assert rest(measured.after).end == START + TIMES[-1]
        assert measured.no_after is None


def test_a_hand_before_the_start_is_no_rest() -> None:
    assert found(pushed).no_before is None
    before = rest(found(pushed).before)
    assert (before.number, before.mean) == pytest.approx((25, 5.9), abs=0.05)
    measured = found(lambda t: 5.9 + (3 * np.sin(20 * t) if t < 1 else 0))
    why = "the handle was not quiet for half a second before the start"
    assert (measured.before, measured.no_before) == (None, why)


@pytest.mark.parametrize("force", [1e308, -1e308])
def test_forces_that_no_handle_bears_tell_nothing(force: float) -> None:
    told = rest_of_run(TIMES + START, np.full(TIMES.size, force))
    assert (told.before, told.after, told.drift) == (None, None, None)


def test_of_nothing_recorded_no_rest_is_known() -> None:
    assert rest_of_run(np.array([]), np.array([])).drift is None
    early = TIMES[TIMES < 0.2] + START
    told = rest_of_run(early, np.sin(early))
    assert told.no_after == "the recording ends within half a second of the start"
