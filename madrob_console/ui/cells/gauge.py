"""A horizontal scale with marks, shared by the door's and the handle's gauge."""

from __future__ import annotations

from collections.abc import Iterable

from madrob_console.ui.cells.lines import Line, Span, Tone


def column(value: float, limit: float, width: int) -> int:
    """The cell of `value` on a scale from -limit to +limit in `width` cells; clipped."""
    share = (max(-limit, min(limit, value)) + limit) / (2 * limit)
    return min(width - 1, max(0, round(share * (width - 1))))


def scale(track: str, marks: Iterable[tuple[int, str, Tone]]) -> Line:
    """A track with marks put on it, as (cell, character, tone); later marks win."""
    cells = [Span(char, Tone.DIM) for char in track]
    for cell, char, tone in marks:
        if 0 <= cell < len(cells):
            cells[cell] = Span(char, tone)
    return joined(cells)


def joined(cells: Iterable[Span]) -> Line:
    """Neighbours of one tone become one span."""
    spans: list[Span] = []
    for cell in cells:
        if spans and spans[-1].tone is cell.tone:
            spans[-1] = Span(spans[-1].text + cell.text, cell.tone)
        else:
            spans.append(cell)
    return tuple(spans)


def ruler(width: int, labels: Iterable[tuple[int, str]]) -> str:
    """Labels centred under their cells; one that would touch its neighbour is left out."""
    text = [" "] * width
    end = -1
    for cell, label in sorted(labels):
        begin = min(max(0, cell - len(label) // 2), max(0, width - len(label)))
        if begin > end:
            text[begin : begin + len(label)] = label
            end = begin + len(label)
    return "".join(text[:width])
