"""`madrob settings`: the settings file, explained."""

from __future__ import annotations

import argparse

from madrob_console.cli import options


def add(commands: options.Commands) -> None:
    """Its command line."""
    parser = options.command(
        commands, "settings", main, "check the settings file; print one with every default"
    )
    options.add_settings(parser)


def main(arguments: argparse.Namespace) -> int:
    """Check the settings file, if there is one, and print every setting with its default."""
    from madrob_console.config import load_settings
    from madrob_console.config.example import example_toml

    load_settings(arguments.settings)  # a file that is there has to be right
    print(example_toml())
    return 0
