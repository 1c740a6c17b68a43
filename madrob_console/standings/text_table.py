"""The standings as lines of plain text."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

from madrob_console.report.explanations import PRACTICE_STANDINGS, task_text
from madrob_console.standings.competition import (
    NOTES,
    CompetitionStandings,
    RulesetStandings,
    statistics_text,
)
from madrob_console.standings.tally import Tally
from madrob_console.standings.web_page import counts, flag_words, run_words
from scoring.indicator_table import IndicatorName
from scoring.result import uncertainty_text

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
        where = f"; on {', '.join(tally.testbeds)}" if tally.testbeds else ""
        yield f"{f'{tally.subject} {tally.team}'.rstrip()}: {', '.join(counts(tally))}{where}"
    for first in range(0, len(IndicatorName), _ACROSS):
        names = list(IndicatorName)[first : first + _ACROSS]
        yield _columns("subject", (name.spec.title for name in names))
        yield _columns("", (name.spec.unit for name in names))
        yield _columns("better", (name.spec.better for name in names))
        signs = max((len(each.signs(name)) for each in tallies for name in names), default=0)
        yield from _table("mean", names, tallies, partial(_mean, signs))
        yield from _table("+-", names, tallies, partial(_spread, signs))
        for word in ("median", "std", "min", "max"):
            yield from _table(word, names, tallies, partial(_statistic, word))


def _table(
    word: str,
    names: Sequence[IndicatorName],
    tallies: Iterable[Tally],
    text: Callable[[Tally, IndicatorName], str],
) -> Iterator[str]:
    """One statistic of all teams; nothing where no team has it."""
    rows = []
    for tally in tallies:
        texts = [text(tally, name) for name in names]
        if any(texts):
            rows.append(_columns(str(tally.subject), (cell or "-" for cell in texts)))
    if rows:
        yield word
        yield from rows


def _mean(most: int, tally: Tally, name: IndicatorName) -> str:
    """With the signs behind it, in the room of the `most` that a mean has: digits are aligned."""
    aggregate, signs = tally.aggregates.get(name), tally.signs(name)
    if aggregate is None:
        return f"-{signs:<{most}}" if signs else ""
    return f"{statistics_text(aggregate, name, _WIDTH - most)['mean']}{signs:<{most}}"


def _spread(most: int, tally: Tally, name: IndicatorName) -> str:
    """The expanded uncertainty of the mean."""
    aggregate = tally.aggregates.get(name)
    known = uncertainty_text(aggregate.uncertainty) if aggregate else ""
    return f"{known.removeprefix('+- ')}{'':<{most}}" if known else ""


def _statistic(word: str, tally: Tally, name: IndicatorName) -> str:
    return statistics_text(tally.aggregates.get(name), name, _WIDTH).get(word, "")


def _columns(name: str, cells: Iterable[str]) -> str:
    return f"{name:>7}" + "".join(f" {cell:>{_WIDTH}}" for cell in cells)
