"""Recorded time: from instant to instant, however one goes through it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from madrob_console.clock import NS, nanoseconds
from madrob_console.testbeds.recorded_clock import TICK, RecordedClock

BEGIN_NS = 1_700_000_000_000_000_000
STOPS = [BEGIN_NS - 5, BEGIN_NS + 7, BEGIN_NS + 7, BEGIN_NS + nanoseconds(0.31), BEGIN_NS + 9 * NS]


class Player:
    """A recording of two seconds, in real time that passes only where somebody waits."""

    def __init__(self, speed: float = 1.0) -> None:
        self.real = 50.0
        self.clock = RecordedClock(
            BEGIN_NS, BEGIN_NS + 2 * NS, speed, lambda: self.real, self._wait
        )
        self.clock.stop_at(STOPS)

    def _wait(self, duration: float) -> None:
        self.real += duration

    def until(self, done: Callable[[], bool]) -> list[int]:
        """The instants on the way, as ns from the beginning, each once."""
        instants: list[int] = []
        while not done():
            self.clock.sleep(TICK)
            instant = self.clock.now_ns() - BEGIN_NS
            if instants[-1:] != [instant]:
                instants.append(instant)
        return instants


EVERY = sorted({*(n * nanoseconds(TICK) for n in range(101)), 7, nanoseconds(0.31)})
"""The instants of the recording; what lies before or behind it is none."""


@pytest.mark.parametrize("speed", [0, 0.3, 1, 40, 1000])
def test_the_instants_are_the_same_at_any_speed(speed: float) -> None:
    player = Player(speed)
    assert player.until(lambda: player.clock.ended) == EVERY


def test_a_jump_passes_every_instant_and_waits_for_none() -> None:
    player = Player()
    player.clock.go_to(60)
    before = player.real
    passed = player.until(lambda: player.clock.target is None)
    assert passed == [instant for instant in EVERY if instant <= 60 * nanoseconds(TICK)]
    assert player.real == before


def test_a_jump_back_begins_anew() -> None:
    player = Player(0)
    player.until(lambda: player.clock.ended)
    player.clock.go_to(10)
    assert player.clock.now_ns() == BEGIN_NS
    passed = player.until(lambda: player.clock.target is None)
    assert passed == [instant for instant in EVERY if instant <= 10 * nanoseconds(TICK)]


def test_what_was_not_done_at_a_high_speed_is_not_caught_up_with_at_another() -> None:
    player = Player(1000)
    for _ in range(5):
        player.clock.sleep(TICK)
    assert player.clock.set_speed(1) is None
    ticks, before = player.clock.ticks, player.real
    player.until(lambda: player.real - before > 0.5)
    assert player.clock.ticks - ticks == pytest.approx(25, abs=2)
