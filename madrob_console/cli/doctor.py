"""`madrob doctor`: what is installed, found and missing."""

from __future__ import annotations

import argparse

from madrob_console.cli.arguments_common import BAD_INPUT
from madrob_console.config import load_settings
from madrob_console.preparing.doctor import doctor, line, usable, verdict


def main(arguments: argparse.Namespace) -> int:
    """Print the findings as they come; exit code 0 if the console runs here."""
    settings = load_settings(arguments.settings)
    domain = arguments.domain if arguments.domain is not None else settings.testbed.domain
    findings = []
    for finding in doctor(
        settings.mappings(),
        settings.results.root,
        domain=domain,
        disk_space=settings.checks.disk_space,
    ):
        findings.append(finding)
        print(line(finding), flush=True)
    print(verdict(findings))
    return 0 if usable(findings) else BAD_INPUT
