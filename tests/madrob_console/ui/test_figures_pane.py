from __future__ import annotations

import math
import threading
from asyncio import to_thread
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len

from madrob_console.common.errors import MadrobError
from madrob_console.engine.curves import Curve, Curves
from madrob_console.engine.snapshot import Snapshot
from madrob_console.ui.cells.axes import Window
from madrob_console.ui.cells.lines import Line
from madrob_console.ui.cells.plot import TOP, Extreme, Frame, Mark, Plot
from madrob_console.ui.panes.figure_sheet import FIGURES, Sheet
from madrob_console.ui.panes.figures_pane import FiguresPane
from scoring.figure_table import Quantity
from scoring.indicator_table import IndicatorName
from scoring.protocol import EventName, Outcome
from scoring.result import Indicator, Uncertainty
from tests.madrob_console.ui.driver import PANE, Alone, PaneApp, Story, follow, showing
from tests.madrob_console.ui.inline_engine import finished, measured_as, running
from tests.madrob_console.ui.prepared import CURVES


class Reading:
    """Curves as the engine has them, or why they cannot be read; counts how often it is asked."""

    def __init__(self, *answers: Curves | Exception | None) -> None:
        self.answers = answers
        self.asked = 0

    def __call__(self) -> Curves | None:
        self.asked += 1
        answer = self.answers[min(self.asked, len(self.answers)) - 1]
        if isinstance(answer, Exception):
            raise answer
        return answer


async def view(
    load: Callable[[], Curves | None], snapshot: Snapshot, rows: Callable[[FiguresPane], Story]
) -> None:
    """See the figures of a run on a screen of their own."""
    pane = FiguresPane(partial(to_thread, load))
    async with showing(pane) as shown:
        pane.show(snapshot)
        await shown.settle()
        await follow(shown, rows(pane))


def titled(begin: str = "", end: str = "") -> Callable[[Alone], object]:
    return lambda shown: (
        (title := shown.rows()[0].strip()).startswith(begin) and title.endswith(end)
    )


COUNT = len(FIGURES)
KEYS = [
    ("", titled("figure 1", "0.00 to 14.98 s, all")),
    *(
        (key, titled(f"figure {number} of {COUNT}"))
        for number, key in zip(
            (*range(2, COUNT + 1), 1), cycle(("space", "right_square_bracket")), strict=False
        )
    ),
    ("left_square_bracket", titled(f"figure {COUNT} of {COUNT}")),
    ("plus", titled(end="2.50 to 12.48 s, part")),
    ("up", titled(end="4.16 to 10.82 s, part")),
    ("right", titled(end="5.83 to 12.48 s, part")),
    ("right*5", titled(end="8.32 to 14.98 s, part")),
    ("left*9", titled(end="0.00 to 6.66 s, part")),
    ("minus", titled(end="0.00 to 9.99 s, part")),
    ("down", titled(end="0.00 to 14.98 s, all")),
    ("plus*14", titled(end="7.39 to 7.59 s, part")),
    ("home", titled(end="0.00 to 14.98 s, all")),
    ("left down", titled(end="0.00 to 14.98 s, all")),
]


async def test_keys_turn_the_figures_and_move_and_zoom_in_time() -> None:
    await view(Reading(CURVES), finished(), lambda _: KEYS)


@pytest.mark.parametrize(
    ("answer", "outcome", "words"),
    [
        (
            MadrobError("the engine does not answer"),
            Outcome.COMPLETED,
            "the engine does not answer",
        ),
        (OSError(24, "Too many open files"), Outcome.COMPLETED, "[Errno 24] Too many open files"),
        (None, None, "no result yet: the figures come with it"),
        (Curves(3.0), Outcome.COMPLETED, "no figures: nothing was recorded"),
        (Curves(3.0), Outcome.ABORTED, "no figures: the run was aborted and is invalid"),
    ],
)
async def test_what_cannot_be_drawn_is_said_in_words(
    answer: Curves | Exception | None, outcome: Outcome | None, words: str
) -> None:
    rows: Story = [("", titled(words)), ("plus tab left", titled(words))]
    await view(Reading(answer), finished(outcome) if outcome else running(), lambda _: rows)


async def test_the_curves_are_read_again_for_another_result_only() -> None:
    load, state = Reading(CURVES), finished()

    def rows(pane: FiguresPane) -> Story:
        def shows(state: Snapshot, **run: Any) -> Callable[[Alone], object]:  # noqa: ANN401
            return lambda _: pane.show(replace(state, run=replace(state.run, **run)))

        def more(times: int) -> Callable[[Alone], object]:
            return lambda _: load.asked == before + times

        before = load.asked
        return [
            ("plus", titled(end="part")),
            (shows(replace(state, time=state.time + 1.0)),),
            (Alone.settle, more(0)),
            (shows(state, issue=2),),
            (Alone.settle, more(1), titled(end="part")),  # the same run: what is looked at stays
            (shows(state, start=1.0),),
            (Alone.settle, more(2), titled(end="all")),
        ]

    await view(load, state, rows)


