"""`madrob doctor`: what is installed, found and missing."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from madrob_console.cli import option_values, options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.output import BAD_INPUT
from madrob_console.cli.progress import progress
from madrob_console.cli.safe_stream import print_json

if TYPE_CHECKING:
    from madrob_console.cli.finding import Finding
    from madrob_console.config import Settings

OFF = 1
"""Exit code of `--reference` if a value is off."""


@command(
    "doctor",
    "what is installed, found and missing",
    "With --reference, recordings with known answers are scored instead, and exit code 1 says that "
    "a value is off. That needs neither ROS nor a testbed.",
    options=(
        Argument(
            "--reference",
            action="store_true",
            help="score the recordings with known answers that came with the program",
        ),
        options.JSON,
        options.TEAMS,
        options.PLAN,
        *options.RESULTS,
        options.SETTINGS,
        options.DOMAIN,
    ),
    examples=(
        "madrob doctor",
        "madrob doctor --domain 41",
        "madrob doctor --reference    # does this installation score right?",
    ),
)
def doctor(arguments: argparse.Namespace) -> int:
    """Print the findings as they come; exit code 0 if the console runs here, or scores right."""
    from madrob_console.cli.finding import line

    found: list[Finding] = []

    def tell(finding: Finding) -> None:
        found.append(finding)
        if not arguments.json:
            print(line(finding), flush=True)

    look = _score_references if arguments.reference else _look
    verdict, code = look(arguments, tell)
    if arguments.json:
        findings = [
            {
                "severity": one.severity.name.lower(),
                "subject": one.subject,
                "text": one.text,
            }
            for one in found
        ]
        print_json({"passed": code == 0, "verdict": verdict, "findings": findings})
    else:
        print(verdict)
    return code


def _look(arguments: argparse.Namespace, tell: Callable[[Finding], None]) -> tuple[str, int]:
    from madrob_console.cli.doctor import doctor, look_at_lists, usable, verdict

    settings = option_values.settings_of(arguments)
    teams = option_values.team_source(arguments, settings)
    plan = option_values.plan_source(arguments, settings)
    findings = []
    for finding in doctor(
        settings.mappings(),
        option_values.results_folder(arguments, settings),
        domain=option_values.ros_domain(arguments, settings),
        disk_space=settings.checks.disk_space,
        lists=lambda: look_at_lists(teams, plan, settings.run.timeout),
        evidence=lambda: _evidence(arguments, settings),
    ):
        findings.append(finding)
        tell(finding)
    return verdict(findings), 0 if usable(findings) else BAD_INPUT


def _evidence(arguments: argparse.Namespace, settings: Settings) -> Iterator[Finding]:
    import os

    from madrob_console.cli.doctor_evidence import look_at_evidence

    domain = option_values.ros_domain(arguments, settings)
    return look_at_evidence(settings.evidence.topics, domain, os.environ)


def _score_references(
    _arguments: argparse.Namespace, tell: Callable[[Finding], None]
) -> tuple[str, int]:
    from madrob_console.cli.reference_set import (
        FOLDER,
        read_references,
        reference_findings,
        reference_verdict,
        score_references,
        versions,
    )

    tell(versions())
    references = read_references(FOLDER)
    scores = []
    with progress("references") as count:
        count(0, len(references))
        for score in score_references(references, FOLDER):
            scores.append(score)
            count(len(scores), len(references))
            for finding in reference_findings(score):
                tell(finding)
    return reference_verdict(scores), OFF if any(score.off for score in scores) else 0
