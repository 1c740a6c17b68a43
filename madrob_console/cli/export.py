"""`madrob export`: a team's runs in one zip."""

from __future__ import annotations

import argparse
import sys
import time

from madrob_console.cli.arguments_common import BAD_INPUT
from madrob_console.cli.attaching import results_folder
from madrob_console.config import load_settings
from madrob_console.export.pack import export_team
from madrob_console.names import terminal_safe


def main(arguments: argparse.Namespace) -> int:
    """Make the zip; what could not be packed is named. The last line is the path of the zip."""
    settings = load_settings(arguments.settings)
    export = export_team(
        results_folder(arguments, settings),
        arguments.team,
        settings.mappings(),
        time.time(),
        target=arguments.output,
        bags=not arguments.without_bags,
    )
    for problem in export.problems:
        print(f"madrob: {terminal_safe(problem)}", file=sys.stderr)
    plural = "" if export.runs == 1 else "s"
    print(f"{export.runs} run{plural}, {export.files} files, {export.size / 1e6:.1f} MB")
    print(terminal_safe(str(export.path)))
    return BAD_INPUT if export.problems else 0
