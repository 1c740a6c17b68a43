"""The standings pane: each team in each condition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType

from madrob_console.archive.history import VOID, RunSummary, condition_words, of_competition
from madrob_console.pages.competition import SIGNS, how_testbeds_differ
from madrob_console.pages.tally import ALIKE, Standing, standings, subjects_text
from madrob_console.ui.cells.lines import Label, Span, Tone
from madrob_console.ui.cells.table import Column, Table
from madrob_console.ui.panes.runs_pane import (
    Load,
    RunsPane,
    Shown,
    indicator_column,
    number_column,
    text_column,
)
from scoring.indicator_table import IndicatorName

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

PRACTICE_BANNER = "PRACTICE runs: not official"


class Statistic(StrEnum):
    """Which number of an aggregate is shown; named as its attributes are."""

    MEAN = "mean"
    MEDIAN = "median"
    DEVIATION = "std (n - 1)"
    SMALLEST = "smallest"
    LARGEST = "largest"


@dataclass(frozen=True, slots=True)
class Tables:
    """The standings of all runs, made once; `of` has them by (official, only the best runs).

    `damaged` and `others` count runs left out: damaged results, other competitions. `apart`
    says in what the testbeds differ, by official; empty = in nothing.
    """

    of: Mapping[tuple[bool, bool], Sequence[Standing]]
    any_official: bool
    damaged: int
    apart: Mapping[bool, str] = field(default_factory=dict)
    others: int = 0


class StandingsPane(RunsPane[Tables, Standing]):
    """Official runs first; practice runs are never among them.

    `best` runs of a team in a condition enter when only the best do; 0 = no such view. Only
    runs of `competition` enter: others have other teams of the same numbers.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("v", "source", show=False),
        Binding("c", "number", show=False),
        Binding("b", "best", show=False),
    ]

    def __init__(self, load: Load, best: int, competition: str) -> None:
        super().__init__(load, Table(self._columns(), _key, fixed=3), id="standings")
        self._best = best
        self._competition = competition
        self._only_best = best > 0
        self._listed: Mapping[int, str] = {}
        self._official: bool | None = None
        self._statistic = Statistic.MEAN
        self._signs = 0
        self._tables = Tables({}, any_official=False, damaged=0)
        self._legend = Label(SIGNS, id="standings-legend")
        self._legend.display = False
        self._banner = Label(PRACTICE_BANNER, Tone.NOTICE, id="standings-banner")

    def compose(self) -> ComposeResult:
        yield self._banner
        yield self.head
        yield self.table
        yield self.about
        yield self._legend
        best = f", b best {self._best}" if self._best else ""
        yield Label(f"Enter its runs, v PRACTICE, c mean/std{best}, o O sort, <- -> columns")

    def show(self, snapshot: Snapshot) -> None:
        self._listed = snapshot.teams.names
        super().show(snapshot)

    def prepare(self, runs: Sequence[RunSummary]) -> Tables:
        every, runs = len(runs), of_competition(runs, self._competition)
        made = {
            (official, only_best): standings(
                runs,
                official=official,
                best=self._best if only_best else 0,
                listed=self._listed,
            )
            for official in (True, False)
            for only_best in {False, self._best > 0}
        }
        damaged = sum(run.problem is not None for run in runs)
        apart = {
            official: how_testbeds_differ(
                run for run in runs if (run.official if official else run.practice)
            )
            for official in (True, False)
        }
        return Tables(made, any(run.official for run in runs), damaged, apart, every - len(runs))

    def show_content(self, content: Tables) -> None:
        self._tables = content
        self._show_rows()

    def action_source(self) -> None:
        self._official = not self.official
        self._show_rows()

    def action_number(self) -> None:
        order = list(Statistic)
        self._statistic = order[(order.index(self._statistic) + 1) % len(order)]
        self._show_rows()

    def action_best(self) -> None:
        self._only_best = not self._only_best and self._best > 0
        self._show_rows()

    def words_about(self, row: Standing) -> tuple[str, Tone]:
        return about(row), Tone.WARN if row.open_protests else Tone.DIM

    @property
    def official(self) -> bool:
        return self._tables.any_official if self._official is None else self._official

    def _show_rows(self) -> None:
        official = self.official
        self._banner.display = not official
        self.table.empty = "no official runs yet" if official else "no PRACTICE runs yet"
        rows = self._tables.of.get((official, self._only_best), ())
        of_mean = self._statistic is Statistic.MEAN
        self._signs = max(
            (len(row.signs(name, of_mean=of_mean)) for row in rows for name in IndicatorName),
            default=0,
        )
        self._legend.display = self._signs > 0
        self.table.set_rows(rows)
        which = f"the best {self._best}" if self._only_best else "all"
        text = f"{self._statistic} over {which} valid runs (exec s: completed ones)"
        if self._tables.damaged:
            text += f"; {self._tables.damaged} DAMAGED left out"
        if self._tables.others:
            text += f"; {self._tables.others} not of this competition"
        if protests := sum(row.open_protests for row in rows):
            text += f"; {protests} PROTEST{'S' if protests > 1 else ''} open: NOT FINAL"
        if apart := self._tables.apart.get(official):
            text += f". {apart}"
        self.say(text)

    def _columns(self) -> list[Column[Standing]]:
        return [
            number_column("subj", "subject", lambda s: s.subject, 4),
            text_column("team", "team", lambda s: s.team, 8, ample=18),
            number_column("cond", "condition", lambda s: s.condition, 5),
            text_column(
                "task", "task", lambda s: condition_words(s.condition).way, 20, comfort=True
            ),
            number_column("compl", "completed runs", lambda s: s.completed, 6),
            number_column("timeo", "timed-out runs", lambda s: s.timeout, 6),
            number_column("inval", "invalid runs", lambda s: s.aborted, 6),
            Column(
                "!",
                "runs with flags: ! weighs, !! is not decided; P: a protest is open",
                _flags,
                _flag_rank,
                2,
                falling=True,
            ),
            *(self._indicator(name) for name in IndicatorName),
            text_column("door", "benchmark type", lambda s: condition_words(s.condition).door, 14),
            number_column("inter", "interrupted runs", lambda s: s.interrupted, 6),
            number_column("open", "runs without a result yet", lambda s: s.without_result, 6),
            text_column("ruleset", "ruleset", lambda s: s.ruleset, 14),
            text_column("testbeds", "testbeds", lambda s: ", ".join(s.testbeds), 12),
        ]

    def _indicator(self, name: IndicatorName) -> Column[Standing]:
        return indicator_column(
            name, lambda standing: self._shown(standing, name), lambda: self._signs
        )

    def _shown(self, standing: Standing, name: IndicatorName) -> Shown:
        of_mean = self._statistic is Statistic.MEAN
        aggregate = standing.aggregates.get(name)
        known = aggregate.uncertainty if aggregate is not None and of_mean else None
        number = number_of(standing, name, self._statistic)
        return Shown(number, known, standing.signs(name, of_mean=of_mean))


