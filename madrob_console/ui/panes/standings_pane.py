"""The standings pane: each team in each condition."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, partial
from typing import ClassVar

from textual.binding import Binding, BindingType

from madrob_console.archive.history import of_competition
from madrob_console.pages.competition import (
    BY_BEST,
    best_text,
    how_testbeds_differ,
    statistics_of,
    statistics_text,
)
from madrob_console.pages.tally import (
    ALIKE,
    Standing,
    counts,
    leaders,
    leaders_first,
    standings,
    subjects_text,
)
from madrob_console.referee.run_summary import RunSummary, condition_words
from madrob_console.ui.cells.columns import Column
from madrob_console.ui.cells.lines import Span, Tone
from madrob_console.ui.cells.table import Table
from madrob_console.ui.panes.history_pane import protests_open
from madrob_console.ui.panes.list_columns import MISSING, number_column, text_column
from madrob_console.ui.panes.list_pane import LIST_KEYS, Load, RunsPane
from scoring.indicator_table import IndicatorName
from scoring.result import DOUBTED

PRACTICE_BANNER = "PRACTICE runs: not official"
FLAGS = "P protest  !! decide  ! scored otherwise"
SIGNS = f"{DOUBTED} doubted  {ALIKE} a tie"

_WIDTH = 9
"""Cells of an indicator with its signs."""


class StandingsView(StrEnum):
    """The best run of each team, or one of the statistics of `statistics_of`."""

    BEST = "best runs"
    MEAN = "mean"
    MEDIAN = "median"
    STD = "std"
    MIN = "min"
    MAX = "max"


@dataclass(frozen=True, slots=True)
class Tables:
    """The standings over the best run of each team and, made when first asked for, over all.

    `leaders` are the keys of the best of each condition. `notes` say what is left out or open.
    """

    best: Sequence[Standing] = ()
    details: Callable[[], Sequence[Standing]] = tuple
    leaders: Collection[str] = ()
    official: bool = True
    notes: Sequence[str] = ()


class StandingsPane(RunsPane[Tables, Standing]):
    """Official runs, or practice runs where there are no others.

    `best` runs of a team in a condition enter its statistics; 0 = all. Only runs of the
    competition enter: others have other teams of the same numbers. `v` goes through the views.
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("v", "view", show=False)]

    def __init__(self, load: Load, best: int) -> None:
        self._best = best
        self._signs = 0
        table = Table([number_column("cond", "condition", _condition, 5)], _key, fixed=3)
        self.view = StandingsView.BEST
        super().__init__(load, table, Tables(), "standings")

    @property
    def _following(self) -> StandingsView:
        views = list(StandingsView)
        return views[(views.index(self.view) + 1) % len(views)]

    def action_view(self) -> None:
        self.view = self._following
        self.show_rows()

    def prepare(self, runs: Sequence[RunSummary]) -> Tables:
        every, runs = len(runs), of_competition(runs, self.competition)
        official = any(run.official for run in runs) or not any(run.practice for run in runs)

        def over(best: int) -> Sequence[Standing]:
            return standings(runs, official=official, best=best, listed=self.teams)

        ordered = leaders_first(over(1))
        rulesets = {standing.ruleset for standing in ordered}
        damaged = sum(run.problem is not None for run in runs)
        protests = sum(standing.open_protests for standing in ordered)
        entering = (run for run in runs if (run.official if official else run.practice))
        notes = (
            "" if official else PRACTICE_BANNER,
            f"{damaged} DAMAGED left out" if damaged else "",
            f"{every - len(runs)} not of this competition" if every > len(runs) else "",
            f"{protests_open(protests)}: NOT FINAL" if protests else "",
            f"{len(rulesets)} rulesets: do not compare them" if len(rulesets) > 1 else "",
            how_testbeds_differ(entering).rstrip("."),
        )
        keys = {_key(standing) for standing in leaders(ordered) if standing.counted}
        details = cache(partial(over, self._best))
        return Tables(ordered, details, keys, official, [*filter(None, notes)])

    def words_about(self, row: Standing) -> tuple[str, Tone]:
        return about(row), Tone.WARN if row.open_protests else Tone.DIM

    def show_rows(self, *, from_top: bool = True) -> None:
        tables, by_best = self.content, self.view is StandingsView.BEST
        rows = tables.best if by_best else tables.details()
        signs = (self._signs_of(row, name) for row in rows for name in IndicatorName)
        self._signs = max(map(len, signs), default=0)
        self.table.empty = "no official runs yet" if tables.official else "no runs yet"
        self.table.legend = SIGNS if self._signs else FLAGS
        self.table.strong = tables.leaders if by_best else ()
        self.table.set_columns(self._columns())
        self.table.set_rows(rows, from_top=from_top)
        self.keys.say(f"Enter shows its runs, v {self._following}, {LIST_KEYS}", Tone.DIM)
        which = f"the best {self._best}" if self._best else "all"
        over = f"{self.view} over {which} valid runs (exec s: completed ones)."
        notes = "".join(f" {note}." for note in tables.notes)
        tone = Tone.PLAIN if tables.official else Tone.NOTICE
        self.say(f"{BY_BEST if by_best else over}{notes}", tone)

    def _columns(self) -> list[Column[Standing]]:
        by_best = self.view is StandingsView.BEST
        names = [*IndicatorName]
        counted: list[Column[Standing]] = [
            number_column("compl", "completed runs", lambda s: s.completed, 6),
            number_column("timeo", "timed-out runs", lambda s: s.timeout, 6),
            number_column("inval", "invalid runs", lambda s: s.aborted, 6),
            number_column("inter", "interrupted runs", lambda s: s.interrupted, 6),
            number_column("open", "runs without a result yet", lambda s: s.without_result, 6),
        ]
        if by_best:
            names = [IndicatorName.CAPABILITY_LEVEL, IndicatorName.EXECUTION_TIME]
            counted = [number_column("runs", "valid runs", lambda s: s.completed + s.timeout, 5)]
        return [
            number_column("cond", "condition", _condition, 5),
            number_column("subj", "subject", lambda s: s.subject, 5),
            text_column("team", "team", lambda s: s.team, 30 if by_best else 14, ample=40),
            *map(self._indicator, names),
            *counted,
            Column("!", "what is open or flagged", _sign, _sign_rank, 2, falling=True),
            text_column("task", "task", lambda s: condition_words(s.condition).way, 20),
            text_column("door", "benchmark type", lambda s: condition_words(s.condition).door, 14),
            text_column("ruleset", "ruleset", lambda s: s.ruleset, 14),
            text_column("testbeds", "testbeds", lambda s: ", ".join(s.testbeds), 12),
        ]

    def _indicator(self, name: IndicatorName) -> Column[Standing]:
        by_best = self.view is StandingsView.BEST

        def cell(standing: Standing) -> Span:
            aggregate, signs = standing.aggregates.get(name), self._signs_of(standing, name)
            texts = statistics_text(aggregate, name, _WIDTH - self._signs)
            text = best_text(standing, name) if by_best else texts.get(self.view, MISSING.text)
            tone = Tone.WARN if DOUBTED in signs else Tone.PLAIN
            return Span(f"{text}{signs:<{self._signs}}", tone)

        def value(standing: Standing) -> float | None:
            view = StandingsView.MEAN if by_best else self.view
            return statistics_of(standing.aggregates.get(name), name).get(view)

        title, meaning = name.spec.column, f"{name.words} ({name.spec.unit})"
        falling = name.spec.higher_is_better
        return Column(title, meaning, cell, value, _WIDTH, right=True, falling=falling)

    def _signs_of(self, standing: Standing, name: IndicatorName) -> str:
        return standing.signs(name, of_mean=self.view is StandingsView.MEAN)


