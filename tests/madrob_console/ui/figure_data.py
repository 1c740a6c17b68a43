"""Curves, and runs that they may belong to."""

from __future__ import annotations

import math

from madrob_console.engine.shown.curves import Curve, Curves
from madrob_console.referee.acts import ConfirmPose, SetUp, Start
from scoring.figure_table import Quantity
from scoring.protocol import EventName, Outcome
from tests.madrob_console.ui.fake_engine import FakeEngine
from tests.madrob_console.ui.setups import a_setup

DURATION = 14.0


def wave(height: float, count: int = 752) -> tuple[Curve, ...]:
    """15 s; the largest value, `height`, at 3.75 s."""
    times = [15.0 * i / count for i in range(count)]
    heights = [height * math.sin(t / 15 * math.tau) for t in times]
    return (Curve(tuple(times), tuple(heights)),)


CURVES = Curves(
    DURATION,
    stretches={
        Quantity.POSITION: wave(1.2),
        Quantity.ACCELERATION: wave(-0.68),
        Quantity.JERK: wave(12.5),
        Quantity.FORCE: wave(18.1),
    },
    events=(
        (0.0, EventName.BENCHMARK_START),
        (2.25, EventName.HANDLE_IS_TOUCHED),
        (3.22, EventName.DOOR_OPENS),
        (8.97, EventName.MOVES_TO_CW),
        (13.86, EventName.DOOR_CLOSES),
        (14.0, EventName.BENCHMARK_STOP),
    ),
)


def prepared() -> FakeEngine:
    """A run goes on."""
    engine = FakeEngine()
    for act in (SetUp(a_setup()), ConfirmPose(), Start()):
        assert engine.act(act) is None
    engine.tick(19.0)
    return engine


def finished(outcome: Outcome = Outcome.COMPLETED) -> FakeEngine:
    """A run with a result."""
    engine = prepared()
    engine.finish(outcome)
    return engine
