"""The themes that a referee can choose, known to the settings and to the screens."""

from __future__ import annotations

from enum import StrEnum


class ThemeName(StrEnum):
    """How the screens look; what a terminal cannot show is brought down to what it can."""

    DARK = "dark"
    LIGHT = "light"
    HIGH_CONTRAST = "high-contrast"
