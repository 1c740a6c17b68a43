"""Silence is a state of its own, and never looks like health."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.referee.health import Freshness, Health


def health(rate: float = 50.0, duration: float = 3.0, begin: float = 100.0) -> Health:
    found = Health()
    for i in range(int(rate * duration)):
        found.seen(begin + i / rate)
    return found


@pytest.mark.parametrize(
    ("silence", "state"),
    [
        (0.5, Freshness.FRESH),
        (0.51, Freshness.STALE),
        (2.0, Freshness.STALE),
        (2.01, Freshness.LOST),
    ],
)
def test_a_topic_ages(silence: float, state: Freshness) -> None:
    found = Health()
    found.seen(100.0)
    assert found.freshness(100.0 + silence) is state


def test_a_topic_that_never_spoke_has_neither_age_nor_rate() -> None:
    found = Health()
    assert found.freshness(1.0) is Freshness.NEVER
    assert (found.age(1.0), found.rate(1.0)) == (None, None)


@pytest.mark.parametrize("rate", [10.0, 50.0, 1500.0])
def test_the_rate_is_that_of_the_last_two_seconds(rate: float) -> None:
    assert health(rate).rate(103.0) == pytest.approx(rate, rel=0.06)


def test_a_silent_topic_loses_its_rate() -> None:
    assert health().rate(110.0) is None


def test_after_the_clock_was_stepped_back_nothing_old_is_fresh() -> None:
    found = health()
    assert found.freshness(103.0 - 3600) is Freshness.LOST
    for i in range(200):
        found.seen(103.0 - 3600 + i / 50)
    assert found.freshness(107.0 - 3600) is Freshness.FRESH
    assert found.rate(107.0 - 3600) == pytest.approx(50, rel=0.05)


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=50), st.floats(0, 1e6))
def test_fresh_means_a_message_within_half_a_second(times: list[float], now: float) -> None:
    found = Health()
    for time in times:
        found.seen(time)
    if found.freshness(now) is Freshness.FRESH:
        assert abs(now - times[-1]) <= 0.5
