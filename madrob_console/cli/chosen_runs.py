"""The runs that a command line chooses by its options, or names."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.cli.command_line import Argument
from madrob_console.cli.option_values import results_folder, settings_of
from madrob_console.cli.output import complain
from madrob_console.cli.parsing import whole_within
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind

if TYPE_CHECKING:
    from madrob_console.archive.collection import Collection
    from madrob_console.config import Settings
    from madrob_console.pages.competition import CompetitionStandings


WHICH_RUNS = (
    Argument(
        "--best",
        type=whole_within(0),
        metavar="N",
        help="only the N best runs of each team in each condition, 0 = all; else setting "
        "`competition.best_runs`",
    ),
    options.PRACTICE,
)


def standings(
    arguments: argparse.Namespace,
    settings: Settings,
    collection: Collection,
    teams: Mapping[int, str],
) -> CompetitionStandings:
    from madrob_console.pages.competition import competition_standings

    chosen: int | None = arguments.best
    best = settings.competition.best_runs if chosen is None else chosen
    return competition_standings(
        collection.runs,
        made=time.time(),
        competition=arguments.competition,
        official=not arguments.practice,
        best=best,
        listed=teams,
    )


def name_practice_alone(published: CompetitionStandings, collection: Collection) -> None:
    """Print a note where official runs were asked for and there is practice only."""
    practice = sum(run.practice for run in collection.runs)
    if published.official and practice and not any(run.official for run in collection.runs):
        complain(f"note: no official run, {practice} of practice: --practice shows them")


def demand_results(arguments: argparse.Namespace, settings: Settings) -> None:
    results = results_folder(arguments, settings)
    if not arguments.paths and not results.is_dir():
        raise MadrobError(f"{results}: no such results folder; name one with --results")


def named_places(arguments: argparse.Namespace, settings: Settings) -> list[str]:
    where = [f"--results={results_folder(arguments, settings)}"]
    if arguments.settings is not None:
        where.append(f"--settings={arguments.settings}")
    if arguments.teams is not None:
        where.append(f"--teams={arguments.teams}")
    return where


def site_arguments(arguments: argparse.Namespace, settings: Settings) -> list[str]:
    """Arguments of `madrob publish` after each result; empty where it is not wanted."""
    if not settings.results.publish:
        return []
    more = [] if arguments.plan is None else [f"--plan={arguments.plan}"]
    site = Path(settings.results.publish).expanduser()
    of = f"--competition={settings.competition.name}"
    return [str(site), *named_places(arguments, settings), *more, of]


_ONE = ("run", "rest", "weight")
"""Arguments that take one run or recording; `paths` takes any number, `testbed` one to replay."""


def find_runs(arguments: argparse.Namespace) -> None:
    """Replace the names of runs by their paths in all arguments that take runs."""
    for name in _ONE:
        if isinstance(named := getattr(arguments, name, None), Path):
            setattr(arguments, name, _run_folder(named, arguments))
    if paths := getattr(arguments, "paths", None):
        arguments.paths = [_run_folder(path, arguments) for path in paths]
    testbed: list[str] = getattr(arguments, "testbed", None) or []
    if testbed[:1] == [SourceKind.REPLAY]:
        arguments.testbed = [testbed[0], str(_run_folder(Path(testbed[1]), arguments))]


def _run_folder(name: Path, arguments: argparse.Namespace) -> Path:
    """An existing path, or one that is no run name, is returned unchanged."""
    from madrob_console.archive.folders import PRACTICE_FOLDER, parse_folder_name

    name = name.expanduser()
    if parse_folder_name(str(name)) is None or name.exists():
        return name

    settings = settings_of(arguments)
    results = results_folder(arguments, settings)
    official, practice = results / name, results / PRACTICE_FOLDER / name
    if official.exists() and practice.exists():
        raise MadrobError(f"{name}: two runs are called so: give {official} or {practice}")
    return practice if practice.exists() else official
