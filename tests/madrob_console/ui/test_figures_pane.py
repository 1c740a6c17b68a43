from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path, PurePath
from typing import ClassVar

import pytest
from textual.app import App, ComposeResult
from textual.pilot import Pilot
from textual.screen import Screen

from madrob_console.engine.shown.curves import Curves
from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import Abort
from madrob_console.ui.cells import lines as lines_module
from madrob_console.ui.cells.lines import TONE_CLASSES
from madrob_console.ui.cells.plot import ASCII, BRAILLE
from madrob_console.ui.panes import figures_pane as figures
from madrob_console.ui.panes.figure import FIGURES
from madrob_console.ui.panes.figures_pane import FiguresPane
from tests.madrob_console.ui.figure_data import CURVES, finished, prepared


class Page(Screen[None]):
    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES

    def __init__(self, pane: FiguresPane) -> None:
        super().__init__()
        self.pane = pane

    def compose(self) -> ComposeResult:
        yield self.pane


class PageApp(App[None]):
    CSS_PATH: ClassVar[list[str | PurePath]] = [
        Path(lines_module.__file__).with_suffix(".tcss"),
        Path(figures.__file__).with_suffix(".tcss"),
    ]

    def __init__(self, pane: FiguresPane, *, plain: bool = False) -> None:
        super().__init__()
        self.ascii = plain
        self.page = Page(pane)

    def get_default_screen(self) -> Screen[None]:
        return self.page


@dataclass
class Viewer:
    """The pane under test, on a screen of its own."""

    app: PageApp
    pilot: Pilot[None]

    @property
    def pane(self) -> FiguresPane:
        return self.app.page.pane

    async def settle(self) -> None:
        await self.app.workers.wait_for_complete()
        await self.pilot.pause()

    async def press(self, *keys: str) -> str:
        """Press keys; returns the title that follows."""
        await self.pilot.press(*keys)
        return self.title

    @property
    def rows(self) -> list[str]:
        width, height = self.app.size
        strips = self.app.screen._compositor.render_strips()
        return [strip.text[:width].strip() for strip in strips[:height]]

    @property
    def title(self) -> str:
        return self.rows[0]


@asynccontextmanager
async def viewing(
    load: Callable[[], Curves | None], snapshot: Snapshot, *, plain: bool = False
) -> AsyncIterator[Viewer]:
    app = PageApp(FiguresPane(load), plain=plain)
    async with app.run_test(size=(80, 19)) as pilot:
        viewer = Viewer(app, pilot)
        viewer.pane.enter()
        viewer.pane.show(snapshot)
        await viewer.settle()
        yield viewer


def run(drive: Callable[[], Awaitable[None]]) -> None:
    async def main() -> None:
        await drive()

    asyncio.run(main())


def test_keys_turn_the_figures_and_move_and_zoom_in_time() -> None:
    async def drive() -> None:
        async with viewing(lambda: CURVES, finished().snapshot()) as viewer:
            assert viewer.title.endswith("0.00 to 14.98 s, all")
            count = len(FIGURES)
            keys = cycle(("tab", "right_square_bracket", "space"))
            for number, key in zip((*range(2, count + 1), 1), keys, strict=False):
                assert f"figure {number} of {count}" in await viewer.press(key)
            assert f"figure {count} of {count}" in await viewer.press("left_square_bracket")
            assert (await viewer.press("plus")).endswith("2.50 to 12.48 s, part")
            assert (await viewer.press("up")).endswith("4.16 to 10.82 s, part")
            assert (await viewer.press("right")).endswith("5.83 to 12.48 s, part")
            assert (await viewer.press(*["right"] * 5)).endswith("8.32 to 14.98 s, part")
            assert (await viewer.press(*["left"] * 9)).endswith("0.00 to 6.66 s, part")
            assert (await viewer.press("minus")).endswith("0.00 to 9.99 s, part")
            assert (await viewer.press("down")).endswith("0.00 to 14.98 s, all")
            assert (await viewer.press(*["plus"] * 14)).endswith("7.39 to 7.59 s, part")
            assert (await viewer.press("home")).endswith("0.00 to 14.98 s, all")
            assert (await viewer.press("left", "down")).endswith("0.00 to 14.98 s, all")

    run(drive)


@pytest.mark.parametrize("plain", [False, True])
def test_the_pane_draws_with_the_characters_that_the_terminal_has(plain: bool) -> None:
    async def drive() -> None:
        async with viewing(lambda: CURVES, finished().snapshot(), plain=plain) as viewer:
            assert len(viewer.rows) == 19
            assert "".join(viewer.rows).isascii() == plain
            assert any((ASCII if plain else BRAILLE).top in row for row in viewer.rows)

    run(drive)


def test_what_cannot_be_drawn_is_said_in_words() -> None:
    silent = MadrobError("the engine does not answer: leave and start again")
    no_handles = OSError(24, "Too many open files")

    async def drive() -> None:
        ended = finished().snapshot()
        for error in (silent, no_handles):

            def fail(error: Exception = error) -> Curves | None:
                raise error

            async with viewing(fail, ended) as viewer:
                assert viewer.rows[0] == str(error)
                await viewer.press("plus", "tab", "left")
                assert viewer.rows[0] == str(error)
        async with viewing(lambda: None, prepared().snapshot()) as viewer:
            assert viewer.rows[0] == "no result yet: the figures come with it"
        async with viewing(lambda: Curves(3.0), ended) as viewer:
            assert viewer.rows[0].startswith("no figures: nothing was recorded")
        engine = prepared()
        assert engine.act(Abort("a person in the doorway")) is None
        async with viewing(lambda: Curves(3.0), engine.snapshot()) as viewer:
            assert viewer.rows[0] == "no figures: the run was aborted and is invalid"

    run(drive)


def test_the_curves_are_read_again_for_another_result_only() -> None:
    asked: list[int] = []

    def load() -> Curves:
        asked.append(len(asked))
        return CURVES

    async def drive() -> None:
        engine = finished()
        async with viewing(load, engine.snapshot()) as viewer:
            zoomed = await viewer.press("plus")
            before = len(asked)
            engine.tick(1.0)
            viewer.pane.show(engine.snapshot())
            await viewer.settle()
            assert len(asked) == before
            engine.score()
            viewer.pane.show(engine.snapshot())
            await viewer.settle()
            assert len(asked) == before + 1
            assert viewer.title == zoomed  # the same run: what is looked at stays
            other = finished()
            other.run = replace(other.run, start=1.0)
            viewer.pane.show(other.snapshot())
            await viewer.settle()
            assert len(asked) == before + 2
            assert viewer.title.endswith("all")

    run(drive)


def test_a_late_answer_does_not_replace_a_newer_one() -> None:
    held = threading.Event()
    answers: list[Curves | None] = [CURVES, None]

    def load() -> Curves | None:
        answer = answers.pop()
        if answer is None:
            assert held.wait(10)
        return answer

    async def drive() -> None:
        pane = FiguresPane(load)
        app = PageApp(pane)
        async with app.run_test(size=(80, 19)) as pilot:
            viewer = Viewer(app, pilot)
            pane.enter()
            await pilot.pause()
            assert viewer.rows[0] == "reading the curves ..."
            pane.show(finished().snapshot())
            while "figure 1" not in viewer.title:
                await pilot.pause(0.01)
            held.set()
            await viewer.settle()
            await pilot.pause(0.1)
            assert "figure 1" in viewer.title

    run(drive)
