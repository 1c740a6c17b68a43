"""Colours of the screens.

Each theme exists in full colours and, for terminals with 16 of them, in colours of the terminal's
own palette: brought down by arithmetic, a green may end as white and a grey on its background. The
full ones keep to what 256-colour terminals have or nearly have, as most do over SSH.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache

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
