"""What a result says first: outcome, whose, under which rules, final or not."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.kinds import SourceKind
from madrob_console.referee.acts.finalise import DECIDED_BY
from madrob_console.referee.flags import FlagKind, FlagWeight, undecided, worst
from madrob_console.referee.protests import due_words, open_protests
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.lines import Line, Span, Tone, View, line, paragraph, width_of
from madrob_console.ui.look.words import OUTCOMES, date_of
from madrob_console.ui.panes.flag_lines import FLAG_TONES, flag_lines
from madrob_console.ui.panes.run_status import TONES, what_text

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot
    from scoring.result import Result

_UNSAVED = "NOT ON DISK YET: only the engine has it, and goes on trying"


class ResultHead(View):
    """Three rows; one more for flags, and more for long words."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """Outcome and validity, what a decision hangs on, run, state of the result."""
        result = snapshot.result
        if result is None:
            return [line(_no_result(snapshot))]
        # the notice beside the outcome has that one
        found = [flag for flag in snapshot.flags if flag.kind is not FlagKind.PRACTICE]
        heaviest = worst(found) or FlagWeight.REMARK
        tone = TONES[result.outcome]
        if heaviest is not FlagWeight.REMARK and tone is not Tone.BAD:
            tone = FLAG_TONES[heaviest]
        valid = ", valid" if snapshot.run.valid else ", VOID" if snapshot.run.voided else ""
        outcome = f"{OUTCOMES[result.outcome]}{valid} ({result.ended})"
        acts = snapshot.run.phase is Phase.STOPPED and not _silent(snapshot)
        return [
            *_marked(paragraph(outcome, width, tone), snapshot, width),
            *flag_lines(found, width, DECIDED_BY if acts else None),
            *paragraph(what_text(snapshot.run), width),
            *_deadlines(snapshot, width),
            *_state(snapshot, result, width),
        ]


def _marked(lines: list[Line], snapshot: Snapshot, width: int) -> list[Line]:
    """With a notice where the result is no official one: beside the outcome, else below it."""
    source = snapshot.result_source
    if source is None or (source is SourceKind.ROS and not snapshot.practice):
        return lines
    kind = "practice" if source is SourceKind.ROS else source
    notice = line(Span(f" {kind.upper()}: not an official result ", Tone.NOTICE))
    if width_of(lines[-1]) + 2 + width_of(notice) > width:
        return [*lines, notice]
    return [*lines[:-1], line(*lines[-1], "  ", *notice)]


def _silent(snapshot: Snapshot) -> bool:
    """Whether there is nobody before this screen who could do anything about it."""
    return snapshot.playback is not None or snapshot.right.only_watches


def _no_result(snapshot: Snapshot) -> str:
    if snapshot.playback is not None:
        return "The result comes at the end of the recording."
    if snapshot.rescoring:
        return "The result is being scored again: the one that was here is out of date."
    if snapshot.run.phase is Phase.STOPPED:
        return "The result is being written."
    return "No result yet: it appears here by itself when a run has stopped."


def _deadlines(snapshot: Snapshot, width: int) -> list[Line]:
    """How long there is to decide what is protested."""
    if snapshot.playback is not None:  # what was to be done then is over
        return []
    lines: list[Line] = []
    for one in open_protests(snapshot.run.protests):
        left = due_words(one.due, snapshot.time)
        by = time.strftime("%H:%M", time.localtime(one.due))
        text = f"protest {one.number} of {one.team}, decision due {by}, {left}"
        lines += paragraph(text, width, Tone.BAD if one.due < snapshot.time else Tone.WARN)
    return lines


def _state(snapshot: Snapshot, result: Result, width: int) -> list[Line]:
    run = snapshot.run
    issue = f"ruleset {result.ruleset}, issue {run.issue}"
    if run.closure is None:
        then = "" if _silent(snapshot) or snapshot.pulse.unsaved else ": f finalises it"
        text, tone = f"{issue}, not final yet{then}", Tone.WARN
    else:
        closure = run.closure
        note = f" ({closure.note})" if closure.note else ""
        text = f"{issue}, final: {closure.team_word} by the team{note}, signed {closure.referee}"
        tone = Tone.GOOD
        if undecided(snapshot.flags):
            text, tone = f"{text} with what is undecided", Tone.WARN
    lines = paragraph(text, width, tone)
    if snapshot.pulse.unsaved:
        lines = [*paragraph(_UNSAVED, width, Tone.BAD), *lines]
    if (playback := snapshot.playback) is not None:
        tone = Tone.DIM if playback.agrees else Tone.BAD
        lines += paragraph(playback.comparison, width, tone)
    if snapshot.opened:
        day = date_of(result.start)
        lines.append(line(Span(f"an earlier run, started {day}", Tone.DIM)))
    return lines
