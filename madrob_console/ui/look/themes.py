"""Colours of the screens.

They keep to what 256-colour terminals have or nearly have, as most do over SSH.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from textual.theme import Theme

from madrob_console.common.names import ThemeName

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


def _theme(name: str, ink: Mapping[str, str], *, dark: bool) -> Theme:
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
        variables={
            "panel-lighten-2": ink["focus"],
            "surface-active": ink["focus"],
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
            "block-cursor-text-style": "bold",
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
    for column, name in enumerate(_COLUMNS):
        ink = {part: colours[column] for part, colours in _COLOURS.items()}
        yield _theme(name, ink, dark=name is not ThemeName.LIGHT)


THEMES = tuple(_all())
