"""ASCII in place of signs that a terminal cannot show."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping

from rich.cells import cell_len
from rich.segment import Segment
from textual.color import Color
from textual.filter import LineFilter

UNKNOWN = "?"
"""Replaces each cell of a character that has no likeness in ASCII."""

_TERMINALS = ("vt100", "vt102", "vt220")
_LOCALE = ("LC_ALL", "LC_CTYPE", "LANG")
_UTF_8 = re.compile(r"utf-?8", re.IGNORECASE)

_SIGNS = {
    "✓✔": "v",
    "✗✘\N{MULTIPLICATION SIGN}": "x",
    "●⬤◉■◆": "O",
    "○◯□◇◦": "o",
    "•★☆": "*",
    "·∙⋅": ".",
    "⚠": "!",
    "≤": "<",
    "≥": ">",
    "≈": "~",
    "…": "~",
    "±": "+",
    "°": "'",
    "²": "2",
    "³": "3",
    "µμ": "u",
    "\N{EN DASH}\N{EM DASH}\N{MINUS SIGN}": "-",
    "\N{LEFT SINGLE QUOTATION MARK}\N{RIGHT SINGLE QUOTATION MARK}": "'",
    "\N{LEFT DOUBLE QUOTATION MARK}\N{RIGHT DOUBLE QUOTATION MARK}": '"',
    "←◀◂◄⟵«": "<",
    "→▶▸►⟶»": ">",
    "↑▲▴↟": "^",
    "↓▼▾↡": "v",
    "↖↘": "\\",
    "↗↙": "/",
    "▁▂▃": "_",
    "▄▅▆▇▌▍▎▏▐▖▗▘▝▔▕": "=",
    "▀": '"',
    "█▉▊▋▙▚▛▜▞▟": "#",
    "░": ".",
    "▒": ":",
    "▓": "%",
    "─┄┅┈┉╴╶╸╺╼╾": "-",
    "│┃┆┇┊┋╎╏║╵╷╹╻╽╿": "|",
    "╌╍═━": "=",
    "\N{BOX DRAWINGS LIGHT DIAGONAL UPPER RIGHT TO LOWER LEFT}": "/",
    "╲": "\\",
    "\N{BOX DRAWINGS LIGHT DIAGONAL CROSS}": "X",
}


def _table() -> Iterator[tuple[int, str]]:
    yield from ((code, "+") for code in range(0x2500, 0x2580))  # boxes
    for signs, likeness in _SIGNS.items():
        yield from ((ord(sign), likeness) for sign in signs)
    yield from ((code, _dots(code - 0x2800)) for code in range(0x2800, 0x2900))


def _dots(bits: int) -> str:
    upper, lower = bits & 0b00011011, bits & 0b11100100
    return ":" if upper and lower else "'" if upper else "." if lower else " "


LIKENESS = dict(_table())
"""Signs and their ASCII likeness, both of one cell; for `str.translate`."""


def uses_ascii(environ: Mapping[str, str], wanted: bool | None = None) -> bool:
    """Whether to use ASCII only; None = by TERM and the locale, Unicode if that is not set."""
    if wanted is not None:
        return wanted
    if environ.get("TERM") in _TERMINALS:
        return True
    locale = next((environ[name] for name in _LOCALE if environ.get(name)), "UTF-8")
    return not _UTF_8.search(locale)


def to_ascii(text: str) -> str:
    """The text in ASCII, in as many cells.

    Letters lose their accents, signs become their likeness, anything else, as a name in another
    script, becomes `?` in each of its cells. Only for the screen: files keep the text.
    """
    if text.isascii():
        return text
    drawn = []
    before = 0
    for end, char in enumerate(text.translate(LIKENESS), start=1):
        cells = cell_len(text[:end]) - before
        before += cells
        if char.isascii() and cells == 1:
            drawn.append(char)
            continue
        parts = unicodedata.normalize("NFKD", char)
        is_letter = parts[0].isascii() and cells == 1 and all(map(unicodedata.combining, parts[1:]))
        drawn.append(parts[0] if is_letter else UNKNOWN * cells)
    return "".join(drawn)


class AsciiFilter(LineFilter):
    """Brings all that widgets draw, borders and scrollbars too, down to ASCII."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        return [Segment(to_ascii(text), style, control) for text, style, control in segments]


ASCII = AsciiFilter()
"""The one to add in `App.get_line_filters`: lines are cached for each filter."""
