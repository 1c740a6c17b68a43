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


class RemoteService(StrEnum):
    """What another program may ask of the engine over ROS, by the name of the service."""

    START = "start"
    ABORT = "abort"
    DECLARE_TIMEOUT = "declare_timeout"


class Scenario(StrEnum):
    """What a simulated robot does, by the name under which a user asks for it."""

    NOMINAL = "nominal"
    JERKY = "jerky"
    SLAM = "slam"
    SLOW = "slow"
    NO_TOUCH = "no-touch"
    TOUCH_ONLY = "touch-only"
    OPEN_ONLY = "open-only"
    NO_CLOSE = "no-close"
    TURNS_BACK = "turns-back"
    CLOSES_UNDER_SENSORS = "closes-under-sensors"
    BOUNCES = "bounces"
    RANDOM = "random"
