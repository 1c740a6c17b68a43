"""`madrob doctor`: what is installed, found and missing."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.cli.output import BAD_INPUT, progress

if TYPE_CHECKING:
    from madrob_console.cli.doctor_ros import Finding
    from madrob_console.config import Settings

OFF = 1
"""Exit code of `--reference` if a value is not as it must be."""


def add_command(commands: options.Commands) -> None:
    parser = options.command(
        commands,
        "doctor",
        main,
        "what is installed, found and missing",
        "With --reference, recordings with known answers are scored instead, and exit code 1 says "
        "that a value is off. It needs neither ROS nor a testbed.",
        examples=(
            "madrob doctor",
            "madrob doctor --domain 41",
            "madrob doctor --reference    # does this installation score right?",
        ),
    )
    parser.add_argument(
        "--reference",
        action="store_true",
        help="score the recordings with known answers that came with the program",
    )
    options.add_teams(parser)
    options.add_settings(parser)
    options.add_domain(parser)


def main(arguments: argparse.Namespace) -> int:
    """Print the findings as they come; exit code 0 if the console runs here, or scores right."""
    if arguments.reference:
        return _score_references()
    from madrob_console.cli.doctor import doctor, line, look_at_lists, usable, verdict
    from madrob_console.config import load_settings

    settings = load_settings(arguments.settings)
    teams = options.team_source(arguments, settings)
    findings = []
    for finding in doctor(
        settings.mappings(),
        settings.results.root,
        domain=options.ros_domain(arguments, settings),
        disk_space=settings.checks.disk_space,
        abort=settings.ros.abort,
        lists=lambda: look_at_lists(teams, settings.plan.source),
        evidence=lambda: _evidence(arguments, settings),
    ):
        findings.append(finding)
        print(line(finding), flush=True)
    print(verdict(findings))
    return 0 if usable(findings) else BAD_INPUT


def _evidence(arguments: argparse.Namespace, settings: Settings) -> Iterator[Finding]:
    import os

    from madrob_console.cli.doctor import look_at_evidence
    from madrob_console.cli.session import own_topics
    from madrob_console.messages.message_types import MessageTypes

    recording = settings.recording
    own = own_topics(settings, MessageTypes())
    domain = options.ros_domain(arguments, settings)
    return look_at_evidence(recording.choice, own, domain, recording.budget_bytes, os.environ)


def _score_references() -> int:
    from madrob_console.cli.doctor import line
    from madrob_console.cli.reference_set import (
        FOLDER,
        read_references,
        reference_findings,
        reference_verdict,
        score_references,
        versions,
    )

    print(line(versions()), flush=True)
    references = read_references(FOLDER)
    scores = []
    with progress("references") as tell:
        tell(0, len(references))
        for score in score_references(references, FOLDER):
            scores.append(score)
            tell(len(scores), len(references))
            for finding in reference_findings(score):
                print(line(finding), flush=True)
    print(reference_verdict(scores))
    return OFF if any(score.off for score in scores) else 0
