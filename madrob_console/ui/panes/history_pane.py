"""The history pane: all runs, filtered and sorted, open to be looked at again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter

from msgspec.structs import replace

from madrob_console.archive.collection import filter_problem, matches
from madrob_console.common.formatting import counted
from madrob_console.common.names import SourceKind
from madrob_console.referee.flags import serious, undecided
from madrob_console.referee.run_summary import PROTEST_OPEN, RunSummary, condition_words
from madrob_console.ui.cells.columns import Column
from madrob_console.ui.cells.lines import Span, Tone
from madrob_console.ui.cells.table import Table
from madrob_console.ui.look.words import shortened
from madrob_console.ui.panes.list_columns import (
    MISSING,
    indicator_column,
    number_column,
    text_column,
)
from madrob_console.ui.panes.list_pane import LIST_KEYS, Load, RunsPane
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome

_OUTCOME_TONES = {
    Outcome.COMPLETED: Tone.GOOD,
    Outcome.TIMEOUT: Tone.PLAIN,
    Outcome.ABORTED: Tone.BAD,
    Outcome.INTERRUPTED: Tone.BAD,
    None: Tone.WARN,
}
_SOURCES: Mapping[str, Span] = {
    SourceKind.ROS: Span("ros"),
    SourceKind.SIMULATED: Span("SIM", Tone.NOTICE),
    SourceKind.REPLAY: Span("rep", Tone.WARN),
}
_CLOSING_TONES = {
    "not final": Tone.DIM,
    "final": Tone.PLAIN,
    "protested": Tone.WARN,
    PROTEST_OPEN: Tone.BAD,
}
_OUTCOME = 13
"""Cells of the outcome with its signs; `completed *!!` has so many."""

LEGEND = "!! decide  ! scored otherwise  P protest  * not final"


def columns(name: Callable[[RunSummary], str] = attrgetter("team")) -> list[Column[RunSummary]]:
    """Every column, the most important first; `name` gives the current name of a run's team."""
    indicators = {name: indicator_column(name) for name in IndicatorName}
    first = [
        indicators.pop(IndicatorName.CAPABILITY_LEVEL),
        indicators.pop(IndicatorName.EXECUTION_TIME),
        indicators.pop(IndicatorName.TIME_TO_HANDLE),
    ]
    return [
        Column(
            "started", "start", lambda r: Span(r.started_text), lambda r: r.started, 12,
            falling=True,
        ),
        number_column("subj", "subject", lambda r: r.subject, 4),
        text_column("team", "team", name, 14, ample=30),
        number_column("run", "run number", lambda r: r.run_number, 4),
        number_column("cond", "condition", lambda r: r.condition, 5),
        Column("outcome", "outcome", _outcome, lambda r: r.outcome_word.casefold(), _OUTCOME),
        Column("src", "source", _source, lambda r: r.source, 3),
        *first,
        text_column("task", "task", lambda r: condition_words(r.condition).way, 20),
        *indicators.values(),
        text_column("door", "benchmark type", lambda r: condition_words(r.condition).door, 14),
        number_column("vers", "version of the result", lambda r: r.issue or None, 6),
        Column("result", "whether the result is final", _closing, lambda r: r.closing, 9),
        text_column("ruleset", "ruleset", lambda r: r.ruleset, 14),
        text_column("testbed", "testbed", lambda r: r.testbed, 12),
    ]  # fmt: skip


def _outcome(run: RunSummary) -> Span:
    """The word with its signs (`LEGEND`); what counts nowhere has no score to be changed."""
    counts = run.outcome is not Outcome.ABORTED and not run.voided
    sign = "*" if run.issue and not run.final and counts else ""
    tone = Tone.BAD if run.problem else _OUTCOME_TONES[run.outcome]
    if run.protest_filed is not None:
        sign, tone = "P", Tone.BAD
    elif undecided(run.flags):
        sign, tone = f"{sign}!!", Tone.BAD
    elif run.valid and serious(run.flags):
        sign, tone = f"{sign}!", Tone.WARN
    word = shortened(run.outcome_word, _OUTCOME - 1 - len(sign))
    return Span(f"{word} {sign}".rstrip(), tone)


