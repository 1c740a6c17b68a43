from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path, PurePath
from typing import ClassVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from textual.app import App, ComposeResult
from textual.screen import Screen

from madrob_console.referee.acts import ConfirmPose, SetUp, Start
from madrob_console.ui.cells import lines as lines_module
from madrob_console.ui.cells.lines import TONE_CLASSES, Line, Tone
from madrob_console.ui.frame import tiny_clock
from madrob_console.ui.frame.tiny_clock import SMALLEST, TinyClock, tiny_lines
from scoring.protocol import Outcome, Step
from tests.madrob_console.ui.fake_engine import FakeEngine
from tests.madrob_console.ui.setups import a_setup

FAULT = "/madrob/passage/cw_left: no message for 2.3 s, the publisher is gone"


def idle() -> FakeEngine:
    return FakeEngine()


def counting() -> FakeEngine:
    engine = idle()
    for act in (SetUp(a_setup()), ConfirmPose(), Start()):
        assert engine.act(act) is None
    engine.tick(1.2)
    return engine


def running() -> FakeEngine:
    engine = counting()
    engine.tick(15.0)
    engine.do_step(Step.TOUCH)
    return engine


def failing() -> FakeEngine:
    engine = running()
    engine.faults = (FAULT, "recorder: 3 messages dropped")
    return engine


def false_started() -> FakeEngine:
    engine = counting()
    engine.false_start()
    return engine


def stopped() -> FakeEngine:
    engine = running()
    engine.finish(Outcome.TIMEOUT)
    return engine


STATES = (idle, counting, running, failing, false_started, stopped)


def lines(engine: FakeEngine, width: int, height: int) -> list[Line]:
    return tiny_lines(engine.snapshot(), width, height)


def drawn(engine: FakeEngine, width: int, height: int) -> list[str]:
    return ["".join(span.text for span in line).rstrip() for line in lines(engine, width, height)]


@given(st.sampled_from(STATES), st.integers(10, 120), st.integers(0, 20))
@settings(max_examples=200)
def test_it_never_needs_more_room_than_there_is(
    state: Callable[[], FakeEngine], width: int, height: int
) -> None:
    rows = drawn(state(), width, height)
    assert len(rows) <= height
    assert all(cell_len(row) <= width for row in rows)


@pytest.mark.parametrize("width", [SMALLEST[0], 14, 30, 59, 200])
@pytest.mark.parametrize("height", [SMALLEST[1], 4, 8, 17])
@pytest.mark.parametrize("state", [counting, running, failing, false_started])
def test_clock_phase_and_abort_are_there_in_the_smallest_terminal(
    state: Callable[[], FakeEngine], width: int, height: int
) -> None:
    text = "\n".join(drawn(state(), width, height))
    if state in (counting, false_started):
        assert "COUNTDOWN" in text
        assert "-0:03.8" in text
    else:
        assert "RUNNING" in text
        assert "0:11.2" in text
    assert "F8 ABORT" in text


def test_rows_are_given_by_importance() -> None:
    assert drawn(failing(), 12, 1) == ["0:11.2"]
    assert drawn(failing(), 12, 2) == ["0:11.2", "F8 ABORT"]
    assert drawn(failing(), 12, 3) == ["RUNNING", "0:11.2", "F8 ABORT"]
    assert drawn(failing(), 12, 4) == ["RUNNING", "0:11.2", "FAULT /madr…", "F8 ABORT"]
    assert drawn(failing(), 12, 5)[2] == "4:49 left"
    assert drawn(failing(), 12, 6)[3] == "next: step …"


def test_practice_is_said_before_what_is_next_and_what_is_left() -> None:
    engine = running()
    assert not any("PRACTICE" in row for row in drawn(engine, 40, 3))
    assert engine.run.setup is not None
    engine.run = replace(engine.run, setup=replace(engine.run.setup, practice=True))
    assert any("PRACTICE" in row for row in drawn(engine, 40, 3))


def test_with_room_everything_is_said_in_full() -> None:
    assert drawn(failing(), 59, 17) == [
        "RUNNING  0:11.2  4:49 left",
        "next: step 2 unlock the door",
        "FAULT /madrob/passage/cw_left: no message for 2.3 s, the",
        "publisher is gone",
        "F8 ABORT",
        "60x18 shows all",
    ]


def test_a_false_start_comes_before_what_is_next() -> None:
    rows = drawn(false_started(), 40, 5)
    assert rows[1].startswith("FALSE START: handle touched")
    assert rows[-1] == "F8 ABORT"
    assert not any("countdown:" in row for row in rows)


def test_an_abort_that_is_not_possible_says_why_and_is_not_reversed() -> None:
    (row,) = [row for row in lines(stopped(), 59, 17) if row[0].text.startswith("F8 abort")]
    assert row[0].text.startswith("F8 abort: the run has stopped")
    assert all(span.tone is not Tone.CAP for span in row)
    assert drawn(stopped(), 12, 3)[-1] == "(F8 abort)"
    assert [span.tone for span in lines(running(), 12, 3)[-1]] == [Tone.CAP, Tone.STRONG]


@pytest.mark.parametrize("outcome", list(Outcome))
def test_a_stopped_run_shows_its_outcome_and_time(outcome: Outcome) -> None:
    engine = running()
    engine.run = replace(engine.run, outcome=outcome)
    rows = drawn(engine, 20, 4)
    assert rows[0].startswith(outcome.upper())


def test_without_a_run_there_is_no_time() -> None:
    assert drawn(idle(), 30, 3)[0] == "NO RUN SET UP  -:--.-"


class Page(Screen[None]):
    COMPONENT_CLASSES = TONE_CLASSES

    def compose(self) -> ComposeResult:
        yield TinyClock()


class PageApp(App[None]):
    CSS_PATH: ClassVar[list[str | PurePath]] = [
        Path(module.__file__ or "").with_suffix(".tcss") for module in (lines_module, tiny_clock)
    ]

    def get_default_screen(self) -> Screen[None]:
        return Page()


def test_the_widget_takes_the_rows_of_the_terminal_as_it_changes() -> None:
    async def drive() -> None:
        app = PageApp()
        async with app.run_test(size=SMALLEST) as pilot:
            clock = app.screen.query_one(TinyClock)
            clock.show(running().snapshot())
            for height in (3, 17):
                await pilot.resize_terminal(59, height)
                await pilot.pause()
                rows = [clock.render_line(y).text.rstrip() for y in range(clock.size.height)]
                assert len(rows) == height
                assert [row for row in rows if row] == drawn(running(), 59, height)

    asyncio.run(drive())
