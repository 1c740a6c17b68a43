"""`madrob doctor`: what is installed, found and missing."""

from __future__ import annotations

import argparse

from madrob_console.cli.arguments import (
    Commands,
    add_domain_option,
    add_settings_option,
    command,
    ros_domain,
)
from madrob_console.cli.problems import BAD_INPUT


def add(commands: Commands) -> None:
    """Its command line."""
    parser = command(commands, "doctor", main, "what is installed, found and missing")
    add_settings_option(parser)
    add_domain_option(parser)


def main(arguments: argparse.Namespace) -> int:
    """Print the findings as they come; exit code 0 if the console runs here."""
    from madrob_console.config import load_settings
    from madrob_console.preparing.doctor import doctor, line, usable, verdict

    settings = load_settings(arguments.settings)
    findings = []
    for finding in doctor(
        settings.mappings(),
        settings.results.root,
        domain=ros_domain(arguments, settings),
        disk_space=settings.checks.disk_space,
    ):
        findings.append(finding)
        print(line(finding), flush=True)
    print(verdict(findings))
    return 0 if usable(findings) else BAD_INPUT
