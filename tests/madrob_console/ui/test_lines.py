from __future__ import annotations

import asyncio
from collections.abc import Sequence

from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from textual.app import App, ComposeResult
from textual.screen import Screen

from madrob_console.ui.cells.gauge import column, ruler, scale
from madrob_console.ui.cells.lines import (
    TONE_CLASSES,
    Line,
    Lines,
    Span,
    Tone,
    changed_cells,
    line,
    width_of,
)

WIDTH = 12
SPANS = st.builds(Span, st.text("ab ─門é🤖", max_size=8), st.sampled_from(list(Tone)[:3]))
LINES = st.lists(SPANS, max_size=4).map(tuple)


class Page(Lines):
    """Shows what it is told."""

    content: Sequence[Line] = ()

    def lines(self, width: int) -> Sequence[Line]:
        return self.content


class PageApp(App[None]):
    CSS = "Page { width: 12; height: 3; }"

    def get_default_screen(self) -> Screen[None]:
        return PageScreen()


class PageScreen(Screen[None]):
    COMPONENT_CLASSES = TONE_CLASSES

    def compose(self) -> ComposeResult:
        yield Page()


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


def test_one_changed_digit_paints_one_cell() -> None:
    before = line("door ", Span("+0.310", Tone.STRONG), " rad")
    after = line("door ", Span("+0.311", Tone.STRONG), " rad")
    assert changed_cells(before, after, 0, 40).size == (1, 1)


def test_markup_and_control_characters_are_only_text() -> None:
    async def drive() -> None:
        app = PageApp()
        async with app.run_test(size=(20, 5)) as pilot:
            page = app.screen.query_one(Page)
            page.content = [line("[b]x[/]\x1b[31m\n!"), line("a long line that is cut")]
            page.redraw()
            await pilot.pause()
            strips = [page.render_line(y) for y in range(3)]
            assert [strip.text for strip in strips] == ["[b]x[/] !   ", "a long line…", " " * 12]

    asyncio.run(drive())


def test_a_line_is_as_wide_as_its_cells() -> None:
    assert width_of(line("門", Span("ab"), "")) == 4


def test_a_scale_clips_at_its_ends() -> None:
    assert [column(v, 10.0, 21) for v in (-99.0, -10.0, 0.0, 10.0, 99.0)] == [0, 0, 10, 20, 20]
    drawn = scale("-----", [(0, "a", Tone.GOOD), (4, "b", Tone.GOOD), (9, "c", Tone.BAD)])
    assert "".join(span.text for span in drawn) == "a---b"


def test_labels_of_a_ruler_do_not_run_into_each_other() -> None:
    assert ruler(20, [(0, "-90"), (10, "0"), (11, "1"), (19, "90")]) == "-90       0       90"
