from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from textual import events
from textual.app import App, ComposeResult
from textual.screen import Screen

from madrob_console.ui.cells.columns import GAP, ROOMY, Column, in_order, lay_out
from madrob_console.ui.cells.lines import TONE_CLASSES, Line, Span, Tone, width_of
from madrob_console.ui.cells.table import Table
from madrob_console.ui.panes.run_columns import Shown, indicator_column, number_text
from scoring.indicator_table import IndicatorName

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


def text(line: Line) -> str:
    return "".join(span.text for span in line)


def page(table: Table[Pair], width: int = 40, height: int = 7) -> list[str]:
    return [text(line).rstrip() for line in table.page(width, height)]


# ---------------------------------------------------------------- rows


def test_a_table_has_a_header_its_rows_and_says_where_it_is() -> None:
    assert page(a_table()) == [
        "  name▲    num",
        "> a          -",
        "  b          2",
        "  c          1",
        "  d          2",
        "",
        "  1-4 of 4, by name, ascending",
    ]


def test_missing_values_come_last_whichever_way_it_sorts() -> None:
    table = a_table()
    table.action_sort()
    assert [row[0] for row in table.rows] == ["b", "d", "c", "a"]
    assert "num▼" in page(table)[0]
    table.action_reverse()
    assert [row[0] for row in table.rows] == ["c", "b", "d", "a"]
    assert "num▲" in page(table)[0]
    table.action_sort()
    assert [row[0] for row in table.rows] == ["a", "b", "c", "d"]


@given(st.lists(st.none() | st.integers(-3, 3)))
def test_sorting_keeps_every_row_and_the_order_of_equals(numbers: list[int | None]) -> None:
    rows = [(f"{place:03}", number) for place, number in enumerate(numbers)]
    missing = [row for row in rows if row[1] is None]
    table = a_table(rows)
    table.action_sort()
    falling = sorted((row for row in rows if row[1] is not None), key=lambda row: -(row[1] or 0))
    assert list(table.rows) == [*falling, *missing]
    table.action_reverse()
    rising = sorted((row for row in rows if row[1] is not None), key=lambda row: row[1] or 0)
    assert list(table.rows) == [*rising, *missing]


def test_the_mark_moves_and_stays_inside() -> None:
    table = a_table(many(100))
    acts: list[tuple[Callable[[], None], int]] = [
        (lambda: table.action_move(1), 1),
        (lambda: table.action_move(-9), 0),
        (lambda: table.action_end(last=True), 99),
        (lambda: table.action_move(1), 99),
        (lambda: table.action_end(last=False), 0),
    ]
    for act, wanted in acts:
        act()
        assert table.selected == (f"{wanted:05}", wanted)
        assert any(row.startswith("> ") and f"{wanted:05}" in row for row in page(table))


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


def test_sorting_begins_at_the_top() -> None:
    table = a_table(many(10))
    table.action_move(7)
    table.action_sort()
    assert table.selected == ("00009", 9)


def test_an_empty_table_says_so() -> None:
    table = a_table([])
    table.empty = "no runs yet"
    assert page(table)[1] == "  no runs yet"
    assert page(table)[-1] == "  none, by name, ascending"


def test_only_the_rows_in_view_are_drawn() -> None:
    drawn: list[str] = []

    def cell(pair: Pair) -> Span:
        drawn.append(pair[0])
        return Span(pair[0])

    table = Table([Column("name", "name", cell, lambda pair: pair[0], 8)], lambda pair: pair[0])
    table.set_rows(many(10_000))
    table.action_move(5_000)
    table.page(80, 24)
    assert len(drawn) == 22
    assert "05000" in drawn


# ---------------------------------------------------------------- columns

WIDTHS = st.lists(st.tuples(st.integers(3, 50), st.booleans()), min_size=1, max_size=12)


def columns_of(widths: list[tuple[int, bool]]) -> list[Column[Pair]]:
    return [
        Column(
            f"c{number}", "m", lambda p: Span(p[0]), lambda p: p[0], width, comfort=comfort,
            ample=width + 3,
        )
        for number, (width, comfort) in enumerate(widths)
    ]  # fmt: skip


@given(WIDTHS, st.integers(0, 5), st.integers(10, 200))
def test_every_column_can_be_brought_into_view(
    widths: list[tuple[int, bool]], fixed: int, width: int
) -> None:
    columns = in_order(columns_of(widths), width)
    seen = []
    for first in range(len(columns)):
        layout = lay_out(columns, fixed, first, width)
        shown = [column for column, _ in layout.shown]
        seen += shown
        assert shown == [column for column in columns if column in shown]
        assert layout.before + len(shown) + layout.after == len(columns)
        assert 0 <= layout.first <= layout.last_first
        taken = sum(size for _, size in layout.shown) + GAP * (len(shown) - 1)
        assert taken <= width or len(shown) == 1
    assert set(seen) == set(columns)