async def test_a_late_answer_does_not_replace_a_newer_one() -> None:
    held, asked = threading.Event(), []

    def load() -> Curves | None:
        asked.append(0)
        if len(asked) == 1:
            assert held.wait(10)
        return CURVES if len(asked) > 1 else None

    pane = FiguresPane(partial(to_thread, load))
    app = PaneApp(pane)
    async with app.run_test(size=PANE) as pilot:
        shown = Alone(app, pilot)
        pane.enter()
        await shown.drawn()
        assert "reading the curves ..." in shown.text
        pane.show(finished())
        while "figure 1" not in shown.text:
            await pilot.pause(0.01)
        held.set()
        await follow(shown, [(Alone.settle, "figure 1"), (Alone.settle, "figure 1")])


def texts(lines: Sequence[Line]) -> list[str]:
    return ["".join(span.text for span in line) for line in lines]


WHOLE = Window(0.0, 15.0)


def drawn(
    number: int = 0,
    snapshot: Snapshot | None = None,
    *,
    curves: Curves = CURVES,
    window: Window = WHOLE,
    size: tuple[int, int] = (78, 19),
) -> list[str]:
    sheet = Sheet(number, curves, snapshot or finished(), window)
    return texts(sheet.lines(*size))


@pytest.mark.parametrize("number", range(len(FIGURES)))
@pytest.mark.parametrize("size", [(58, 13), (78, 17), (78, 19), (116, 29), (158, 43)])
def test_a_figure_fills_the_rows_that_there_are(number: int, size: tuple[int, int]) -> None:
    rows = drawn(number, size=size)
    assert len(rows) == size[1]
    assert size[0] < 78 or max(map(cell_len, rows)) <= size[0]  # else words end with an ellipsis


@pytest.mark.parametrize(
    ("number", "title", "finding", "heading"),
    [
        (
            0,
            "figure 1 of {all}: position and low-passed acceleration",
            "protocol: unsafety of door operation 1.8750 rad/s^2 = the maximum",
            "low-passed acceleration, rad/s^2   max abs 0.6800 at 3.75 s",
        ),
        (
            1,
            "figure 2 of {all}: position and jerk clipped at 2 rad/s^3",
            "protocol: smoothness of door actuation 0.0625 s^3/rad = 10/mean abs jerk",
            "abs jerk, rad/s^3 (clipped at 2)   max 12.5000 at 3.75 s",
        ),
        (
            2,
            "figure 3 of {all}: handle force",
            "protocol: roughness of door actuation 14.7500 N = the maximum",
            "force, N (as recorded)   max abs 18.1000 at 3.75 s",
        ),
    ],
)
def test_a_figure_says_which_it_is_of_which_run_and_what_it_explains(
    number: int, title: str, finding: str, heading: str
) -> None:
    rows = drawn(number)
    assert rows[0].startswith(title.format(all=len(FIGURES)))
    assert rows[0].endswith("0.00 to 15.00 s, all")
    run = "run 1 of subject 1 Door Bots, condition 1: pull, from CCW to CW, No Force"
    assert rows[1] == run
    assert rows[2] == finding
    assert heading in rows
    assert rows[-2] == "t touch 2.25  o opening 3.22  x crossing 8.97  c closing 13.86  s"


UNSAFETY = IndicatorName.UNSAFETY_OF_DOOR_OPERATION
DOUBTED = Indicator(1.875, "rad/s^2", None, Uncertainty(0.02, 0.04), ("a sample stepped",))
BACK = ((9.0, EventName.MOVES_TO_CCW), (13.0, EventName.DOOR_CLOSES))
BOUNCES = tuple((float(t), EventName.DOOR_CLOSES) for t in range(3, 13))
MAXIMUM = "low-passed acceleration, rad/s^2   max abs 0.6800 at 3.75 s"


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        pytest.param(
            drawn(
                1,
                measured_as(
                    {name: Indicator.missing(name, "door never opened") for name in IndicatorName}
                ),
                curves=replace(CURVES, stretches={**CURVES.stretches, Quantity.JERK: ()}),
            ),
            (
                "protocol: smoothness of door actuation none: door never opened",
                "abs jerk, rad/s^3   no data",
            ),
            id="an indicator without a value gives its reason",
        ),
        pytest.param(
            drawn(0, window=Window(8.0, 12.0)),
            ("8.00 to 12.00 s, part", f"{MAXIMUM}, not in this part"),
            id="a maximum out of sight is still told",
        ),
        pytest.param(
            drawn(curves=replace(CURVES, events=BACK)),
            ("\nc closing 13.00  s",),
            id="a way back to the starting side is no crossing",
        ),
        pytest.param(
            drawn(curves=replace(CURVES, events=BOUNCES)),
            ("\nc closing 3.00 .. (10) .. 12.00  s",),
            id="a door that bounces keeps the legend short",
        ),
        pytest.param(
            drawn(0, measured_as({UNSAFETY: DOUBTED})),
            ("unsafety of door operation 1.88? +- 0.04 rad/s^2 = the maximum",),
            id="the finding has uncertainty and doubt",
        ),
    ],
)
def test_a_figure_says(rows: Sequence[str], words: Sequence[str]) -> None:
    text = "\n".join(row.rstrip() for row in rows)
    assert [one for one in words if one not in text] == []


