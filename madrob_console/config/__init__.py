"""The settings: one TOML file with everything about a testbed that is not code.

Its types hold the defaults, but for the protocol's own numbers, which are in scoring.
"""

from __future__ import annotations

from madrob_console.config.settings import (
    Settings,
    default_settings_path,
    load_settings,
    parse_settings,
)

__all__ = [
    "Settings",
    "default_settings_path",
    "load_settings",
    "parse_settings",
]
