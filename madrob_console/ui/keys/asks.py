"""What a key or a dialog brings about, and what is asked that is no act of the referee."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from madrob_console.engine.shown.playback import JumpTo, PlaybackCommand
from madrob_console.engine.shown.requests import ExportTeam, OpenRun, TakeOver
from madrob_console.referee.acts import Act
from madrob_console.referee.questions import Ask, Option, Pick, Sure, Write
from madrob_console.referee.run import Phase
from madrob_console.ui.look.words import seconds_of
from scoring.protocol import Outcome

if TYPE_CHECKING:
    from madrob_console.archive.unfinished import Unfinished
    from madrob_console.engine.shown.snapshot import Snapshot


@dataclass(frozen=True, slots=True)
class Leave:
    """Leave the console."""


Intent = Act | PlaybackCommand | OpenRun | TakeOver | ExportTeam | Leave | str
"""What a key or the answers to a dialog bring about; a text says why nothing."""


def _jump(text: str) -> JumpTo | str:
    at = seconds_of(text)
    return f"{text!r} is no time: 12.5, -3 or 1:05 is one" if at is None else JumpTo(at)


JUMP = Ask(
    "Jump to a time of the run",
    (Write("Seconds from its start (12.5, -3, 1:05):", missing="a time is needed"),),
    _jump,
)
"""Where to; what is shown there is worked out anew."""


def ask_unfinished(run: Unfinished) -> Ask[OpenRun]:
    """What becomes of a run that was cut off."""
    return Ask(
        f"A RUN WAS CUT OFF: {run.words}",
        (
            Pick(
                "What becomes of it? Nothing of what was recorded is lost.",
                (
                    Option("l", "leave it for later: the history (h) opens it", None),
                    Option("s", "score what is there; its outcome is interrupted", "score"),
                    Option("i", "invalid: it does not count, as if it had been aborted", "void"),
                ),
            ),
        ),
        lambda word: OpenRun(run.folder, invalid=word == "void"),
    )


def ask_leave(snapshot: Snapshot) -> Ask[Leave] | Leave:
    """At once; asked first while a run goes on and while a result is not final."""
    run = snapshot.run
    if snapshot.playback is not None:
        return Leave()
    if run.phase is Phase.STOPPED and run.outcome is not Outcome.ABORTED:
        return Ask(
            "Leave the console",
            (Sure("The result is not final: the history (h) opens it later. Leave?"),),
            Leave,
        )
    if not run.active:
        return Leave()
    return Ask(
        "LEAVE the console while a run goes on",
        (
            Sure(
                "The run goes on without this screen: it is recorded, timed out and scored, and"
                " `madrob console` comes back to it. F8 aborts it instead. Leave?"
            ),
        ),
        Leave,
    )
