"""Flags on the screens: signs, tones, lines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from madrob_console.referee.flags import Flag, FlagWeight, undecided, worst
from madrob_console.ui.cells.lines import Line, Span, Tone, width_of
from madrob_console.ui.look.words import wrapped

FLAG_TONES = {
    FlagWeight.REMARK: Tone.DIM,
    FlagWeight.CAUTION: Tone.WARN,
    FlagWeight.ALARM: Tone.BAD,
}
_SIGNS = {None: "", FlagWeight.REMARK: "", FlagWeight.CAUTION: "!", FlagWeight.ALARM: "!!"}
_BETWEEN = Span("; ", Tone.DIM)


def flag_sign(found: Iterable[Flag]) -> str:
    """The heaviest of some flags in two cells, `!!` with one undecided; empty if none weighs."""
    flags = tuple(found)
    return _SIGNS[FlagWeight.ALARM if undecided(flags) else worst(flags)]


def flag_lines(
    found: Sequence[Flag], width: int, hints: Mapping[str, str] | None = None
) -> list[Line]:
    """All words of some flags, each in its tone, on as many rows as they need.

    Args:
        found: the flags, in order.
        width: cells of a row.
        hints: what the referee can do about a flag, by its kind.
    """
    rows: list[list[Span]] = []
    for flag in found:
        how = (hints or {}).get(flag.kind) if flag.undecided else None
        text = flag.words + (f": {how}" if how else "")
        tone = FLAG_TONES[flag.weight]
        for number, part in enumerate(wrapped(text, width)):
            span = Span(part, tone)
            room = width - width_of((*rows[-1], _BETWEEN)) if rows else 0
            if number == 0 and rows and width_of((span,)) <= room:
                rows[-1] += [_BETWEEN, span]
            else:
                rows.append([span])
    return [tuple(row) for row in rows]