def _flags(standing: Standing) -> Span:
    if standing.open_protests:
        return Span("P!" if standing.flagged else "P", Tone.BAD)
    if standing.undecided:
        return Span("!!", Tone.BAD)
    return Span("!", Tone.WARN) if standing.flagged else Span("")


def _flag_rank(standing: Standing) -> float | None:
    return (standing.open_protests * 1000 + standing.undecided) * 1000 + standing.flagged or None


def number_of(standing: Standing, name: IndicatorName, statistic: Statistic) -> float | None:
    aggregate = standing.aggregates.get(name)
    number: float | None = None if aggregate is None else getattr(aggregate, statistic.name.lower())
    return number


def about(standing: Standing) -> str:
    counts = (
        (standing.completed, "completed"),
        (standing.timeout, "timeout"),
        (standing.aborted, "INVALID"),
        (standing.voided, VOID),
        (standing.interrupted, "INTERRUPTED"),
        (standing.without_result, "without a result yet"),
        (standing.undecided, "UNDECIDED"),
        (standing.flagged, "with flags"),
    )
    not_final = f"{standing.not_final_words}; " if standing.open_protests else ""
    told = ", ".join(f"{count} {word}" for count, word in counts if count)
    task = ", ".join(condition_words(standing.condition))
    apart = "".join(
        f"; {name.words} {ALIKE} {subjects_text(subjects)}"
        for name, subjects in standing.alike.items()
    )
    called = "".join(f", also '{name}'" for name in standing.other_names)
    team = standing.team or f"subject {standing.subject}"
    return f"{not_final}{team}{called}: {task}; {told}; ruleset {standing.ruleset}{apart}"


def filter_for(standing: Standing) -> str:
    """What to look for in the history to see the runs of a standing."""
    return f"subject:{standing.subject} cond:{standing.condition}"


def _key(standing: Standing) -> str:
    return f"{standing.subject}/{standing.condition}/{standing.ruleset}"
