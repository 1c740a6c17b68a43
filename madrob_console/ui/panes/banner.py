"""The one thing that the referee should look at now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from madrob_console.referee.acts import Abort, Start
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.lines import Line, Tone, View, paragraph

if TYPE_CHECKING:
    from madrob_console.engine.shown.snapshot import Snapshot


class Banner(View):
    """A false start, a question, or what comes next."""

    def draw(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        """The text on as many rows as it needs."""
        text, tone = banner(snapshot)
        return paragraph(text, width, tone)


def banner(snapshot: Snapshot) -> tuple[str, Tone]:
    """What to look at now, the most urgent first."""
    run = snapshot.run
    if (false_start := run.undecided_false_start) is not None:
        at = "" if run.start is None else f" at {false_start.time - run.start:.1f} s"
        return f" FALSE START: {false_start.event.words}{at}{_decision(snapshot)} ", Tone.ALARM
    if writing := snapshot.pulse.writing:
        how = "; F8 withdraws it" if snapshot.refusal(Abort.name) is None else ""
        return f" {writing.upper()}: waiting for the disk{how} ", Tone.NOTICE
    if snapshot.ask_referee is not None:
        silent = snapshot.playback is not None or snapshot.right.only_watches
        how = "" if silent else " (1-6 rules on a step)"
        return f" REFEREE: {snapshot.ask_referee}{how} ", Tone.NOTICE
    if snapshot.settling:
        return "door closed: waiting for the settle time of step 6", Tone.WARN
    return _next(snapshot), Tone.PLAIN


def _decision(snapshot: Snapshot) -> str:
    """What the referee can do about a false start."""
    if snapshot.playback is not None or snapshot.right.only_watches:
        return ""
    again = "r restarts the countdown, " if snapshot.run.phase is Phase.COUNTDOWN else ""
    return f": {again}a accepts it with a reason"


def _next(snapshot: Snapshot) -> str:
    read_only = snapshot.playback is not None or snapshot.right.only_watches
    match snapshot.run.phase:
        case Phase.IDLE | Phase.READY if snapshot.right.only_watches:
            return ""
        case Phase.IDLE:
            return "F2: set up a run"
        case Phase.READY:
            refused = snapshot.refusal(Start.name)
            return "F5 starts the countdown" if refused is None else f"F5 waits: {refused}"
        case Phase.COUNTDOWN:
            return "countdown: nobody touches the handle or the door"
        case Phase.RUNNING:
            step = next((record for record in snapshot.steps if not record.done), None)
            return "" if step is None else f"next: step {step.step} {step.step.text}"
        case Phase.STOPPED:
            if snapshot.result is not None:
                return "F4: result"
            if snapshot.rescoring:
                return "the result is being scored again"
            return "the run has stopped" if snapshot.playback else "the result is being written"
        case Phase.FINAL:
            more = "F4: result" if read_only else "x sets up the next run"
            return f"the result is final: {more}"