def _condition(standing: Standing) -> int:
    return standing.condition


def _sign(standing: Standing) -> Span:
    sign = standing.flag_sign
    return Span(sign, Tone.WARN if sign == "!" else Tone.BAD)


def _sign_rank(standing: Standing) -> float | None:
    return ("", "!", "!!", "P").index(standing.flag_sign) or None


def about(standing: Standing) -> str:
    task = ", ".join(condition_words(standing.condition))
    called = "".join(f", also '{name}'" for name in standing.other_names)
    facts = [
        *counts(standing),
        f"{standing.undecided} to decide" if standing.undecided else "",
        f"{standing.flagged} with flags" if standing.flagged else "",
    ]
    apart = [
        f"{name.words} {ALIKE} {subjects_text(subjects)}"
        for name, subjects in standing.alike.items()
    ]
    team = standing.team or f"subject {standing.subject}"
    counted = ", ".join(filter(None, facts))
    return "; ".join((f"{team}{called}: {counted}", task, f"ruleset {standing.ruleset}", *apart))


def filter_for(standing: Standing) -> str:
    """What to look for in the history to see the runs of a standing."""
    return f"subject:{standing.subject} cond:{standing.condition}"


def _key(standing: Standing) -> str:
    return f"{standing.subject}/{standing.condition}/{standing.ruleset}"
