from __future__ import annotations

from collections.abc import Sequence
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.clock import NS
from madrob_console.testbeds.evidence_flow import (
    MOST_PAUSES,
    FlowMeter,
    RateLimit,
    SilenceWatch,
)
from recorder.message import RawMessage


@pytest.mark.parametrize(("sent", "most"), [(30.0, 10.0), (30.0, 20.0), (1000.0, 15.0), (16, 15)])
def test_a_faster_topic_is_thinned_to_the_rate_of_the_settings(sent: float, most: float) -> None:
    rate_limit = RateLimit(most)
    passed = [rate_limit.passes(round(number / sent * NS)) for number in range(round(sent * 60))]
    assert sum(passed) / 60 == pytest.approx(most, rel=0.04)
    later = passed[round(sent * 30) :]
    assert sum(later) / 30 == pytest.approx(most, rel=0.025)


@given(
    most=st.floats(0.1, 200),
    part=st.floats(0.1, 1.0),
    unevenness=st.lists(st.floats(-0.49, 0.49), min_size=1, max_size=400),
)
def test_a_topic_that_is_no_faster_than_its_limit_loses_nothing(
    most: float, part: float, unevenness: list[float]
) -> None:
    rate_limit = RateLimit(most)
    came = sorted(number / (most * part) + off for number, off in enumerate(unevenness))
    assert all(rate_limit.passes(round((100 + at) * NS)) for at in came)


def test_a_camera_of_15_hz_with_jitter_loses_nothing_by_a_limit_of_15() -> None:
    random = Random(7)
    rate_limit = RateLimit(15.0)
    came = sorted(number / 15.01 + random.gauss(0, 0.01) for number in range(15 * 3600))
    assert all(rate_limit.passes(round((1 + at) * NS)) for at in came)


def test_without_a_rate_everything_passes_and_a_clock_that_goes_back_stops_nothing() -> None:
    assert all(RateLimit(None).passes(at) for at in (5, 5, 4, 9))
    rate_limit = RateLimit(1.0)
    passed = [at for at in range(100, 110) for _ in range(3) if rate_limit.passes(at * NS)]
    assert len(passed) == 11
    passed = [at for at in range(7, 17) for _ in range(3) if rate_limit.passes(at * NS)]
    assert len(passed) == 11


def test_rates_are_those_of_the_last_seconds() -> None:
    meter = FlowMeter(0.0)
    for number in range(300):
        meter.count([RawMessage("/a", "a/msg/B", bytes(1000), 0, 0)], number / 30)
    rate, byte_rate = meter.rates(10.0)
    assert rate == pytest.approx(30, rel=0.05)
    assert byte_rate == pytest.approx(30_000, rel=0.05)
    assert meter.rates(12.5)[0] == pytest.approx(15, rel=0.05)
    assert meter.rates(20.0) == (0.0, 0.0)


def pauses(
    came: Sequence[float], now: float, begin: float | None = None
) -> list[tuple[float, float | None]]:
    """Of a topic on which messages came at these times, s, in a recording from `begin` on."""
    watch = SilenceWatch()
    for at in came:
        if begin is not None and at >= begin:
            watch.begin()
            begin = None
        watch.came(round(at * NS))
    told = watch.pauses(round(now * NS))
    return [(p.begin_ns / NS, None if p.end_ns is None else p.end_ns / NS) for p in told]


STEADY = [number / 10 for number in range(50)]  # until 4.9 s


def test_a_camera_that_stops_is_silent_since_then_and_was_so_when_it_comes_again() -> None:
    assert pauses(STEADY, 6.8) == []
    assert pauses(STEADY, 7.0) == [(4.9, None)]
    again = [*STEADY, *(9 + at for at in STEADY)]
    assert pauses(again, 14.0) == [(4.9, 9.0)]
    assert pauses([*again, 20.0], 20.1) == [(4.9, 9.0), (13.9, 20.0)]
    assert pauses([*again, 20.0], 22.1) == [(4.9, 9.0), (13.9, 20.0), (20.0, None)]
    assert pauses(again, 14.0, begin=9.05) == []


def test_of_many_silences_the_last_one_told_has_all_that_came_later() -> None:
    watch = SilenceWatch()
    for number in range(MOST_PAUSES + 5):
        for at in STEADY:
            watch.came(round((10 * number + at) * NS))
    told = watch.pauses(round((10 * number + 5.0) * NS))
    assert len(told) == MOST_PAUSES
    assert (told[-1].number, told[-1].end_ns) == (5, 10 * number * NS)


@pytest.mark.parametrize("came", [[], [0.0], [0.1 * n for n in range(15)], [0.0, 30.0, 60.0, 90.0]])
def test_what_comes_now_and_then_may_be_silent(came: Sequence[float]) -> None:
    assert pauses(came, 1000.0) == []


def test_what_the_settings_name_may_not_be_silent_from_the_first() -> None:
    for named, said in ((True, "nothing has come"), (False, "")):
        watch = SilenceWatch(named=named)
        assert watch.problem(9 * NS) == ""  # nobody listens yet
        for at in range(4, 9):
            watch.listen(at * NS)
        assert watch.problem(6 * NS) == ""
        assert watch.problem(7 * NS) == said
        watch.came(7 * NS)
        assert watch.problem(100 * NS) == ""
