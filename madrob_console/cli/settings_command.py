"""`madrob settings`: the settings file, explained."""

from __future__ import annotations

import argparse

from madrob_console.cli.arguments import Commands, add_settings_option, command


def add(commands: Commands) -> None:
    """Its command line."""
    parser = command(
        commands, "settings", main, "check the settings file; print one with every default"
    )
    add_settings_option(parser)


def main(arguments: argparse.Namespace) -> int:
    """Check the settings file, if there is one, and print every setting with its default."""
    from madrob_console.config import load_settings
    from madrob_console.config.example import example_toml

    load_settings(arguments.settings)  # a file that is there has to be right
    print(example_toml())
    return 0
