"""What a screen writes adds up to what it shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pyte
import pytest
from rich.console import RenderableType
from textual._compositor import CompositorUpdate
from textual.screen import Screen

from madrob_console.ui.app import MadrobApp
from scoring.protocol import Side, Step
from tests.madrob_console.ui.driver import driving
from tests.madrob_console.ui.fake_engine import FakeEngine

SIZE = 80, 24


@contextmanager
def written(monkeypatch: pytest.MonkeyPatch) -> Iterator[pyte.Screen]:
    """A terminal that takes every update of the console."""
    terminal = pyte.Screen(*SIZE)
    stream = pyte.Stream(terminal)
    display = MadrobApp._display

    def show(app: MadrobApp, screen: Screen[object], update: RenderableType | None) -> None:
        if isinstance(update, CompositorUpdate) and not app._batch_count:
            # a pty makes CR LF of its line feeds
            stream.feed(update.render_segments(app.console).replace("\n", "\r\n"))
        display(app, screen, update)

    monkeypatch.setattr(MadrobApp, "_display", show)
    yield terminal


async def test_changed_cells_add_up_to_the_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    with written(monkeypatch) as terminal:
        async with driving(FakeEngine(), SIZE) as driver:
            engine = driver.engine
            await driver.run()
            for tick, key in enumerate(("f2", "f3", "f8", "escape", "question_mark", "f3", "f4")):
                engine.angle, engine.force = 0.1 * tick, 3.0 - tick
                engine.occupied = {(Side.CCW, tick % 5)}
                engine.say(f"門 event {tick} ❤")
                await driver.let_pass(0.3)
                assert_same(terminal, driver.rows())
                await driver.press(key)
                assert_same(terminal, driver.rows())
            engine.do_step(Step.TOUCH)
            await driver.press("f3")
            await driver.finish()
            assert_same(terminal, driver.rows())


def assert_same(terminal: pyte.Screen, rows: Sequence[str]) -> None:
    shown = [row.rstrip() for row in terminal.display]
    assert shown == rows
