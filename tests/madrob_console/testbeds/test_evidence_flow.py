from __future__ import annotations

import pytest

from madrob_console.clock import NS
from madrob_console.testbeds.evidence_flow import FlowMeter, Thinning
from recorder.message import RawMessage


@pytest.mark.parametrize(("sent", "most"), [(30.0, 10.0), (30.0, 20.0), (1000.0, 15.0), (29, 30)])
def test_a_faster_topic_is_thinned_to_the_rate_of_the_settings(sent: float, most: float) -> None:
    thinning = Thinning(most)
    passed = sum(thinning.passes(round(number / sent * NS)) for number in range(round(sent * 20)))
    assert passed / 20 == pytest.approx(min(sent, most), rel=0.02)


def test_without_a_rate_everything_passes_and_a_clock_that_goes_back_stops_nothing() -> None:
    assert all(Thinning(None).passes(at) for at in (5, 5, 4, 9))
    thinning = Thinning(1.0)
    assert thinning.passes(100 * NS)
    assert not thinning.passes(100 * NS + NS // 2)
    assert thinning.passes(7 * NS)
    assert not thinning.passes(7 * NS + NS // 2)
    assert thinning.passes(8 * NS)


def test_rates_are_those_of_the_last_seconds() -> None:
    meter = FlowMeter(0.0)
    for number in range(300):
        meter.count([RawMessage("/a", "a/msg/B", bytes(1000), 0, 0)], number / 30)
    rate, byte_rate = meter.rates(10.0)
    assert rate == pytest.approx(30, rel=0.05)
    assert byte_rate == pytest.approx(30_000, rel=0.05)
    assert meter.rates(12.5)[0] == pytest.approx(15, rel=0.05)
    assert meter.rates(20.0) == (0.0, 0.0)
