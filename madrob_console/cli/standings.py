"""`madrob standings`: all teams, for people, spreadsheets and programs."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from madrob_console.archive.history import History
from madrob_console.cli.arguments_common import BAD_INPUT
from madrob_console.config import load_settings
from madrob_console.errors import MadrobError
from madrob_console.files.whole import atomic_write
from madrob_console.kinds import SourceKind
from madrob_console.names import terminal_safe
from madrob_console.report.explanations import UNOFFICIAL, task_text
from madrob_console.standings.competition import (
    NOTES,
    CompetitionStandings,
    RulesetStandings,
    competition_standings,
    figures,
)
from madrob_console.standings.data_files import standings_csv, standings_json
from madrob_console.standings.tally import Tally
from madrob_console.standings.web_page import counts, standings_html, which
from madrob_console.version import software_version
from scoring.indicator_table import IndicatorName

_STDOUT = Path("-")


def main(arguments: argparse.Namespace) -> int:
    """Write the files that were asked for, or print a table; damaged results are named."""
    makers: dict[str, Callable[[CompetitionStandings], bytes]] = {
        "csv": lambda found: standings_csv(found).encode(),
        "json": lambda found: standings_json(found, software_version()),
        "html": lambda found: standings_html(found, software_version()).encode(),
    }
    targets = {kind: path for kind in makers if (path := getattr(arguments, kind)) is not None}
    _refuse_sharing(targets)
    told = sys.stderr if _STDOUT in targets.values() else sys.stdout
    found = _found(arguments)
    for kind, path in targets.items():
        data = makers[kind](found)
        if path == _STDOUT:
            sys.stdout.buffer.write(data)
            sys.stdout.flush()
        else:
            atomic_write(path, data)
            print(terminal_safe(str(path)), file=told)
    if not targets:
        for line in standings_lines(found):
            print(terminal_safe(line))
    damaged = [run for run, _ in found.left_out if run.problem is not None]
    for run in damaged:
        print(f"madrob: {terminal_safe(f'{run.folder}: {run.problem}')}", file=sys.stderr)
    return BAD_INPUT if damaged else 0


def standings_lines(found: CompetitionStandings) -> Iterator[str]:
    """The standings as a table of at most 80 characters in a line, names apart."""
    if not found.official:
        yield UNOFFICIAL[SourceKind.SIMULATED]
    yield f"MADROB standings {found.title}".rstrip()
    yield from found.remarks
    if len(found.competitions) > 1:
        yield "Take one of them by --competition NAME."
    yield found.basis
    if not found.groups:
        yield "No run counts yet."
    for group in found.groups:
        yield from _group_lines(group)
    if found.left_out:
        yield ""
        yield "Runs that do not count:"
    for run, why in found.left_out:
        yield f"  {which(run)}: {run.outcome_word}: {why}"
    if found.groups:
        yield ""
        yield from NOTES


def _group_lines(group: RulesetStandings) -> Iterator[str]:
    yield ""
    yield f"All conditions together, ruleset {group.ruleset}"
    yield from _team_lines(group.overall)
    for condition, standings in group.conditions.items():
        yield ""
        task = f"{condition.benchmark_type}: {task_text(condition)}"
        yield f"Condition {condition.number}, {task}; ruleset {group.ruleset}"
        yield from _team_lines(standings)


def _team_lines(tallies: tuple[Tally, ...]) -> Iterator[str]:
    yield _columns("", (name.spec.title for name in IndicatorName))
    yield _columns("", (name.spec.unit for name in IndicatorName))
    for tally in tallies:
        yield f"{tally.subject} {tally.team}: {', '.join(counts(tally))}"
        rows = {name: figures(tally.aggregates.get(name), name) for name in IndicatorName}
        for word in ("mean", "median", "std", "min", "max"):
            numbers = [rows[name].get(word) for name in IndicatorName]
            if any(number is not None for number in numbers):
                yield _columns(word, ("-" if n is None else f"{n:.4g}" for n in numbers))


def _columns(name: str, cells: Iterable[str]) -> str:
    return f"{name:>7}" + "".join(f" {cell:>8}" for cell in cells)


def _found(arguments: argparse.Namespace) -> CompetitionStandings:
    settings = load_settings(arguments.settings)
    best = settings.competition.best_runs if arguments.best is None else arguments.best
    if best < 0:
        raise MadrobError(f"--best {best}: use 1 or more, or 0 for all runs")
    results = (arguments.results or settings.results.root).expanduser()
    if not results.is_dir():
        raise MadrobError(f"{results}: no such results folder; name one with --results")
    return competition_standings(
        History(results).refresh(),
        made=time.time(),
        competition=arguments.competition,
        official=not arguments.practice,
        best=best,
    )


def _refuse_sharing(targets: dict[str, Path]) -> None:
    """Two kinds in one file would leave only the last."""
    paths = [path if path == _STDOUT else path.absolute() for path in targets.values()]
    for path in paths:
        if paths.count(path) > 1:
            raise MadrobError(f"{path}: give each kind of file a path of its own")