TEN_SECONDS = Window(0.0, 10.0)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


def curve(*points: tuple[float, float]) -> Curve:
    return Curve(tuple(time for time, _ in points), tuple(value for _, value in points))


def sine(count: int = 500, height: float = 1.0) -> Curve:
    return curve(*((10 * i / count, height * math.sin(i / count * 20)) for i in range(count)))


def plotted(
    plot: Plot,
    *marks: Mark,
    window: Window = TEN_SECONDS,
    width: int = 46,
    height: int = 9,
) -> list[str]:
    """The rows right of the y axis."""
    rows = texts(Frame(window, width, 5, marks).plot(plot, height))
    return [row[6:] for row in rows]


POINTS = st.lists(
    st.tuples(st.floats(-5, 20), NUMBERS), min_size=1, max_size=30, unique_by=lambda point: point[0]
)
PLOTS = st.builds(
    Plot,
    st.lists(POINTS, max_size=4).map(lambda parts: tuple(curve(*sorted(part)) for part in parts)),
    st.just(0.1),
    st.booleans(),
    st.sampled_from([2.0, 1e15]),
    st.sampled_from([None, 0.03]),
)
FRAMES = st.builds(
    Frame,
    st.builds(
        lambda start, width: Window(start, start + width), st.floats(-5, 15), st.floats(0.2, 20)
    ),
    st.integers(20, 150),
    st.just(0),
    st.lists(st.builds(Mark, st.floats(-10, 30), st.sampled_from("toxc")), max_size=8),
)


@given(PLOTS, FRAMES, st.integers(3, 40))
@settings(max_examples=150, deadline=None)
def test_any_data_fill_exactly_the_cells_that_there_are(
    plot: Plot, frame: Frame, height: int
) -> None:
    assert plot.axis(height).gutter <= 10
    frame = replace(frame, gutter=plot.axis(height).gutter)
    rows = texts(frame.plot(plot, height))
    assert len(rows) == height
    axis = texts(frame.time_axis())
    assert len(axis) == 2
    assert {cell_len(row) for row in rows + axis} == {frame.width}


def test_the_largest_absolute_value_is_marked_where_it_is() -> None:
    rows = plotted(Plot((curve((0, 0), (5, -3), (7.5, 2), (10, 0)),), 1.0))
    ((y, x),) = [(y, row.index(TOP)) for y, row in enumerate(rows) if TOP in row]
    assert x == 20
    assert y > len(rows) // 2


def test_the_largest_value_is_told_even_where_it_is_clipped_or_out_of_sight() -> None:
    plot = Plot((curve((0, 0.5), (2, -30.0)), curve((4, 1.0), (9, 1.5))), 2.0, True, clip=2.0)
    assert plot.extreme() == Extreme(2.0, -30.0)
    assert plot.axis(9).ticks[-1] == 2.0
    rows = plotted(plot)
    assert rows[0][8] == TOP
    assert not any(TOP in row for row in plotted(plot, window=Window(3.0, 10.0)))


def test_without_data_there_are_axes_and_no_curve() -> None:
    assert Plot((), 1.0).extreme() is None
    assert not "".join(plotted(Plot((), 1.0))).strip()


def test_nothing_is_drawn_over_a_gap() -> None:
    plot = Plot((curve((0, 1), (2.9, 1)), curve((7.1, 1), (10, 1))), 1.0)
    columns = list(zip(*plotted(plot), strict=True))
    assert all(char == " " for column in columns[12:28] for char in column)
    assert all(any(char != " " for char in column) for column in columns[:12] + columns[28:])


def test_a_curve_looks_like_itself() -> None:
    rows = texts(Frame(TEN_SECONDS, 40, 2).plot(Plot((sine(),), 0.1), 5))
    assert rows == [
        " 1┤ ⣠⠖⢲⡀        ⡴⠒⢦        ⢀⡴⠲⣄        ⣠",
        "  │⢰⠃  ⠹⡄      ⡼⠁ ⠈⢧      ⢠⠏  ⠘⣆      ⣰⠃",
        " 0┤⠏    ⢹⡀    ⣸⠁   ⠈⢧    ⢀⡞    ⠸⡄    ⢰⠃ ",
        "  │      ⢳⡀  ⣰⠃     ⠘⣆   ⡼      ⠹⡄  ⢠⠏  ",
        "-1┤       ⠳⣄⡴⠃       ⠘⢦⣠⠞⠁       ⠹●⣠⠏   ",
    ]
