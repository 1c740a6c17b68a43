"""ASCII instead of the signs that a terminal or a line in between cannot show."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping

from rich.cells import cell_len
from rich.segment import Segment
from textual.color import Color
from textual.filter import LineFilter

UNKNOWN = "?"
"""Stands in each cell of a character that has no likeness in ASCII."""

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
}


def _table() -> Iterator[tuple[int, str]]:
    for signs, likeness in _SIGNS.items():
        yield from ((ord(sign), likeness) for sign in signs)
    for code in range(0x2500, 0x2580):
        yield code, _box(unicodedata.name(chr(code)))
    for code in range(0x2800, 0x2900):
        yield code, _dots(code - 0x2800)


def _box(name: str) -> str:
    """A line that goes one way, or `+` where lines meet."""
    words = name.replace("-", " ").split()
    if "DIAGONAL" in words:
        return "X" if "CROSS" in words else "/" if name.endswith("LOWER LEFT") else "\\"
    across = bool({"HORIZONTAL", "LEFT", "RIGHT"} & set(words))
    along = bool({"VERTICAL", "UP", "DOWN"} & set(words))
    return "+" if across and along else "|" if along else "=" if "DOUBLE" in words else "-"


def _dots(bits: int) -> str:
    """Dots of braille: in the upper half of the cell, in the lower, in both."""
    upper, lower = bits & 0b00011011, bits & 0b11100100
    return ":" if upper and lower else "'" if upper else "." if lower else " "


LIKENESS = dict(_table())
"""What stands for a sign in ASCII, in one cell as the sign itself; for `str.translate`."""


def uses_ascii(environ: Mapping[str, str], wanted: bool | None = None) -> bool:
    """Whether to draw with ASCII only.

    Args:
        environ: with TERM and the locale; one that is not set is taken for Unicode.
        wanted: what the settings or a flag say; None = find out.
    """
    if wanted is not None:
        return wanted
    if environ.get("TERM") in _TERMINALS:
        return True
    locale = next((environ[name] for name in _LOCALE if environ.get(name)), "UTF-8")
    return not _UTF_8.search(locale)


def to_ascii(text: str) -> str:
    """The text in ASCII, in as many cells.

    Letters lose their accents, signs become their likeness, and anything else, as the name of a
    team in another script, becomes `?` in each of its cells. Only the screen: files keep it.
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
        known = parts[0].isascii() and cells == 1 and all(map(unicodedata.combining, parts[1:]))
        drawn.append(parts[0] if known else UNKNOWN * cells)
    return "".join(drawn)


class AsciiFilter(LineFilter):
    """Brings all that widgets draw, borders and scrollbars too, down to ASCII."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """The same segments with other text."""
        return [Segment(to_ascii(text), style, control) for text, style, control in segments]


ASCII = AsciiFilter()
"""The one to add in `App.get_line_filters`: lines are cached for each filter."""
