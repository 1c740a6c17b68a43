"""`madrob doctor`: what is installed, found and missing."""

from __future__ import annotations

import argparse

from madrob_console.cli import options
from madrob_console.cli.problems import BAD_INPUT


def add(commands: options.Commands) -> None:
    """Its command line."""
    parser = options.command(
        commands,
        "doctor",
        main,
        "what is installed, found and missing",
        examples=("madrob doctor", "madrob doctor --domain 41"),
    )
    options.add_teams(parser)
    options.add_settings(parser)
    options.add_domain(parser)


def main(arguments: argparse.Namespace) -> int:
    """Print the findings as they come; exit code 0 if the console runs here."""
    from madrob_console.config import load_settings
    from madrob_console.preparing.doctor import doctor, line, usable, verdict
    from madrob_console.preparing.doctor_lists import look_at_lists

    settings = load_settings(arguments.settings)
    teams = options.team_source(arguments, settings)
    findings = []
    for finding in doctor(
        settings.mappings(),
        settings.results.root,
        domain=options.ros_domain(arguments, settings),
        disk_space=settings.checks.disk_space,
        lists=lambda: look_at_lists(teams, settings.plan.source),
    ):
        findings.append(finding)
        print(line(finding), flush=True)
    print(verdict(findings))
    return 0 if usable(findings) else BAD_INPUT
