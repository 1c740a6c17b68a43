"""Words that settings, files and screens share."""

from __future__ import annotations

from enum import StrEnum


class ThemeName(StrEnum):
    """How the screens look; what a terminal cannot show is brought down to what it can."""

    DARK = "dark"
    LIGHT = "light"
    HIGH_CONTRAST = "high-contrast"


class SourceKind(StrEnum):
    """Where the messages come from."""

    ROS = "ros"
    SIMULATED = "simulated"
    REPLAY = "replay"
