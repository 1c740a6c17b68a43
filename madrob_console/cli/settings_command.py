"""`madrob settings`: the settings file, explained."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from madrob_console.cli import options
from madrob_console.cli.command_line import command
from madrob_console.common.names import terminal_safe


@command(
    "settings",
    "check the settings file; print one with every default",
    "Which file was read, and that it is fine, stands on the error output.",
    options=(options.SETTINGS,),
    examples=(
        "madrob settings",
        "madrob settings > madrob.toml",
        "madrob settings --settings my.toml",
    ),
)
def settings(arguments: argparse.Namespace) -> int:
    from madrob_console.config import default_settings_path, load_settings
    from madrob_console.config.settings_example import example_toml

    load_settings(arguments.settings).mappings()  # a file that is there has to be right
    print(example_toml(), flush=True)
    file: Path = arguments.settings or default_settings_path()
    state = (
        f"{file}: read, it is fine" if file.exists() else f"{file}: not there, the defaults hold"
    )
    print(terminal_safe(state), file=sys.stderr)
    return 0
