"""`madrob settings`: the settings file, explained."""

from __future__ import annotations

import argparse

from madrob_console.config import load_settings
from madrob_console.config.example import example_toml


def main(arguments: argparse.Namespace) -> int:
    """Check the settings file, if there is one, and print every setting with its default."""
    load_settings(arguments.settings)  # a file that is there has to be right
    print(example_toml())
    return 0
