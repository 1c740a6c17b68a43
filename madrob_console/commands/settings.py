"""`madrob settings`: the settings file, explained."""

from __future__ import annotations

import argparse

from madrob_console.config import example_toml


def main(arguments: argparse.Namespace) -> int:
    """Print every setting with its default."""
    print(example_toml())
    return 0
