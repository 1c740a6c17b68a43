"""The standings as lines of plain text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from madrob_console.kinds import SourceKind
from madrob_console.report.explanations import UNOFFICIAL, task_text
from madrob_console.standings.competition import (
    NOTES,
    CompetitionStandings,
    RulesetStandings,
    statistics_of,
)
from madrob_console.standings.tally import Tally
from madrob_console.standings.web_page import counts, run_words
from scoring.indicator_table import IndicatorName

_ACROSS = 8
"""Indicators beside each other; more of them follow below."""


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


def _team_lines(tallies: tuple[Tally, ...]) -> Iterator[str]:
    names = list(IndicatorName)
    for first in range(0, len(names), _ACROSS):
        yield from _lines_of(names[first : first + _ACROSS], tallies)


def _lines_of(names: Sequence[IndicatorName], tallies: Iterable[Tally]) -> Iterator[str]:
    yield _columns("", (name.spec.title for name in names))
    yield _columns("", (name.spec.unit for name in names))
    for tally in tallies:
        yield f"{tally.subject} {tally.team}: {', '.join(counts(tally))}"
        rows = {name: statistics_of(tally.aggregates.get(name), name) for name in names}
        for word in ("mean", "median", "std", "min", "max"):
            numbers = [rows[name].get(word) for name in names]
            if any(number is not None for number in numbers):
                yield _columns(word, ("-" if n is None else f"{n:.4g}" for n in numbers))


def _columns(name: str, cells: Iterable[str]) -> str:
    return f"{name:>7}" + "".join(f" {cell:>8}" for cell in cells)
