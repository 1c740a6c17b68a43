"""The standings as lines of plain text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from madrob_console.report.explanations import PRACTICE_STANDINGS, task_text
from madrob_console.standings.competition import (
    NOTES,
    CompetitionStandings,
    RulesetStandings,
    statistic_text,
    statistics_of,
)
from madrob_console.standings.tally import Tally
from madrob_console.standings.web_page import counts, flag_words, run_words
from scoring.indicator_table import IndicatorName

_ACROSS = 8
"""Indicators beside each other; more of them follow below."""

_WIDTH = 8
"""Of their columns, characters."""


def standings_lines(found: CompetitionStandings) -> Iterator[str]:
    """The standings as a table of at most 80 characters in a line, names apart."""
    if not found.official:
        yield PRACTICE_STANDINGS
    yield f"MADROB standings {found.title}".rstrip()
    yield from found.remarks
    if len(found.competitions) > 1:
        yield "Take one of them by --competition NAME."
    yield found.basis
    if not found.groups:
        yield "No run counts yet."
    for group in found.groups:
        yield from _group_lines(group)
    if found.flagged:
        yield ""
        yield "Runs that count, with flags:"
    for run in found.flagged:
        yield f"  {run_words(run)}: {flag_words(run)}"
    if found.left_out:
        yield ""
        yield "Runs that do not count:"
    for run, why in found.left_out:
        yield f"  {run_words(run)}: {run.outcome_word}: {why}"
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


def _team_lines(tallies: Sequence[Tally]) -> Iterator[str]:
    """The teams with their runs, then a table for each statistic: teams below, indicators beside.

    A team's name may be long: the tables have its number.
    """
    for tally in tallies:
        yield f"{f'{tally.subject} {tally.team}'.rstrip()}: {', '.join(counts(tally))}"
    for first in range(0, len(IndicatorName), _ACROSS):
        names = list(IndicatorName)[first : first + _ACROSS]
        yield _columns("subject", (name.spec.title for name in names))
        yield _columns("", (name.spec.unit for name in names))
        yield _columns("better", (name.spec.better for name in names))
        for word in ("mean", "median", "std", "min", "max"):
            yield from _table(word, names, tallies)


def _table(word: str, names: Sequence[IndicatorName], tallies: Iterable[Tally]) -> Iterator[str]:
    """One statistic of all teams; nothing where no team has it."""
    rows = []
    for tally in tallies:
        found = [statistics_of(tally.aggregates.get(name), name).get(word) for name in names]
        if any(number is not None for number in found):
            cells = zip(names, found, strict=True)
            texts = (
                "-" if value is None else statistic_text(name, value, _WIDTH)
                for name, value in cells
            )
            rows.append(_columns(str(tally.subject), texts))
    if rows:
        yield word
        yield from rows


def _columns(name: str, cells: Iterable[str]) -> str:
    return f"{name:>7}" + "".join(f" {cell:>{_WIDTH}}" for cell in cells)
