from __future__ import annotations

from collections.abc import Sequence

import pytest

from madrob_console.clock import NS
from madrob_console.testbeds.evidence_flow import FlowMeter, RateLimit, SilenceWatch
from recorder.message import RawMessage


@pytest.mark.parametrize(("sent", "most"), [(30.0, 10.0), (30.0, 20.0), (1000.0, 15.0), (29, 30)])
def test_a_faster_topic_is_thinned_to_the_rate_of_the_settings(sent: float, most: float) -> None:
    rate_limit = RateLimit(most)
    passed = sum(rate_limit.passes(round(number / sent * NS)) for number in range(round(sent * 20)))
    assert passed / 20 == pytest.approx(min(sent, most), rel=0.02)


def test_without_a_rate_everything_passes_and_a_clock_that_goes_back_stops_nothing() -> None:
    assert all(RateLimit(None).passes(at) for at in (5, 5, 4, 9))
    rate_limit = RateLimit(1.0)
    assert rate_limit.passes(100 * NS)
    assert not rate_limit.passes(100 * NS + NS // 2)
    assert rate_limit.passes(7 * NS)
    assert not rate_limit.passes(7 * NS + NS // 2)
    assert rate_limit.passes(8 * NS)


def test_rates_are_those_of_the_last_seconds() -> None:
    meter = FlowMeter(0.0)
    for number in range(300):
        meter.count([RawMessage("/a", "a/msg/B", bytes(1000), 0, 0)], number / 30)
    rate, byte_rate = meter.rates(10.0)
    assert rate == pytest.approx(30, rel=0.05)
    assert byte_rate == pytest.approx(30_000, rel=0.05)
    assert meter.rates(12.5)[0] == pytest.approx(15, rel=0.05)
    assert meter.rates(20.0) == (0.0, 0.0)


def silence(came: Sequence[float], now: float, begin: float | None = None) -> str:
    """Of a topic on which messages came at these times, s, in a recording from `begin` on."""
    watch = SilenceWatch()
    for at in came:
        if begin is not None and at >= begin:
            watch.begin()
            begin = None
        watch.came(round(at * NS))
    return watch.words(round(now * NS))


STEADY = [number / 10 for number in range(50)]  # until 4.9 s


def test_a_camera_that_stops_is_silent_since_then_and_was_so_when_it_comes_again() -> None:
    assert silence(STEADY, 6.8) == ""
    assert silence(STEADY, 7.0).startswith("silent since ")
    again = [*STEADY, *(9 + at for at in STEADY)]
    assert silence(again, 14.0).startswith("silent from ")
    assert silence([*again, 20.0], 20.1) == silence([*again, 20.0], 21.9)
    assert silence(again, 14.0, begin=9.05) == ""


@pytest.mark.parametrize("came", [[], [0.0], [0.1 * n for n in range(15)], [0.0, 30.0, 60.0, 90.0]])
def test_what_comes_now_and_then_may_be_silent(came: Sequence[float]) -> None:
    assert silence(came, 1000.0) == ""