def _source(run: RunSummary) -> Span:
    practice = run.practice and run.source == SourceKind.ROS
    return Span("PRA", Tone.NOTICE) if practice else _SOURCES.get(run.source or "", MISSING)


def _closing(run: RunSummary) -> Span:
    return Span(run.closing, _CLOSING_TONES[run.closing]) if run.issue else MISSING


EXAMPLES = "delft, cond:7, official, not final, undecided, 14 Nov; Enter: to the list"


class HistoryPane(RunsPane[Sequence[RunSummary], RunSummary]):
    """Newest first. Teams of the competition are called as in the list."""

    def __init__(self, load: Load) -> None:
        cells = columns(self._called)
        table = Table(cells, lambda run: run.folder, fixed=5, passes=self._passes)
        table.legend, table.empty = LEGEND, "no runs yet"
        super().__init__(load, table, (), "history", EXAMPLES)
        self.keys.say(f"Enter opens its menu, {LIST_KEYS}", Tone.DIM)

    def narrow(self, text: str) -> None:
        self.table.narrow(text, filter_problem(text) or "no run passes the filter")

    def _called(self, run: RunSummary) -> str:
        """The team as listed; as recorded for other competitions and teams that are not listed."""
        listed = self.teams.get(run.subject, "") if run.competition == self.competition else ""
        return listed or run.team

    def prepare(self, runs: Sequence[RunSummary]) -> Sequence[RunSummary]:
        return runs[::-1]

    def words_about(self, row: RunSummary) -> tuple[str, Tone]:
        odd = row.problem is not None or row.outcome is None or undecided(row.flags)
        return about(row, self._called(row)), Tone.WARN if odd else Tone.DIM

    def _passes(self, run: RunSummary, text: str) -> bool:
        """Under either of its team's names."""
        if matches(run, text):
            return True
        name = self._called(run)
        return name != run.team and matches(replace(run, team=name), text)

    def show_rows(self, *, from_top: bool = True) -> None:
        self.table.set_rows(self.content, from_top=from_top)
        self.say(summary(self.content))


def summary(runs: Sequence[RunSummary]) -> str:
    if not runs:
        return "no runs in the results folder"
    words = Counter("valid" if run.valid else run.outcome_word for run in runs)
    practice = sum(run.practice for run in runs)
    protests = sum(run.protest_filed is not None for run in runs)
    among = f" ({practice} PRACTICE)" if practice else ""
    parts = [f"{count} {word}" for word, count in words.most_common()]
    parts += [protests_open(protests)] if protests else []
    return f"{counted(len(runs), 'run')}{among}: {', '.join(parts)}"


def protests_open(count: int) -> str:
    return f"{count} PROTEST{'S' if count > 1 else ''} open"


def about(run: RunSummary, name: str | None = None) -> str:
    """One run in words, first what must be decided; `name` None = the team's as recorded."""
    if run.problem is not None:
        return f"{run.problem} (folder {run.folder})"
    if run.twin:
        return run.why_twin
    waiting = undecided(run.flags)
    name = run.team if name is None else name
    recorded = f" (recorded as {run.team})" if run.team and run.team != name else ""
    task = ", ".join(filter(None, condition_words(run.condition)))
    task = task or f"condition {run.condition} does not exist"
    version = f"{'PRACTICE, ' if run.practice else ''}version {run.issue}"
    ended = (version, run.closing, run.ruleset)
    facts = (
        *(flag.words for flag in waiting),
        *(flag.words for flag in serious(run.flags) if flag not in waiting),
        f"{name}{recorded}: {task}" if name else task,
        run.outcome_word,
        *((run.never_ran or "it goes on, or it was cut off",) if run.outcome is None else ended),
        run.folder,
    )
    return "; ".join(filter(None, facts))
