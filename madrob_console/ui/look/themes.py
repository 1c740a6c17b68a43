"""Colours of the screens, and ASCII signs for terminals that need them.

Each exists in full colours and, for terminals with 16 of them, in colours of the terminal's own
palette: brought down by arithmetic, a green may end as white and a grey on its background. The
full ones keep to what 256-colour terminals have or nearly have, as most do over SSH.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping
from functools import lru_cache

from rich.cells import cell_len
from rich.console import Console
from rich.segment import Segment
from rich.style import Style
from textual.color import Color
from textual.filter import LineFilter
from textual.theme import Theme

from madrob_console.common.names import ThemeName

COLOURLESS = "colourless"
"""Bold, dim, underlined and reversed text in the terminal's own two colours."""

_OF_16 = "-16"


_COLUMNS = (ThemeName.DARK, ThemeName.LIGHT, ThemeName.HIGH_CONTRAST)
# backgrounds of the screen, of dialogs, of lines and fields, of the field in use; inks
_COLOURS = {
    "background": ("#121212", "#ffffff", "#000000"),
    "surface": ("#1c1c1c", "#f2f2f2", "#000000"),
    "panel": ("#262626", "#e8e8e8", "#1c1c1c"),
    "focus": ("#444444", "#c6c6c6", "#00005f"),
    "foreground": ("#e4e4e4", "#1c1c1c", "#ffffff"),
    "muted": ("#a8a8a8", "#4e4e4e", "#d0d0d0"),
    "good": ("#87d787", "#005f00", "#5fff5f"),
    "warning": ("#ffd75f", "#875f00", "#ffff00"),
    "bad": ("#ff8787", "#af0000", "#ff8787"),
    "accent": ("#5fafff", "#005faf", "#5fffff"),
    "thumb": ("#767676", "#767676", "#d0d0d0"),
}
_COLOURS_OF_16 = {
    "background": ("ansi_black", "ansi_bright_white", "ansi_black"),
    "surface": ("ansi_black", "ansi_bright_white", "ansi_black"),
    "panel": ("ansi_black", "ansi_bright_white", "ansi_black"),
    "focus": ("ansi_black", "ansi_bright_white", "ansi_black"),
    "foreground": ("ansi_bright_white", "ansi_black", "ansi_bright_white"),
    # greys, greens and yellows of most palettes are faint on white
    "muted": ("ansi_white", "ansi_black", "ansi_bright_white"),
    "good": ("ansi_bright_green", "ansi_blue", "ansi_bright_green"),
    "warning": ("ansi_bright_yellow", "ansi_magenta", "ansi_bright_yellow"),
    "bad": ("ansi_bright_red", "ansi_red", "ansi_bright_red"),
    "accent": ("ansi_bright_cyan", "ansi_blue", "ansi_bright_cyan"),
    "thumb": ("ansi_white", "ansi_bright_black", "ansi_white"),
}


def theme_for(name: str, environ: Mapping[str, str]) -> str:
    """Which theme to use for a name, by TERM, COLORTERM and NO_COLOR, which counts unless empty."""
    if environ.get("NO_COLOR") or environ.get("TERM", "").startswith("vt"):
        return COLOURLESS  # a VT100 and its kin have no colours either
    colours = environ.get("TEXTUAL_COLOR_SYSTEM", "auto")
    if colours == "auto":  # as textual finds it out
        console = Console(
            color_system="auto", force_terminal=True, legacy_windows=False, _environ=environ
        )
        colours = console.color_system or ""
    return f"{name}{_OF_16}" if colours == "standard" else str(name)


class NoColours(LineFilter):
    """Leaves out every colour, the terminal's own too: not one code for colours is written."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        return [Segment(text, style and _bare(style), control) for text, style, control in segments]


NO_COLOURS = NoColours()
"""The one to add in `App.get_line_filters` for the theme `COLOURLESS`."""


@lru_cache(1024)
def _bare(style: Style) -> Style:
    bare = style.without_color
    return bare + Style.from_meta(style.meta) if style.meta else bare


def _theme(name: str, ink: Mapping[str, str], *, dark: bool, ansi: bool) -> Theme:
    return Theme(
        name,
        primary=ink["accent"],
        secondary=ink["accent"],
        accent=ink["accent"],
        warning=ink["warning"],
        error=ink["bad"],
        success=ink["good"],
        foreground=ink["foreground"],
        background=ink["background"],
        surface=ink["surface"],
        panel=ink["panel"],
        dark=dark,
        ansi=ansi,
        variables={
            "surface": ink["surface"],  # textual takes ansi ones for transparent
            "panel": ink["panel"],
            "panel-lighten-2": ink["focus"],
            "surface-active": ink["focus"],
            "ansi-background": ink["background"],
            "ansi-foreground": ink["foreground"],
            "text": ink["foreground"],
            "text-muted": ink["muted"],
            "text-disabled": ink["muted"],
            "foreground-muted": ink["muted"],
            "foreground-disabled": ink["muted"],
            "text-success": ink["good"],
            "text-warning": ink["warning"],
            "text-error": ink["bad"],
            "border": ink["accent"],
            "border-blurred": ink["muted"],
            "block-cursor-foreground": ink["background"],
            "block-cursor-background": ink["accent"],
            "block-cursor-text-style": "bold reverse" if name == COLOURLESS else "bold",
            "block-hover-background": ink["panel"],
            "input-cursor-foreground": ink["background"],
            "input-cursor-background": ink["foreground"],
            "input-cursor-text-style": "none",
            "input-selection-foreground": ink["background"],
            "input-selection-background": ink["accent"],
            "screen-selection-foreground": ink["background"],
            "screen-selection-background": ink["accent"],
            "scrollbar": ink["thumb"],
            "scrollbar-hover": ink["foreground"],
            "scrollbar-active": ink["foreground"],
            "scrollbar-background": ink["panel"],
            "scrollbar-background-hover": ink["panel"],
            "scrollbar-background-active": ink["panel"],
            "scrollbar-corner-color": ink["panel"],
        },
    )


def _all() -> Iterator[Theme]:
    for suffix, table in (("", _COLOURS), (_OF_16, _COLOURS_OF_16)):
        for column, name in enumerate(_COLUMNS):
            ink = {part: colours[column] for part, colours in table.items()}
            dark = name is not ThemeName.LIGHT
            yield _theme(f"{name}{suffix}", ink, dark=dark, ansi=bool(suffix))
    yield _theme(COLOURLESS, dict.fromkeys(_COLOURS, "ansi_default"), dark=True, ansi=True)


THEMES = tuple(_all())


# ASCII in place of signs that a terminal cannot show.


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
