"""The keys: fixed, the same on every screen.

Function keys work while a text is typed, letters when none is. Start and Abort never move. The
footer's second row shows the letters that matter for the pane; all of them work everywhere.
On a replay the keys that move it take their place: no act is possible there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from textual.binding import Binding

from madrob_console.engine.requests import (
    LONG_STEP,
    SAMPLE_STEP,
    ExportDossier,
    ExportTeam,
    Faster,
    GiveFrames,
    PlaybackCommand,
    PlayOrPause,
    Skip,
    Slower,
    TakeOver,
)
from madrob_console.referee import acts
from madrob_console.referee.acts.act import Ask
from madrob_console.ui.keys import dialogs

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.ui.keys.dialogs import Intent

START_ENGINE = "start the engine again"

FINDS_BY_ITSELF = "this screen only watches: it finds the next engine by itself"
"""Why the key `START_ENGINE` does nothing there."""


@dataclass(frozen=True, slots=True)
class Key:
    """One key of the console.

    Attributes:
        keys: as textual names them, separated by commas.
        cap: as the footer shows it.
        act: name of the act whose refusal dims the key; empty = always possible.
        ask: what it brings about, or what is asked before; None = the screen itself does it.
        pane: the pane that it shows; empty = none.
        where: panes whose footer shows it if there is no room for all; empty = every pane.
        commits: what is typed in the set-up counts before the act.
        over: it works while a dialog is open.
        left_to: the panes that have another use for it.
        answered: letters answer what it asks; after a refusal they are nothing else.
    """

    name: str
    keys: str
    cap: str
    label: str
    help: str
    act: str = ""
    ask: Callable[[Snapshot, str], Intent | Ask[Intent]] | None = None
    pane: str = ""
    where: frozenset[str] = frozenset()
    commits: bool = False
    over: bool = False
    left_to: frozenset[str] = frozenset()
    answered: bool = False

    def refusal(self, snapshot: Snapshot) -> str | None:
        if self.act == START_ENGINE:
            if snapshot.right.only_watches:
                return FINDS_BY_ITSELF
            return None if snapshot.pulse.gone else "the engine has not ended"
        return snapshot.refusal(self.act) if self.act else None

    def question(self, snapshot: Snapshot, pressed: str) -> Ask[Intent] | str:
        """What it asks as things stand, or in words why it asks nothing."""
        if (refused := self.refusal(snapshot)) is not None:
            return refused
        intent = None if self.ask is None else self.ask(snapshot, pressed)
        match intent:
            case str() | Ask():
                return intent
            case _:
                return "it needs no question now: press its key again"


FUNCTION_KEYS = (
    Key(
        "help", "f1,question_mark", "F1", "Help", "this page; also ?; again or Escape goes back",
        pane="help",
    ),
    Key("setup", "f2", "F2", "Set-up", "set up a run, pre-start checks", pane="setup"),
    Key("live", "f3", "F3", "Live", "the run as it goes", pane="live"),
    Key("results", "f4", "F4", "Result", "the result of the run", pane="results"),
    Key(
        "start", "f5", "F5", "START", "open the recording and begin the countdown",
        acts.Start.name, acts.Start.ask_questions, commits=True,
    ),
    Key(
        "pose", "f6", "F6", "Pose", "confirm: the robot stands at its start pose",
        acts.ConfirmPose.name, acts.ConfirmPose.ask_questions, commits=True,
    ),
    Key(
        "zero", "f7", "F7", "Zero", "take the handle force of the last second as zero",
        acts.ZeroHandle.name, acts.ZeroHandle.ask_questions,
    ),
    Key(
        "abort", "f8", "F8", "ABORT", "interrupt the run; asks why, y confirms; it is invalid",
        acts.Abort.name, lambda s, _k: dialogs.ask_abort(s), over=True, answered=True,
    ),
    Key(
        "timeout", "f9", "F9", "Timeout", "the robot gave up; asks why, y confirms; it is valid",
        acts.DeclareTimeout.name, acts.DeclareTimeout.ask_questions, answered=True,
    ),
    Key(
        "leave", "f10,ctrl+q,ctrl+c", "F10", "Quit", "leave; asks while a run goes on",
        ask=lambda s, _k: dialogs.ask_leave(s), over=True,
    ),
)  # fmt: skip

_SETUP = frozenset({"setup"})
_LIVE = frozenset({"live"})
_RESULTS = frozenset({"results"})
_RUNS = frozenset({"history", "plan", "standings"})
_NOWHERE = frozenset({"nowhere"})  # seldom: the help and the palette know them
_AFTER = frozenset({"results", "figures", "history", "plan", "standings", "help"})

LETTER_KEYS = (
    Key(
        "rule", "1,2,3,4,5,6", "1-6", " Step", "confirm or deny a step, with a reason",
        acts.Rule.name, acts.Rule.ask_questions, where=_LIVE | _RESULTS,
    ),
    Key(
        "incident", "i", "i", " Incident", "mark an incident; the second key says which",
        acts.MarkIncident.name, acts.MarkIncident.ask_questions, where=_LIVE | _RESULTS,
    ),
    Key(
        "note", "n", "n", " Note", "write a note beside the run",
        acts.AddNote.name, acts.AddNote.ask_questions, where=_SETUP | _LIVE | _RESULTS,
    ),
    Key(
        "waive", "w", "w", " Waive", "let a failing check pass for this run, with a reason",
        acts.Waive.name, acts.Waive.ask_questions, where=_SETUP,
    ),
    Key(
        "accept", "a", "a", " Accept", "accept a false start, with a reason",
        acts.AcceptFalseStart.name, acts.AcceptFalseStart.ask_questions, where=_LIVE,
    ),
    Key(
        "restart", "r", "r", " Restart", "begin the countdown again",
        acts.RestartCountdown.name, acts.RestartCountdown.ask_questions, where=_LIVE,
    ),
    Key(
        "finalise", "f", "f", " Finalise", "close the result with the team's word",
        acts.Finalise.name, acts.Finalise.ask_questions, where=_RESULTS,
    ),
    Key(
        "reissue", "u", "u", " Re-issue",
        "re-issue a final result, to rule again; the old issue stays",
        acts.Reissue.name, acts.Reissue.ask_questions, where=_RESULTS,
    ),
    Key(
        "void", "v", "v", " Void", "a run that is over counts nowhere, with a reason",
        acts.Void.name, acts.Void.ask_questions, where=_RESULTS, left_to=_RUNS,
    ),
    Key(
        "correct", "c", "c", " Correct",
        "correct subject, sides or type after the stop; the run is scored again",
        acts.Correct.name, acts.Correct.ask_questions,
        where=_RESULTS, left_to=frozenset({"standings"}),
    ),
    Key(
        "next", "x", "x", " Next",
        "set up the next run, of the plan if there is one; in lists: one like the marked",
        acts.SetUp.name, where=_SETUP | _AFTER,
    ),
    Key(
        "again", "X", "X", " Again", "set up the same team and condition again",
        acts.SetUp.name, where=_RESULTS,
    ),
    Key(
        "doubts", "d", "d", " Doubt", "accept what is doubted of a result, with a reason",
        acts.AcceptDoubts.name, acts.AcceptDoubts.ask_questions, where=_RESULTS,
    ),
    Key(
        "take_back", "z", "z", " Take back",
        "take back the last ruling, mark, waiver, doubt, void, correction or protest's decision",
        acts.TakeBack.name, acts.TakeBack.ask_questions, where=_SETUP | _LIVE | _RESULTS,
    ),
    Key(
        "protest", "P", "P", " Protest",
        "file a protest against a result that is there; decide it, or the team withdraws it",
        acts.FileProtest.name, acts.FileProtest.ask_questions, where=_RESULTS,
    ),
    Key(
        "figures", "g", "g", " Figures", "the figures of the result: motion, jerk, force",
        pane="figures", where=_AFTER,
    ),
    Key("history", "h", "h", " History", "all runs; opens an earlier one", pane="history"),
    Key(
        "plan", "p", "p", " Plan", "the competition's plan: done, next and left", pane="plan",
        where=_SETUP | _AFTER,
    ),
    Key("standings", "s", "s", " Standings", "teams and conditions compared", pane="standings"),
    Key(
        "export", "e", "e", " Export",
        "pack all runs of the team, or of the marked one, into a zip",
        ExportTeam.name, where=frozenset({"history"}),
    ),
    Key(
        "dossier", "E", "E", " Dossier",
        "pack all about the marked run into a zip: protests, report, recording, tables",
        ExportDossier.name, where=frozenset({"history"}),
    ),
    Key(
        "replay", "R", "R", " Replay",
        "replay the marked run, at the instant that a protest is about; F10 comes back",
        where=_RESULTS | {"history"},
    ),
    Key(
        "copy", "y", "y", " Copy",
        "copy the marked row, the result, a path, or a line for scp (OSC 52)",
        where=_AFTER - {"help"},
    ),
    Key(
        "take", "t", "t", " Take", "take the right to act from another console; asks first",
        TakeOver.name, lambda s, _k: dialogs.ask_take(s), where=_NOWHERE,
    ),
    Key(
        "engine", "ctrl+r", "^R", " Engine", "start the engine again after it has ended",
        START_ENGINE, where=_NOWHERE,
    ),
    Key("menu", "ctrl+p", "^P", " Menu", "every command by name; themes"),
)  # fmt: skip

_PLAYED = _LIVE | _RESULTS

PLAYBACK_KEYS = (
    Key(
        "play", "space", "Spc", " Pause", "pause the replay, go on",
        PlaybackCommand.name, lambda _s, _k: PlayOrPause(), where=_PLAYED,
    ),
    Key(
        "sample", "full_stop,comma", ",.", " 20ms", "one door sample back, or on; pauses",
        PlaybackCommand.name, lambda _s, k: _skip(k, SAMPLE_STEP), where=_PLAYED,
    ),
    Key(
        "second", "greater_than_sign,less_than_sign", "<>", " 1s", "a second back, or on; pauses",
        PlaybackCommand.name, lambda _s, k: _skip(k, LONG_STEP), where=_PLAYED,
    ),
    Key(
        "speed", "plus,equals_sign,minus", "+-", " Speed", "from half to ten times as fast",
        PlaybackCommand.name, lambda _s, k: Slower() if k == "minus" else Faster(), where=_PLAYED,
    ),
    Key(
        "jump", "j", "j", " Jump", "to a time of the run",
        PlaybackCommand.name, lambda _s, _k: dialogs.JUMP, where=_PLAYED,
    ),
    Key(
        "frames", "o", "o", " Frames",
        "what the cameras saw at the instant that is shown, as files; y copies where",
        PlaybackCommand.name, lambda _s, _k: GiveFrames(), where=_PLAYED,
    ),
)  # fmt: skip
"""Keys of a replay; elsewhere they do not exist and are left to the panes."""


def _skip(pressed: str, duration: float) -> Skip:
    return Skip(-duration if pressed in ("comma", "less_than_sign") else duration)


KEYS = {key.name: key for key in (*FUNCTION_KEYS, *LETTER_KEYS, *PLAYBACK_KEYS)}


def bindings() -> list[Binding]:
    """Textual's bindings; they come before the widgets', so keys act in the order of typing.

    A text field keeps the letters for itself (`check_consume_key`).
    """
    return [
        Binding(
            pressed,
            f"press('{key.name}', '{pressed}')",
            key.label.strip(),
            show=False,
            priority=True,
        )
        for key in KEYS.values()
        for pressed in key.keys.split(",")
    ]
