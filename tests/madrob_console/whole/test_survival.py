"""Nothing ends a run but its stop: real terminals, real processes, real kill -9."""

from __future__ import annotations

import random
import re
import time
from collections.abc import Iterator

import pytest

from recorder.reader import Bag
from tests.madrob_console.engine_process import (
    STARTING,
    Hall,
)
from tests.watching import Stutter, until


@pytest.fixture
def hall() -> Iterator[Hall]:
    with Hall() as hall:
        yield hall


def test_spectators_find_the_engine_that_is_started_again(hall: Hall) -> None:
    """And a second console does; two consoles that start at once have one engine."""
    with hall.console() as terminal, hall.console() as other:
        for console in (terminal, other):
            console.wait_for("2 of 9 checks fail", timeout=STARTING)
        assert len(hall.status()) == 1
        with hall.console("watch") as small, hall.console("watch", "--big") as big:
            for spectator in (small, big):
                spectator.wait_for("WATCHING", timeout=STARTING)
            hall.kill_engine()
            big.wait_for("PAUSED - technical problem")
            for screen in (small, terminal, other):
                screen.wait_for("the engine has ended")
            for spectator in (small, big):
                assert not any("Ctrl+R" in line or "^R" in line for line in spectator.screen())
            assert not hall.status()  # none starts one by itself
            terminal.press("Ctrl+R")
            terminal.wait_for("The engine is there again", timeout=STARTING)
            for screen in (small, big, other):
                until(lambda s=screen: not re.search("ended|PAUSED", " ".join(s.screen())))  # type: ignore[misc]
            for spectator in (small, big):
                assert any("WATCHING" in line for line in spectator.screen())


@pytest.mark.slow
def test_killed_at_random_moments_an_engine_loses_half_a_second_at_most(
    request: pytest.FixtureRequest,
) -> None:
    rng = random.Random(8)
    for _ in range(max(2, request.config.getoption("--runs") // 4)):
        with Hall(speed=1.0) as hall:
            with hall.console() as terminal, Stutter() as stutter:
                terminal.start_a_run()
                folder = hall.wait_for_running()
                time.sleep(rng.uniform(0.2, 5.0))
                killed = hall.kill_engine()
            newest = max(message.receive_ns for message in Bag(folder).messages())
            lost = (killed - newest) / 1e9
            print(f"\nkill -9 of the engine: {lost:.2f} s lost")
            assert lost <= 0.6 + stutter.allowance  # half a second, and the time of the kill
            opened = hall.madrob("score", str(folder), "--json")
            assert (opened.returncode, '"interrupted"' in opened.stdout) == (0, True)
