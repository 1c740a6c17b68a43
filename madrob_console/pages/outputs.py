"""Standings as text, and as one HTML page without scripts or outside files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from markupsafe import Markup
from rich.cells import set_cell_size

from madrob_console.common.formatting import counted
from madrob_console.common.names import terminal_safe
from madrob_console.pages.competition import (
    BY_BEST,
    CONDITION_NUMBERS,
    FLAG_SIGNS,
    LEADER_FIRST,
    NOTES,
    NUMBER_NOTES,
    SIGNS,
    CompetitionStandings,
    RulesetStandings,
    best_text,
    statistics_text,
)
from madrob_console.pages.notes import MANUAL_START_NOTE
from madrob_console.pages.tally import ALIKE, Overall, Standing, Tally, counts, subjects_text
from madrob_console.pages.templates import NONE, render, task_text
from madrob_console.referee.flags import serious
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import Condition
from scoring.result import uncertainty_text


def standings_html(competition: CompetitionStandings, software: str) -> str:
    return render("standings.html", found=competition, software=software, **MEANS)


def _tally_lines(tally: Tally) -> Iterator[str]:
    yield from counts(tally)
    if isinstance(tally, Overall):
        yield f"in {len(tally.conditions)} of {len(CONDITION_NUMBERS)} conditions"
    if tally.testbeds:
        yield f"on {', '.join(tally.testbeds)}"


def _means(tally: Tally) -> Iterator[tuple[str, bool, list[str]]]:
    """For each indicator its mean, whether there is one, and the lines below it."""
    for name in IndicatorName:
        aggregate = tally.aggregates.get(name)
        doubts, signs = tally.doubts.get(name, 0), tally.signs(name)
        below = [counted(doubts, "doubt")] if doubts else []
        if alike := tally.alike.get(name):
            below.append(f"{ALIKE} {subjects_text(alike)}")
        if aggregate is None:
            yield f"{NONE}{signs}", False, below
            continue
        statistics = statistics_text(aggregate, name)
        lines = [uncertainty_text(aggregate.uncertainty)] if aggregate.uncertainty else []
        lines += [f"{word} {text}" for word, text in statistics.items() if word != "mean"]
        if aggregate.count != tally.counted:
            lines.append(f"n = {aggregate.count}")
        yield f"{statistics['mean']}{signs}", True, [line for line in (*lines, *below) if line]


def _name(tally: Tally) -> Markup:
    return Markup("{} <bdi>{}</bdi>").format(tally.subject, terminal_safe(tally.team))


def flag_words(run: RunSummary) -> str:
    return "; ".join(flag.words for flag in serious(run.flags))


def run_words(run: RunSummary) -> str:
    """A run in words: `run 2 of subject 3 in condition 7, 21 Nov 14:28`."""
    of = f"run {run.run_number} of subject {run.subject} in condition {run.condition}"
    return f"{of}, {run.started_text}"


_BOLD = (
    "Bold: the mean. +-: its expanded uncertainty (95 in 100). n: how many runs have a value, "
    "where not all have."
)

NOTES_OF_PAGES = {
    "LEADER_FIRST": LEADER_FIRST,
    "SIGNS": SIGNS,
    "HOW_TO_READ": (
        _BOLD,
        *NUMBER_NOTES,
        MANUAL_START_NOTE,
    ),
}

MEANS: Mapping[str, Any] = {
    "who": _name,
    "means": _means,
    "tally_lines": _tally_lines,
    "counts": counts,
    "run_words": run_words,
    "flag_words": flag_words,
    "notes": NOTES_OF_PAGES,
    "mean_heads": [
        f"{name.words}{' *' if name.spec.with_the_start else ''}, {unit_text(name.spec.unit)}; "
        f"{name.spec.better} is better"
        for name in IndicatorName
    ],
}
"""What the tables of means need beside the standings."""

_ACROSS = 8
"""Indicators beside each other; more of them follow below."""

_WIDTH = 8
"""Of their columns, characters."""


def standings_lines(competition: CompetitionStandings) -> Iterator[str]:
    """Each condition as a table of its teams, the leader first; of `best` 1."""
    yield from _heading(competition, BY_BEST)
    for group in competition.groups:
        rules = f"; ruleset {group.ruleset}" if len(competition.groups) > 1 else ""
        for condition, standings in group.conditions.items():
            yield ""
            yield f"{_condition_words(condition)}{rules}"
            yield from _leader_lines(standings)
    if competition.groups:
        yield from ("", f"{FLAG_SIGNS}.", f"{SIGNS}.")
    going = sum(run.outcome is None and run.problem is None for run in competition.left_out)
    if going:
        yield f"Runs without a result yet: {going}."
    if not_counting := len(competition.left_out) - going:
        yield f"Runs that do not count: {not_counting}; --details gives the reasons."


def _heading(competition: CompetitionStandings, basis: str) -> Iterator[str]:
    if competition.banner:
        yield competition.banner
    yield f"MADROB standings {competition.title}".rstrip()
    yield from competition.remarks
    yield basis
    if not competition.groups:
        yield "No run counts yet."


def _condition_words(condition: Condition) -> str:
    return f"Condition {condition.number}, {condition.benchmark_type}: {task_text(condition)}"


def _leader_lines(standings: Sequence[Standing]) -> Iterator[str]:
    level, time = IndicatorName.CAPABILITY_LEVEL, IndicatorName.EXECUTION_TIME
    yield _leader_line("    team", "level", "exec s  ", "runs", "")
    for standing in standings:
        timed = f"{best_text(standing, time)}{standing.signs(time):<2}"
        runs = str(standing.completed + standing.timeout)
        who = f"{standing.subject:>3} {standing.team}"
        yield _leader_line(who, best_text(standing, level), timed, runs, standing.flag_sign)


def _leader_line(who: str, level: str, time: str, runs: str, sign: str) -> str:
    team = set_cell_size(terminal_safe(who), _TEAM)
    return f"  {team} {level:>5} {time:>12} {runs:>5}  {sign}".rstrip()


_TEAM = 40
"""Cells of a team with its number."""


def standings_details(competition: CompetitionStandings) -> Iterator[str]:
    """All statistics as tables of at most 80 characters in a line, names apart."""
    yield from _heading(competition, competition.basis)
    for group in competition.groups:
        yield from _group_lines(group)
    if competition.flagged:
        yield ""
        yield "Runs that count, with flags:"
    for run in competition.flagged:
        yield f"  {run_words(run)}: {flag_words(run)}"
    if competition.left_out:
        yield ""
        yield "Runs that do not count:"
    for run in competition.left_out:
        yield f"  {run_words(run)}: {run.outcome_word}: {run.why_left_out}"
    if competition.groups:
        yield ""
        yield from NOTES


def _group_lines(group: RulesetStandings) -> Iterator[str]:
    yield ""
    yield f"All conditions together, ruleset {group.ruleset}"
    yield from _team_lines(group.overall)
    for condition, standings in group.conditions.items():
        yield ""
        yield f"{_condition_words(condition)}; ruleset {group.ruleset}"
        yield from _team_lines(standings)


def _team_lines(tallies: Sequence[Tally]) -> Iterator[str]:
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
    rows = []
    for tally in tallies:
        texts = [text(tally, name) for name in names]
        if any(texts):
            rows.append(_columns(str(tally.subject), (cell or "-" for cell in texts)))
    if rows:
        yield word
        yield from rows


def _mean(most: int, tally: Tally, name: IndicatorName) -> str:
    """The signs are padded to `most` characters, so that digits are aligned."""
    aggregate, signs = tally.aggregates.get(name), tally.signs(name)
    if aggregate is None:
        return f"-{signs:<{most}}" if signs else ""
    return f"{statistics_text(aggregate, name, _WIDTH - most)['mean']}{signs:<{most}}"


def _spread(most: int, tally: Tally, name: IndicatorName) -> str:
    aggregate = tally.aggregates.get(name)
    uncertainty = uncertainty_text(aggregate.uncertainty) if aggregate else ""
    return f"{uncertainty.removeprefix('+- ')}{'':<{most}}" if uncertainty else ""


def _statistic(word: str, tally: Tally, name: IndicatorName) -> str:
    return statistics_text(tally.aggregates.get(name), name, _WIDTH).get(word, "")


def _columns(name: str, cells: Iterable[str]) -> str:
    return f"{name:>7}" + "".join(f" {cell:>{_WIDTH}}" for cell in cells)
