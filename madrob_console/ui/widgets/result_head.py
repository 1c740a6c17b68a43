"""What a result says first: outcome, whose, under which rules, final or not."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.run import Phase
from madrob_console.ui.widgets.lines import Line, Span, Tone, View, line
from madrob_console.ui.widgets.run_summary import TONES, who_text
from madrob_console.ui.words import OUTCOMES, condition_text, wrapped

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from scoring.result import Result


class ResultHead(View):
    """Three rows; more for long reasons."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Outcome, run, state of the result."""
        result = snapshot.result
        if result is None:
            return [line(_no_result(snapshot))]
        tone = TONES[result.ending.outcome]
        outcome = f"{OUTCOMES[result.ending.outcome]} ({result.ending.reason})"
        condition = result.condition
        what = (
            f"{who_text(snapshot.run)}, condition {condition.number}:"
            f" {condition.benchmark_type}, {condition_text(condition)}"
        )
        return [
            *(line(Span(row, tone)) for row in wrapped(outcome, width)),
            *(line(row) for row in wrapped(what, width)),
            *_state(snapshot, result, width),
        ]


def _no_result(snapshot: Snapshot) -> str:
    if snapshot.run.phase is Phase.STOPPED:
        return "The result is being written."
    return "No result yet: it appears here by itself when a run has stopped."


def _state(snapshot: Snapshot, result: Result, width: int) -> list[Line]:
    run = snapshot.run
    issue = f"ruleset {result.ruleset}, issue {run.issue}"
    if run.closure is None:
        text, tone = f"{issue}, not final yet: f finalises it", Tone.WARN
    else:
        closure = run.closure
        note = f" ({closure.note})" if closure.note else ""
        text = f"{issue}, final: {closure.team_word} by the team{note}, signed {closure.referee}"
        tone = Tone.GOOD
    lines = [line(Span(row, tone)) for row in wrapped(text, width)]
    source = snapshot.result_source
    if source is not None and source != "ros":
        lines.append(line(Span(f" {source.upper()}: not an official result ", Tone.NOTICE)))
    if snapshot.opened:
        day = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(result.start))
        lines.append(line(Span(f"an earlier run, started {day}", Tone.DIM)))
    return lines
