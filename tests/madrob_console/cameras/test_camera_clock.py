"""The clock of a camera beside the testbed's, from stamps and reception."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.cameras.camera_clock import FEWEST, Arrival, CameraClock, LowestDelay

BEGIN = 1_700_000_000.0


def arrivals(
    count: int,
    rate: float,
    *,
    ahead: float,
    jitter: float,
    seed: int,
    delay: float = 0.002,
    gain: float = 0.0,
) -> Iterator[Arrival]:
    """Messages of a clock that is `ahead` and gains `gain` s/s."""
    random = Random(seed)
    for number in range(count):
        sent = BEGIN + number / rate
        stamp = sent + ahead + gain * (sent - BEGIN)
        held_up = random.expovariate(1 / jitter) if jitter else 0.0
        yield Arrival(stamp, sent + delay + held_up)


offsets = st.floats(-7200, 7200)
jitters = st.floats(0, 0.03)


@given(offset=offsets, ahead=offsets, one=jitters, two=jitters, seed=st.integers(0, 10**6))
@settings(max_examples=200, deadline=None)
def test_a_known_offset_is_found_within_what_is_said_of_it(
    offset: float, ahead: float, one: float, two: float, seed: int
) -> None:
    camera = LowestDelay(arrivals(300, 15, ahead=ahead + offset, jitter=one, seed=seed))
    testbed = LowestDelay(arrivals(1000, 50, ahead=ahead, jitter=two, seed=seed + 1))
    clock = CameraClock(camera, testbed)
    at = BEGIN + 10
    assert abs(clock.offset(at) - offset) <= clock.spread(at)
    assert clock.spread(at) <= 0.0002 + 0.4 * (one + two)
    assert clock.camera.steps == 0


@given(
    gain=st.floats(1e-4, 2e-3) | st.floats(-2e-3, -1e-4),
    jitter=st.floats(0, 0.005),
    seed=st.integers(0, 10**6),
)
@settings(max_examples=60, deadline=None)
def test_a_clock_that_gains_is_told_and_followed(gain: float, jitter: float, seed: int) -> None:
    ahead = 0.5
    camera = LowestDelay(arrivals(1800, 15, ahead=ahead, jitter=jitter, seed=seed, gain=gain))
    testbed = LowestDelay(arrivals(6000, 50, ahead=0, jitter=0.001, seed=seed))
    clock = CameraClock(camera, testbed)
    assert clock.drift == pytest.approx(gain, rel=0.25, abs=2e-5)
    for since in (0.0, 60.0, 119.0):
        truth = ahead + gain * since
        assert clock.offset(BEGIN + since) == pytest.approx(truth, abs=0.004)
    assert f"gains {60000 * clock.drift:+.1f} ms a minute" in clock.words(BEGIN)


def test_a_steady_clock_is_not_said_to_drift() -> None:
    for seed in range(50):
        delay = LowestDelay(arrivals(1800, 15, ahead=3, jitter=0.01, seed=seed))
        assert delay.drift == 0.0


def test_a_clock_that_is_stepped_has_an_offset_before_and_after_it() -> None:
    before = list(arrivals(300, 15, ahead=0.1, jitter=0.003, seed=1))
    after = [Arrival(a.stamp + 2.0 + 20.0, a.log + 20.0) for a in before]
    camera = LowestDelay([*before, *after])
    testbed = LowestDelay(arrivals(2000, 50, ahead=0, jitter=0.001, seed=2))
    clock = CameraClock(camera, testbed)
    assert clock.offset(BEGIN + 5) == pytest.approx(0.1, abs=0.002)
    assert clock.offset(BEGIN + 30) == pytest.approx(2.1, abs=0.002)
    assert camera.steps == 1
    assert "stepped once during the recording" in clock.words(BEGIN)


def test_wrong_stamps_now_and_then_are_no_step_and_move_nothing() -> None:
    good = list(arrivals(600, 15, ahead=0.1, jitter=0.003, seed=3))
    wrong = [a._replace(stamp=a.stamp - 500) if n % 40 == 7 else a for n, a in enumerate(good)]
    delay = LowestDelay(wrong)
    assert delay.steps == 0
    assert delay.at(BEGIN) == pytest.approx(LowestDelay(good).at(BEGIN), abs=0.001)


def test_frames_that_come_in_bursts_after_a_hold_up_move_nothing() -> None:
    good = list(arrivals(600, 15, ahead=0.0, jitter=0.002, seed=4))
    held = [
        a._replace(log=max(a.log, BEGIN + 22.0)) if 20 <= a.log - BEGIN < 22 else a for a in good
    ]
    assert LowestDelay(held).at(BEGIN) == pytest.approx(LowestDelay(good).at(BEGIN), abs=0.001)


def test_a_constant_delay_looks_like_a_clock_that_is_behind() -> None:
    camera = LowestDelay(arrivals(300, 15, ahead=0.0, jitter=0.001, seed=5, delay=0.102))
    testbed = LowestDelay(arrivals(1000, 50, ahead=0.0, jitter=0.001, seed=6, delay=0.002))
    assert CameraClock(camera, testbed).offset(BEGIN) == pytest.approx(-0.1, abs=0.001)


def test_the_words_say_offset_and_spread() -> None:
    camera = LowestDelay(arrivals(300, 15, ahead=0.132, jitter=0.0, seed=7))
    testbed = LowestDelay(arrivals(300, 15, ahead=0.0, jitter=0.0, seed=8))
    words = CameraClock(camera, testbed).words(BEGIN)
    assert words == "camera clock +0.132 s +- 0.000 s against the testbed's"


def test_too_few_messages_tell_nothing() -> None:
    with pytest.raises(ValueError, match="4 messages"):
        LowestDelay([Arrival(BEGIN, BEGIN)] * (FEWEST - 1))


numbers = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12)


@given(st.lists(st.builds(Arrival, numbers, numbers), min_size=FEWEST, max_size=80), numbers)
@settings(max_examples=200, deadline=None)
def test_any_stamps_at_all_give_numbers(found: list[Arrival], at: float) -> None:
    delay = LowestDelay(found)
    assert delay.at(at) == delay.at(at)
    assert delay.spread(at) > 0
