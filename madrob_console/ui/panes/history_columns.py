"""The columns of the history."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import attrgetter

from madrob_console.archive.history import PROTEST_OPEN, RunSummary, condition_words
from madrob_console.kinds import SourceKind
from madrob_console.referee.flags import FlagWeight, worst
from madrob_console.ui.cells.columns import Column
from madrob_console.ui.cells.lines import Span, Tone
from madrob_console.ui.look.words import shortened
from madrob_console.ui.panes.flag_lines import FLAG_TONES, flag_sign
from madrob_console.ui.panes.run_columns import (
    MISSING,
    Shown,
    indicator_column,
    number_column,
    text_column,
)
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
"""Cells of the outcome with its signs; `completed P!!` has so many."""


def columns(name: Callable[[RunSummary], str] = attrgetter("team")) -> list[Column[RunSummary]]:
    """Every column, the most important first; `name` is what the team of a run is called now."""
    indicators = {name: _indicator(name) for name in IndicatorName}
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
        text_column("team", "team", name, 8, ample=18),
        number_column("run", "run number", lambda r: r.run_number, 4),
        number_column("cond", "condition", lambda r: r.condition, 5),
        text_column("task", "task", lambda r: condition_words(r.condition).way, 20, comfort=True),
        Column("outcome", "outcome", _outcome, lambda r: r.outcome_word.casefold(), _OUTCOME),
        Column("src", "source", _source, lambda r: r.source, 3),
        *first,
        *indicators.values(),
        text_column("door", "benchmark type", lambda r: condition_words(r.condition).door, 14),
        number_column("issue", "issue of the result", lambda r: r.issue or None, 6),
        Column("result", "whether the result is final", _closing, lambda r: r.closing, 9),
        text_column("ruleset", "ruleset", lambda r: r.ruleset, 14),
        text_column("testbed", "testbed", lambda r: r.testbed, 12),
        Column("folder", "folder", lambda r: Span(r.folder, Tone.DIM), lambda r: r.folder, 44),
    ]  # fmt: skip


def _indicator(name: IndicatorName) -> Column[RunSummary]:
    return indicator_column(
        name, lambda run: Shown(run.values.get(name), run.uncertainties.get(name), run.sign(name))
    )


def _outcome(run: RunSummary) -> Span:
    """The word; `P` where a protest is open or `*` where it is not final, the sign of its flags."""
    void = run.outcome is Outcome.ABORTED or run.voided
    unsigned = "*" if run.issue and not run.final and not void else ""
    if run.protest_due is not None:
        unsigned = "P"
    heaviest, signs = worst(run.flags), unsigned + flag_sign(run.flags)
    tone = Tone.BAD if run.problem else _OUTCOME_TONES[run.outcome]
    if tone is not Tone.BAD and heaviest in (FlagWeight.CAUTION, FlagWeight.ALARM):
        tone = FLAG_TONES[heaviest]
    word = shortened(run.outcome_word, _OUTCOME - len(f" {signs}" if signs else ""))
    return Span(f"{word} {signs}".rstrip(), tone)


def _source(run: RunSummary) -> Span:
    if run.practice and run.source == SourceKind.ROS:
        return Span("PRA", Tone.NOTICE)
    return _SOURCES.get(run.source or "", MISSING)


def _closing(run: RunSummary) -> Span:
    return Span(run.closing, _CLOSING_TONES[run.closing]) if run.issue else MISSING