@given(WIDTHS, st.integers(10, 200))
def test_comfort_comes_last_where_there_is_no_room(
    widths: list[tuple[int, bool]], width: int
) -> None:
    columns = columns_of(widths)
    order = in_order(columns, width)
    if width >= ROOMY:
        assert order == columns
    else:
        comforts = [column.comfort for column in order]
        assert comforts == sorted(comforts)


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


def test_the_last_line_counts_the_columns_out_of_view() -> None:
    columns = columns_of([(20, False)] * 6)
    table = Table(columns, lambda pair: pair[0], fixed=1)
    table.set_rows(PAIRS)
    assert page(table, 70)[-1].endswith("more columns  3 ->")
    assert page(table, 200)[-1].endswith("ascending")


def test_numbers_stand_on_the_right_and_long_texts_show_an_ellipsis() -> None:
    assert number_column().fit("12", 5) == "   12"
    assert name_column().fit("12", 5) == "12   "
    assert name_column().fit("abcdefgh", 5) == "abcd…"
    assert cell_len(name_column().fit("門門門", 5)) == 5
    assert name_column().fit("\x1b[31mx\n", 5) == "x    "


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


def indicator(name: IndicatorName) -> Column[Pair]:
    return indicator_column(name, lambda pair: Shown(pair[1]))


def test_an_indicator_column_says_what_it_is_and_in_which_unit() -> None:
    column = indicator(IndicatorName.UNSAFETY_OF_DOOR_OPERATION)
    assert column.meaning == "unsafety of door operation (rad/s^2)"
    assert column.cell(("a", None)) == Span("- ", Tone.DIM)
    assert column.value(("a", None)) is None


@pytest.mark.parametrize("name", list(IndicatorName))
def test_a_title_leaves_room_for_its_arrow(name: IndicatorName) -> None:
    column = indicator(name)
    assert len(column.title) < column.width


# ---------------------------------------------------------------- keys


class TableScreen(Screen[None]):
    COMPONENT_CLASSES = TONE_CLASSES

    def __init__(self) -> None:
        super().__init__()
        columns = columns_of([(12, False)] * 9)
        self.table = Table(columns, lambda pair: pair[0], fixed=1)
        self.chosen: list[str] = []
        self.marked: list[str | None] = []

    def compose(self) -> ComposeResult:
        yield self.table

    def on_table_chosen(self, event: Table.Chosen) -> None:
        self.chosen.append(event.key)

    def on_table_marked(self, event: Table.Marked) -> None:
        self.marked.append(event.key)


class TableApp(App[None]):
    CSS = "Table { height: 1fr; }"

    def __init__(self) -> None:
        super().__init__()
        self.table_screen = TableScreen()

    def get_default_screen(self) -> Screen[None]:
        return self.table_screen


def test_keys_and_mouse_move_choose_and_sort() -> None:
    async def drive() -> None:
        app = TableApp()
        async with app.run_test(size=(60, 12)) as pilot:
            screen, table = app.table_screen, app.table_screen.table
            table.set_rows(many(50))
            for keys, wanted in (
                (("down", "down", "up"), 1),
                (("pagedown",), 11),
                (("end",), 49),
                (("pageup",), 39),
                (("home",), 0),
            ):
                await pilot.press(*keys)
                assert table.selected == (f"{wanted:05}", wanted)
            await pilot.press("down", "enter")
            assert screen.chosen == ["00001"]
            assert screen.marked[-1] == "00001"
            await pilot.click(table, offset=(5, 4))
            assert table.selected == ("00003", 3)
            table.post_message(
                events.MouseScrollDown(table, 0, 0, 0, 1, 0, shift=False, meta=False, ctrl=False)
            )
            await pilot.pause()
            assert table.selected == ("00006", 6)

            def header() -> str:
                return table.render_line(0).text

            assert "c0▲" in header()
            assert "c8" not in header()
            await pilot.press(*["right"] * 20)
            assert "c0" in header()
            assert "c8" in header()
            await pilot.press("left")
            assert "c8" not in header()
            await pilot.press(*["o"] * 8)
            assert "c8▲" in header()
            await pilot.press("O")
            assert "c8▼" in header()
            await pilot.press("o")
            assert "c0▲" in header()

    asyncio.run(drive())
