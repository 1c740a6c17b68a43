"""Lines, glyphs and large digits in cells."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from textual import events

from madrob_console.engine.snapshot import Snapshot
from madrob_console.ui.cells.axes import scale
from madrob_console.ui.cells.columns import GAP, Column, lay_out
from madrob_console.ui.cells.digits import digit_rows
from madrob_console.ui.cells.lines import (
    Line,
    Lines,
    Span,
    Tone,
    changed_cells,
    line,
    plain,
    width_of,
)
from madrob_console.ui.cells.table import Table
from madrob_console.ui.frame.frame_lines import tiny_lines
from madrob_console.ui.panes.list_columns import number_text
from scoring.protocol import Outcome, Step
from tests.madrob_console.ui.driver import (
    Alone,
    Story,
    play_alone,
    showing,
)
from tests.madrob_console.ui.inline_engine import HandEngine, at_rest, start


def test_no_two_digits_of_the_clock_look_alike() -> None:
    drawn = ["\n".join(digit_rows(sign)) for sign in "0123456789:.-?"]
    assert len(set(drawn)) == len(drawn)


WIDTH = 12
SPANS = st.builds(Span, st.text("ab ─門é🤖", max_size=8), st.sampled_from(list(Tone)[:3]))
LINES = st.lists(SPANS, max_size=4).map(tuple)


class Page(Lines):
    """Shows what it is told."""

    content: Sequence[Line] = ()

    def lines(self, width: int) -> Sequence[Line]:
        return self.content


def cells(spans: Line) -> list[tuple[str, Tone]]:
    """What each cell shows; a wide character fills two."""
    return [
        (char, span.tone) for span in spans for char in span.text for _ in range(cell_len(char))
    ]


@given(LINES, LINES)
@settings(max_examples=300)
def test_every_cell_that_differs_is_painted(before: Line, after: Line) -> None:
    region = changed_cells(before, after, 1, WIDTH)
    assert region.y == 1
    assert region.x >= 0
    old, new = cells(before), cells(after)
    blank = (" ", Tone.PLAIN)
    for x in range(min(WIDTH, max(len(old), len(new)))):
        was = old[x] if x < len(old) else blank
        shown = new[x] if x < len(new) else blank
        if was != shown:
            assert region.x <= x < region.right


async def test_markup_and_control_characters_are_only_text() -> None:
    page = Page()
    page.styles.width, page.styles.height = WIDTH, 3
    async with showing(page) as shown:
        page.content = [line("[b]x[/]\x1b[31m\n!"), line("a long line that is cut")]
        page.redraw()
        await shown.settle()
        strips = [page.render_line(y) for y in range(3)]
        assert [strip.text for strip in strips] == ["[b]x[/] !   ", "a long line…", " " * 12]


def test_a_scale_clips_at_its_ends() -> None:
    drawn = scale("-----", [(0, "a", Tone.GOOD), (4, "b", Tone.GOOD), (9, "c", Tone.BAD)])
    assert plain([drawn]) == "a---b"


FAULT = "/madrob/passage/cw_left: no message for 2.3 s, the publisher is gone"


FAULTS = (FAULT, "recorder: 3 messages dropped")


@cache
def state_of(name: str) -> Snapshot:
    if name == "idle":
        return at_rest()
    early = name in {"counting", "false started"}
    engine = start(HandEngine(), 1.2 if early else 16.2)  # the countdown takes 5 s
    match name:
        case "false started":
            engine.touch()
        case "running" | "failing" | "stopped":
            engine.do_step(Step.TOUCH)
    match name:
        case "failing":
            engine.put(faults=FAULTS)
        case "stopped":
            engine.stop(Outcome.TIMEOUT)
    state = engine.snapshot()
    engine.end()
    return state


STATES = ("idle", "counting", "running", "failing", "false started", "stopped")


def drawn(state: str, width: int) -> list[str]:
    return plain(tiny_lines(state_of(state), width)).splitlines()


@pytest.mark.parametrize("width", [10, 14, 30, 59, 200])
@pytest.mark.parametrize("state", STATES)
def test_a_terminal_too_small_for_the_panes_has_rows_that_fit(state: str, width: int) -> None:
    assert all(cell_len(row) <= width for row in drawn(state, width))


@pytest.mark.parametrize(
    ("state", "width", "rows"),
    [
        ("counting", 10, ["COUNTDOWN", "-0:03.8", "F8 ABORT"]),
        ("running", 10, ["RUNNING", "0:11.2", "F8 ABORT"]),
        ("failing", 20, ["RUNNING  0:11.2", "F8 ABORT", "/madrob/passage/cw_"]),
        (
            "false started",
            40,
            ["HELD  -0:03.8  F8 ABORT", "FALSE START: handle touched at -3.8 s: r"],
        ),
        ("stopped", 40, ["TIMEOUT  0:11.2", "F8 abort: the run has stopped: void it"]),
        ("idle", 40, ["NO RUN SET UP  -:--.-", "F8 abort: no run is set up yet"]),
        (
            "failing",
            59,
            [
                "RUNNING  0:11.2  F8 ABORT",
                "/madrob/passage/cw_left: no message for 2.3 s, the",
                "publisher is gone  4:49 left  next: step 1 touch the handle",
                "60x18 shows all",
            ],
        ),
    ],
)
def test_it_says_what_matters_most_first(state: str, width: int, rows: Sequence[str]) -> None:
    assert drawn(state, width)[: len(rows)] == rows


Pair = tuple[str, int | None]
PAIRS: list[Pair] = [("b", 2), ("a", None), ("c", 1), ("d", 2)]


def name_column(width: int = 6) -> Column[Pair]:
    return Column("name", "name", lambda pair: Span(pair[0]), lambda pair: pair[0], width)


def number_column() -> Column[Pair]:
    return Column(
        "num", "number", lambda p: Span("-" if p[1] is None else str(p[1])), lambda p: p[1], 5,
        right=True, falling=True,
    )  # fmt: skip


def a_table(rows: Sequence[Pair] = PAIRS) -> Table[Pair]:
    table = Table([name_column(), number_column()], lambda pair: pair[0])
    table.set_rows(rows)
    return table


def many(count: int) -> list[Pair]:
    return [(f"{number:05}", number) for number in range(count)]


def page(table: Table[Pair], width: int = 40, height: int = 7) -> list[str]:
    return plain(table.page(width, height)).split("\n")


# ---------------------------------------------------------------- rows


@given(st.lists(st.none() | st.integers(-3, 3)))
def test_sorting_keeps_rows_and_the_order_of_equals_and_missing_values_come_last(
    numbers: list[int | None],
) -> None:
    rows = [(f"{place:03}", number) for place, number in enumerate(numbers)]
    table = a_table(rows)
    for falling, arrow in ((None, "num▼"), (False, "num▲")):
        table.sort_by(table.columns[1], falling=falling)
        sign = 1 if falling is False else -1
        assert list(table.rows) == sorted(
            rows, key=lambda row: (row[1] is None, sign * (row[1] or 0))
        )
        assert arrow in page(table)[0]


def test_the_mark_stays_on_its_row_when_rows_come_and_go() -> None:
    table = a_table(many(10))
    table.action_move(7)
    table.set_rows(many(20)[5:])
    assert table.selected == ("00007", 7)
    table.set_rows(many(3))
    assert table.selected == ("00002", 2)
    table.set_rows([])
    assert table.selected is None
    table.action_move(1)
    table.action_choose()
    table.set_rows(many(10), from_top=True)
    assert table.selected == ("00000", 0)
    table.action_move(7)
    table.action_turn()  # begins at the top
    assert table.selected == ("00009", 9)


# ---------------------------------------------------------------- columns

WIDTHS = st.lists(st.tuples(st.integers(3, 50), st.integers(0, 30)), min_size=1, max_size=12)


def columns_of(widths: list[tuple[int, int]]) -> list[Column[Pair]]:
    return [
        Column(f"c{n}", "m", lambda p: Span(p[0]), lambda p: p[0], width, ample=width + more)
        for n, (width, more) in enumerate(widths)
    ]


@given(WIDTHS, st.integers(0, 5), st.integers(10, 200))
def test_every_column_can_be_brought_into_view_and_ample_ones_take_what_is_left(
    widths: list[tuple[int, int]], fixed: int, width: int
) -> None:
    columns = columns_of(widths)
    seen = []
    for first in range(len(columns)):
        layout = lay_out(columns, fixed, first, width)
        shown = [column for column, _ in layout.shown]
        seen += shown
        assert shown == [column for column in columns if column in shown]
        assert layout.before + len(shown) + layout.after == len(columns)
        taken = sum(size for _, size in layout.shown) + GAP * (len(shown) - 1)
        assert taken <= width or len(shown) == 1
        assert all(column.width <= size <= column.ample for column, size in layout.shown)
        assert taken >= width or all(column.ample == size for column, size in layout.shown)
    assert set(seen) == set(columns)


@given(
    st.lists(st.tuples(st.text(min_size=1, max_size=90), st.none() | st.integers()), max_size=5),
    st.integers(30, 130),
    st.integers(1, 12),
)
def test_whatever_is_in_a_table_its_lines_fit(rows: list[Pair], width: int, height: int) -> None:
    table = a_table(rows)
    lines = table.page(width, height)
    assert len(lines) == max(3, height)
    assert all(width_of(line) <= width for line in lines)


def wide_table(count: int, ample: tuple[int, int], *, marks: bool = False) -> Table[Pair]:
    columns = columns_of([ample] * count)
    table = Table(columns, lambda pair: pair[0], fixed=1, marks_cells=marks)
    table.set_rows(PAIRS)
    return table


def marking(row: int, column: int) -> Table[Pair]:
    table = wide_table(9, (4, 0), marks=True)
    table.mark(row, column)
    return table


def told(table: Table[Pair], **said: str) -> Table[Pair]:
    vars(table).update(said)
    return table


@pytest.mark.parametrize(
    ("table", "width", "rows"),
    [
        (
            a_table(),
            40,
            {
                0: "  name▲    num",
                1: "> a          -",
                2: "  b          2",
                3: "  c          1",
                4: "  d          2",
                5: "",
                6: "  1-4 of 4, by name",
            },
        ),
        (told(a_table([]), empty="no runs yet"), 40, {1: "  no runs yet", 6: "  none, by name"}),
        # the last line counts the columns out of view
        (
            wide_table(6, (20, 3)),
            70,
            {6: "  1-4 of 4, by m                                          columns 3 ->"},
        ),
        (wide_table(6, (20, 3)), 40, {6: "  1-4 of 4, by m            columns 5 ->"}),
        (wide_table(6, (20, 3)), 200, {6: "  1-4 of 4, by m"}),
        (told(wide_table(6, (20, 3)), legend="! weighs"), 200, {6: "  1-4 of 4, by m   ! weighs"}),
        # a marked cell stands in brackets and is brought into view
        (wide_table(9, (4, 0), marks=True), 24, {1: "  a   [a   ]a    a"}),
        (marking(1, 8), 24, {2: "  b    b    b   [b   ]", 6: "  1-4 of 4… <- 5 columns"}),
        (marking(99, 0), 24, {4: "  d   [d   ]d    d"}),
    ],
)
def test_a_table_has_a_head_its_rows_and_says_where_it_is(
    table: Table[Pair], width: int, rows: Mapping[int, str]
) -> None:
    shown = page(table, width)
    assert {number: shown[number] for number in rows} == rows


@pytest.mark.parametrize(
    ("column", "text", "shown"),
    [
        (number_column(), "12", "   12"),
        (name_column(), "12", "12   "),
        (name_column(), "abcdefgh", "abcd…"),
        (name_column(), "門門門", "門門…"),
        (name_column(), "\x1b[31mx\n", "x    "),
    ],
)
def test_numbers_stand_on_the_right_and_long_texts_show_an_ellipsis(
    column: Column[Pair], text: str, shown: str
) -> None:
    assert column.fit(text, 5) == shown


# ---------------------------------------------------------------- indicators


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (6, "6"),
        (17.4321, "17.43"),
        (0.0, "0.00"),
        (300.0, "300.00"),
        (86400.0, "8.6e+04"),
        (0.0012, "1.2e-03"),
        (1e300, "1e+300"),
    ],
)
def test_a_number_is_short_and_never_a_false_zero(value: float, shown: str) -> None:
    assert number_text(value, 2, 7) == shown


# ---------------------------------------------------------------- keys


async def test_keys_and_mouse_move_choose_and_sort() -> None:
    table = Table(columns_of([(12, 0)] * 9), lambda pair: pair[0], fixed=1)
    table.styles.height = "1fr"
    table.set_rows(many(50))
    scroll = events.MouseScrollDown(table, 0, 0, 0, 1, 0, shift=False, meta=False, ctrl=False)

    def marks(number: int) -> Callable[[Alone], object]:
        return lambda shown: (
            table.selected == (f"{number:05}", number) and shown.marked.startswith(f"> {number:05}")
        )

    def head(*there: str, missing: str = "?") -> Callable[[Alone], object]:
        return lambda shown: (
            missing not in shown.rows()[0] and all(one in shown.rows()[0] for one in there)
        )

    rows: Story = [
        (lambda _: table.focus(),),
        ("down down up", marks(1)),
        ("pagedown", marks(11)),
        ("end down", marks(49)),
        ("pageup", marks(39)),
        ("home up", marks(0)),
        ("down enter", lambda shown: shown.app.sent == [Table.Chosen("00001")]),
        (lambda shown: shown.click_at(5, 4),),
        (Alone.settle, marks(3)),
        (lambda _: table.post_message(scroll),),
        (Alone.settle, marks(6), head("c0▲", missing="c8")),
        ("right*20", head("c0", "c8")),
        ("left", head(missing="c8")),
        ("o", head("c0▼")),
        ("greater_than_sign", head("c1▲")),
        ("less_than_sign less_than_sign", head("c8▲")),
    ]
    await play_alone(table, *rows, size=(60, 12))
