"""A page of the wall display: its parts as rows of the whole width."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.cells import cell_len
from textual.geometry import Size

from madrob_console.ui.cells.digits import digit_rows
from madrob_console.ui.cells.lines import Line, Span, Tone, line, width_of
from madrob_console.ui.look.words import fitted, shortened

_BANDS = {
    Tone.GOOD: Tone.LIVE,
    Tone.WARN: Tone.NOTICE,
    Tone.BAD: Tone.ALARM,
    Tone.STRONG: Tone.CAP,
}
_FILLED = (*_BANDS.values(),)

_ROWS_A_BAND, _ROWS_A_BOX = 20, 9
"""With so many rows of the screen a band is higher by one above and below, a box by one."""

_FRAMED = 16
"""With fewer rows the boxes have no frames."""

_LEAST_BOX = 12
"""Cells of a box: with fewer there are two rows of them."""

_BLANK = Span(" ")

PageRows = list[Line]


@dataclass(frozen=True, slots=True)
class Page:
    """What the hall sees at a time, from top to bottom; what is empty takes no room.

    Attributes:
        state: in the coloured band.
        who: the team on a row of its own, in any script, and what it does.
        figures: in large digits, each with what it is.
        boxes: the six steps, each with its time or how it stands.
        table: cells by row; all but those of the first column end at their right.
        below: rows of text.
    """

    state: Span
    who: Sequence[Span] = ()
    figures: Sequence[tuple[Span, str]] = ()
    boxes: Sequence[tuple[Span, str]] = ()
    table: Sequence[Sequence[Span]] = ()
    below: Sequence[Span] = ()

    def drawn(self, size: Size) -> PageRows:
        width, tone = size.width, _BANDS[self.state.tone]
        above = [_row(width, Span(" ", tone))] * min(2, size.height // _ROWS_A_BAND)
        every = (
            [*above, *_texts([Span(self.state.text, tone)], width), *above],
            _texts(self.who, width),
            _figures(self.figures, width),
            _boxes(self.boxes, size),
            _table(self.table, width),
            _texts(self.below, width),
        )
        parts = [part for part in every if part]
        spare = max(0, size.height - sum(map(len, parts)))
        between = [line()] * (spare // len(parts))
        return [row for part in parts for row in (*part, *between)][: size.height]


def _row(width: int, *spans: Span) -> Line:
    """Spans in the middle; a band fills the width."""
    blank = max(0, width - width_of(spans))
    tone = spans[0].tone if spans[0].tone in _FILLED else Tone.PLAIN
    return line(Span(" " * (blank // 2), tone), *spans, Span(" " * (blank - blank // 2), tone))


def _texts(spans: Iterable[Span], width: int) -> PageRows:
    """A row each; a long one is cut, whatever its script."""
    return [_row(width, Span(shortened(text, width), tone)) for text, tone in spans if text]


def _figures(shown: Sequence[tuple[Span, str]], width: int) -> PageRows:
    """Numbers in large digits beside each other."""
    groups = []
    for (text, tone), caption in shown:
        rows = digit_rows(text)
        cells = max(len(row) for row in (*rows, caption))
        lines = (*((row, tone) for row in rows), (caption, Tone.DIM))
        groups.append([Span(f"   {row:^{cells}}   ", of) for row, of in lines])
    return [_row(width, *spans) for spans in zip(*groups, strict=True)]


def _boxes(shown: Sequence[tuple[Span, str]], size: Size) -> PageRows:
    """The steps in a row of boxes, or in two; what is done is filled."""
    columns = 6 if size.width >= 6 * _LEAST_BOX else 3
    width, inner = size.width // columns - 1, size.height // _ROWS_A_BOX
    rows: PageRows = []
    for begin in range(0, len(shown), columns):
        boxes = [
            _box(name, state, width, inner)
            if size.height >= _FRAMED
            else [Span(fitted(f"{name.text[2:]} {state}", width), name.tone)]
            for name, state in shown[begin : begin + columns]
        ]
        rows += [
            _row(size.width, *(part for span in spans for part in (_BLANK, span)))
            for spans in zip(*boxes, strict=True)
        ]
    return rows


def _box(name: Span, state: str, width: int, inner: int) -> Sequence[Span]:
    above = (inner - 2) // 2
    texts = [*[""] * above, name.text, state, *[""] * (inner - 2 - above)]
    upper, side, lower = ("   ", " ", "   ") if name.tone in _FILLED else ("┌─┐", "│", "└─┘")
    framed = [f"{side}{text:^{width - 2}}{side}" for text in texts]
    ends = [f"{end[0]}{end[1] * (width - 2)}{end[2]}" for end in (upper, lower)]
    return [Span(row, name.tone) for row in (ends[0], *framed, ends[1])]


def _table(cells: Sequence[Sequence[Span]], width: int) -> PageRows:
    columns = [max(cell_len(text) for text, _ in column) for column in zip(*cells, strict=True)]
    first = min(columns[0], width - sum(columns[1:]) - 3 * len(columns)) if columns else 0
    return [
        _row(
            width,
            Span(fitted(name.text, first), name.tone),
            *(
                Span(f"   {text:>{room}}", tone)
                for (text, tone), room in zip(others, columns[1:], strict=True)
            ),
        )
        for name, *others in cells
    ]
