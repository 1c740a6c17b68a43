"""What the commands take that work on recorded runs."""

from __future__ import annotations

import argparse
from pathlib import Path

from madrob_console.cli.arguments_common import Commands, add_settings_option, command
from madrob_console.report import PictureFormat
from scoring.rulesets import RulesetName

BOTH_RULESETS = "both"
"""For `madrob score`: every ruleset, side by side."""


def add_score(commands: Commands) -> None:
    """`madrob score`."""
    parser = command(
        commands,
        "score",
        "score recorded runs, or check their stored results",
        "PATH is a bag, a run folder, a folder of EUROBENCH csv files or a results folder. "
        "Exit code 2 when a run cannot be read; the rest is scored. With --check, 1 when a "
        "result differs.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    either = parser.add_mutually_exclusive_group()
    either.add_argument(
        "--ruleset",
        choices=[*map(str, RulesetName), BOTH_RULESETS],
        default=None,
        help="the rules, or both side by side; those of the run if not given",
    )
    either.add_argument(
        "--check",
        action="store_true",
        help="compare each run's result.json with what its recording gives, to the last digit",
    )
    parser.add_argument("--json", action="store_true", help="JSON for programs")
    parser.add_argument(
        "--jobs",
        type=_job_count,
        default=None,
        metavar="N",
        help="runs scored at once; as many as there are cores if not given",
    )
    parser.add_argument(
        "--backend",
        default=None,
        metavar="NAME",
        help="joblib's backend for the jobs: loky (processes here) if not given",
    )


def _job_count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: give 1 or more")
    return int(text)


def add_report(commands: Commands) -> None:
    """`madrob report`."""
    parser = command(
        commands,
        "report",
        "a page for the team: report.html in the run folder, or the figures alone",
        "PATH is a run folder, a results folder or a bag; of EUROBENCH folders the figures only.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    parser.add_argument(
        "--figures",
        type=PictureFormat,
        choices=list(PictureFormat),
        default=None,
        help="figures of this format instead of the page",
    )
    parser.add_argument(
        "--output", type=Path, default=None, help="folder for all pages, <run>_report.html each"
    )


def add_standings(commands: Commands) -> None:
    """`madrob standings`."""
    parser = command(
        commands,
        "standings",
        "all teams, in each condition and in all: a table, csv, json, html",
        "Mean, median and standard deviation over the valid runs; invalid and interrupted ones are "
        "listed with their reasons. Exit code 2 when a result is damaged; the rest is there.",
    )
    for kind, text in (
        ("csv", "a row for each team, condition and indicator"),
        ("json", "everything, with units and reasons"),
        ("html", "a page for phone and paper"),
    ):
        parser.add_argument(
            f"--{kind}",
            type=Path,
            default=None,
            metavar="FILE",
            help=f"{text}; - = standard output",
        )
    parser.add_argument(
        "--best",
        type=int,
        default=None,
        metavar="N",
        help="only the N best runs of each team in each condition; 0 = all; else the settings'",
    )
    parser.add_argument("--competition", default=None, metavar="NAME", help="only its runs")
    parser.add_argument(
        "--practice", action="store_true", help="the simulated runs instead, marked as such"
    )
    parser.add_argument("--results", type=Path, default=None, help="results folder")
    add_settings_option(parser)


def add_export(commands: Commands) -> None:
    """`madrob export`."""
    parser = command(
        commands,
        "export",
        "all runs of a team in one zip, with checksums and what opens each file",
        "The last line is the path of the zip. Exit code 2 when something could not be packed: it "
        "is named, the rest is there.",
    )
    parser.add_argument("--team", type=int, required=True, help="the team's number (subject)")
    parser.add_argument("--results", type=Path, default=None, help="results folder")
    parser.add_argument(
        "--output",
        type=Path,
        default=None,
        metavar="FILE.zip",
        help="the zip; in the folder `exports` of the results folder if not given",
    )
    parser.add_argument(
        "--without-bags", action="store_true", help="leave out the recordings, the largest files"
    )
    add_settings_option(parser)


def add_schema(commands: Commands) -> None:
    """`madrob schema`."""
    command(commands, "schema", "the JSON schema of result.json")


def add_recover(commands: Commands) -> None:
    """`madrob recover`."""
    parser = command(
        commands,
        "recover",
        "repair recordings that were cut off",
        "Writes a whole bag beside the torn one, which is kept. PATH is a run folder or a bag.",
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
