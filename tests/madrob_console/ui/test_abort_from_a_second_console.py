"""A real engine, two consoles: the second one aborts with two keys, whatever the first one does."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from textual.pilot import Pilot

from madrob_console.engine.shown import wire
from madrob_console.engine.shown.requests import Role
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from madrob_console.ui.app import MadrobApp
from scoring.protocol import Outcome
from tests.madrob_console.engine.served import Served, simulated, start
from tests.madrob_console.ui.driver import DEFAULTS
from tests.watching import until

pytestmark = pytest.mark.machine

FIRST = "ada@hall (1)"
PROMPT = 2.0
"""From the first key to the end of the run on a busy machine, s."""


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    """An engine whose run ends by nobody but the referee."""
    served = Served(tmp_path, engine=simulated(tmp_path / "runs", scenario=Scenario.NO_TOUCH))
    yield served
    served.close()


def hung(served: Served, stack: ExitStack) -> None:
    """A console that greets and reads nothing."""
    console = stack.enter_context(socket.socket(socket.AF_UNIX))
    console.connect(str(served.path))
    console.sendall(wire.frame(wire.Hello(wire.VERSION, Role.REFEREE, FIRST)))
    until(lambda: served.server._referee is not None)


def attached(served: Served, stack: ExitStack) -> Callable[[], None]:
    """A console that reads what it is sent; returns what ends it."""
    client = served.attach(who=FIRST)
    stack.callback(client.close)
    return client.close


@pytest.mark.parametrize("size", [(120, 36), (40, 12)])
@pytest.mark.parametrize("first", ["alive", "hung", "gone"])
def test_two_keys_of_a_second_console_abort_the_run(
    served: Served, first: str, size: tuple[int, int]
) -> None:
    async def drive(ended: Callable[[], None] | None) -> None:
        second = served.attach(who="bo@tent (2)")
        app = MadrobApp(lambda: second, DEFAULTS)
        async with app.run_test(size=size) as pilot:
            await app.workers.wait_for_complete()
            if ended is not None:
                ended()
            has_it = "No console" if first == "gone" else FIRST
            await seen(pilot, lambda: second.snapshot().right.free == (first == "gone"))
            begun = time.monotonic()
            app.simulate_key("f8")
            asked = f"{has_it} has the right to act. Take it over"
            await seen(pilot, lambda: asked in text_of(app))
            app.simulate_key("y")
            await seen(pilot, lambda: served.local.snapshot().run.phase is Phase.STOPPED)
            print(f"{first}, {size[0]} x {size[1]}: F8 y, {time.monotonic() - begun:.2f} s")
            assert time.monotonic() - begun < PROMPT
            await app.workers.wait_for_complete()

    with ExitStack() as stack:
        close = None if first == "hung" else attached(served, stack)
        if first == "hung":
            hung(served, stack)
        start(served.local)
        asyncio.run(drive(close if first == "gone" else None))
    assert served.local.snapshot().run.outcome is Outcome.ABORTED


def text_of(app: MadrobApp) -> str:
    """What stands on the screen, without the frame of the question."""
    rows = (strip.text.replace("│", "") for strip in app.screen._compositor.render_strips())
    return " ".join(" ".join(rows).split())


async def seen(pilot: Pilot[None], there: Callable[[], bool]) -> None:
    """Wait for it, while the screens go on."""
    async with asyncio.timeout(20.0):
        while not there():
            await pilot.pause(0.01)
