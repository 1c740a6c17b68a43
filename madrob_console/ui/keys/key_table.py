"""The keys, the same on every screen, and the lines of the menu that Enter opens.

Function keys work while a text is typed, letters when none is. The footer shows the keys that are
possible now; all of them work everywhere. On a replay the keys that move it take the place of
those that act.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from madrob_console.referee.acts.act import Ask, Option, Pick
from madrob_console.referee.records import CheckName
from madrob_console.ui.keys import dialogs
from madrob_console.ui.keys.dialogs import Press

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.ui.keys.dialogs import Intent

START_ENGINE = "start the engine again"

FINDS_BY_ITSELF = "this screen only watches: it finds the next engine by itself"
"""Why the key `START_ENGINE` does nothing there."""


@dataclass(frozen=True, slots=True)
class Key:
    """One key of the console, or one line of the menu.

    Attributes:
        keys: as textual names them, separated by commas; empty = it is only in the menu.
        cap: as the footer and the menu show it.
        act: name of the act whose refusal says why it is not possible; empty = always possible.
        ask: what it brings about, or what is asked before; None = the screen itself does it.
        pane: the pane that it shows; empty = none.
        commits: what is typed in the set-up counts before the act.
        over: it works while a dialog is open.
        answered: letters answer what it asks; after a refusal they are nothing else.
        where: the panes whose footer or whose menu has it; empty = every pane.
    """

    name: str
    keys: str
    cap: str
    label: str
    help: str
    act: str = ""
    ask: Callable[[Snapshot, str], Intent | Ask[Intent]] | None = None
    pane: str = ""
    commits: bool = False
    over: bool = False
    answered: bool = False
    where: frozenset[str] = frozenset()

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


_LIVE = frozenset({"live"})
_RESULTS = frozenset({"results"})
_RUN = _LIVE | _RESULTS
_SETUP = frozenset({"setup"})

FUNCTION_KEYS = (
    Key(
        "help", "f1,question_mark", "F1", "more", "this page; also ?; again or Escape goes back",
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
        acts.ZeroHandle.name, acts.ZeroHandle.ask_questions, where=_SETUP | _LIVE,
    ),
    Key(
        "abort", "f8", "F8", "ABORT", "interrupt the run: F8 y, or a reason, then y; it is invalid",
        acts.Abort.name, lambda s, _k: dialogs.ask_abort(s), over=True, answered=True,
    ),
    Key(
        "timeout", "f9", "F9", "Timeout", "the robot gave up; asks why, y confirms; it is valid",
        acts.DeclareTimeout.name, acts.DeclareTimeout.ask_questions, answered=True,
    ),
    Key(
        "leave", "f10,ctrl+q,ctrl+c", "F10", "Leave", "leave the console; a run goes on",
        ask=lambda s, _k: dialogs.ask_leave(s), over=True,
    ),
)  # fmt: skip

LETTER_KEYS = (
    Key("menu", "enter", "Enter", "Menu", "what can be done with the run; on a row: with that run"),
    Key(
        "next", "x", "x", "Next run", "set up the plan's next run, or what F2 shows",
        acts.SetUp.name,
    ),
    Key(
        "rule", "1,2,3,4,5,6", "1-6", "Step", "confirm or deny a step",
        acts.Rule.name, acts.Rule.ask_questions, where=_RUN,
    ),
    Key(
        "incident", "i", "i", "Incident", "mark an incident, or write a note",
        acts.MarkIncident.name, acts.MarkIncident.ask_questions, where=_RUN,
    ),
    Key(
        "take_back", "z", "z", "Take back",
        "take back the last decision",
        acts.TakeBack.name, acts.TakeBack.ask_questions, where=_RUN | _SETUP,
    ),
    Key("history", "h", "h", "History", "all runs", pane="history"),
    Key("plan", "p", "p", "Plan", "the competition's plan: done, next and left", pane="plan"),
    Key("messages", "m", "m", "Messages", "the last fifty messages", pane="messages"),
    Key("standings", "s", "s", "Standings", "teams and conditions compared", pane="standings"),
    Key("palette", "ctrl+p", "^P", "Commands", "every command by name; themes"),
    Key(
        "engine", "ctrl+r", "^R", "Engine", "start the engine again after it has ended",
        START_ENGINE,
    ),
)  # fmt: skip

_LISTS = frozenset({"history"})


def _ask_waiver(snapshot: Snapshot, check: str) -> Intent:
    """About the check that the list of checks names; else about any, for the menu."""
    if check in [*CheckName]:
        return acts.Waive.ask_why(snapshot, CheckName(check))
    return acts.Waive.ask_questions(snapshot, "")


MENU = (
    Key("open", "", "o", "Open", "show its result and what can be decided", where=_LISTS),
    Key(
        "doubts", "", "d", "Accept doubts", "the values to check stand as they are",
        acts.AcceptDoubts.name, acts.AcceptDoubts.ask_questions, where=_RESULTS,
    ),
    Key(
        "restart", "r", "r", "Restart", "begin the countdown again",
        acts.RestartCountdown.name, acts.RestartCountdown.ask_questions, where=_LIVE,
    ),
    Key(
        "accept", "a", "a", "Accept", "accept the false start",
        acts.AcceptFalseStart.name, acts.AcceptFalseStart.ask_questions, where=_RUN,
    ),
    Key(
        "finalise", "", "f", "Sign", "sign the result with the team's word",
        acts.Finalise.name, acts.Finalise.ask_questions, where=_RESULTS,
    ),
    Key(
        "correct", "", "c", "Correct", "another subject, side or type; it is scored again",
        acts.Correct.name, acts.Correct.ask_questions, where=_RESULTS,
    ),
    Key(
        "void", "", "v", "Void", "it does not count; z takes that back",
        acts.Void.name, acts.Void.ask_questions, where=_RESULTS,
    ),
    Key(
        "protest", "", "P", "Protest", "file one; decide an open one, or the team withdraws it",
        acts.FileProtest.name, acts.FileProtest.ask_questions, where=_RESULTS,
    ),
    Key(
        "reissue", "", "u", "Re-issue", "change a signed result; the old version stays",
        acts.Reissue.name, acts.Reissue.ask_questions, where=_RESULTS,
    ),
    Key(
        "waive", "", "w", "Waive", "let a failing check pass for this run",
        acts.Waive.name, _ask_waiver, where=_LIVE,
    ),
    Key(
        "note", "", "n", "Note", "write a note beside the run",
        acts.AddNote.name, acts.AddNote.ask_questions, where=_RUN,
    ),
    Key(
        "again", "", "X", "Again", "set up the same team and condition",
        acts.SetUp.name, where=_RESULTS | _LISTS,
    ),
    Key(
        "figures", "", "g", "Figures", "motion, jerk and force over time",
        pane="figures", where=_RESULTS,
    ),
    Key(
        "replay", "", "R", "Replay", "the recording, at the instant of a protest",
        where=_RESULTS | _LISTS,
    ),
    Key(
        "export", "", "e", "Zip", "all runs of the team, for the team",
        ExportTeam.name, where=_RESULTS | _LISTS,
    ),
    Key(
        "dossier", "", "E", "Dossier", "a zip of all about this run, for a protest",
        ExportDossier.name, where=_RESULTS | _LISTS,
    ),
    Key("copy", "", "y", "Copy", "row, result, path or a line for scp", where=_RUN | _LISTS),
    Key(
        "take", "", "t", "Take over", "take the right to act from the other console",
        TakeOver.name, lambda s, _k: dialogs.ask_take(s), where=_RUN,
    ),
)  # fmt: skip
"""The lines of the menu, by pane; first what decides an open question. Two are keys, too."""


def ask_menu(
    title: str, lines: Sequence[tuple[Key, str | None]], direct: Sequence[Key] = (), hint: str = ""
) -> Ask[Press] | str:
    """Asks what to do; `lines` are keys of the menu, each with why it is not possible.

    The keys `direct` work here, too, and a line above the menu names them.
    """
    options = tuple(
        Option(key.cap, f"{key.label:<14} {key.help}", key.name)
        for key, refused in lines
        if refused is None
    )
    reasons: dict[str, list[str]] = {}
    for key, refused in lines:
        if refused is not None:
            reasons.setdefault(refused, []).append(f"{key.cap} {key.label.lower()}")
    if not options:
        return next(iter(reasons), "there is no run to act on")
    below = tuple(f"Not now: {', '.join(keys)}: {why}" for why, keys in reasons.items())
    pressed = {option.key: option.value or "" for option in options}
    pressed |= {each: key.name for key in direct for each in key.keys.split(",")}
    told = [f"{key.cap} {key.help}" for key in direct]
    unlisted = tuple(Option(each, "", each) for key in direct for each in key.keys.split(","))
    listed = tuple(replace(option, value=option.key) for option in options)
    question = Pick(hint or "; ".join(told), (*listed, *unlisted), below=below)
    return Ask(title, (question,), lambda each: Press(pressed[each], each))


_PLAYED = _RUN

PLAYBACK_KEYS = (
    Key(
        "play", "space", "Spc", "Pause", "pause the replay, go on",
        PlaybackCommand.name, lambda _s, _k: PlayOrPause(), where=_PLAYED,
    ),
    Key(
        "sample", "full_stop,comma", ",.", "20ms", "one door sample back, or on; pauses",
        PlaybackCommand.name, lambda _s, k: _skip(k, SAMPLE_STEP), where=_PLAYED,
    ),
    Key(
        "second", "greater_than_sign,less_than_sign", "<>", "1s", "a second back, or on; pauses",
        PlaybackCommand.name, lambda _s, k: _skip(k, LONG_STEP), where=_PLAYED,
    ),
    Key(
        "speed", "plus,equals_sign,minus", "+-", "Speed", "from half to ten times as fast",
        PlaybackCommand.name, lambda _s, k: Slower() if k == "minus" else Faster(), where=_PLAYED,
    ),
    Key(
        "jump", "j", "j", "Jump", "to a time of the run",
        PlaybackCommand.name, lambda _s, _k: dialogs.JUMP, where=_PLAYED,
    ),
    Key(
        "frames", "o", "o", "Frames",
        "what the cameras saw at the instant that is shown, as files; y copies where",
        PlaybackCommand.name, lambda _s, _k: GiveFrames(), where=_PLAYED,
    ),
)  # fmt: skip
"""Keys of a replay; elsewhere they do not exist and are left to the panes."""


def _skip(pressed: str, duration: float) -> Skip:
    return Skip(-duration if pressed in ("comma", "less_than_sign") else duration)


KEYS = {key.name: key for key in (*FUNCTION_KEYS, *LETTER_KEYS, *PLAYBACK_KEYS, *MENU)}

CALLED: Mapping[str, str] = {
    "setup": "team condition practice",
    "start": "go begin countdown",
    "pose": "robot ready",
    "zero": "tare calibrate force",
    "abort": "stop cancel emergency interrupt",
    "timeout": "gave up end",
    "next": "following team",
    "rule": "confirm deny ruling",
    "incident": "collision fall human help",
    "take_back": "undo",
    "doubts": "question mark unsure",
    "restart": "false start repeat countdown",
    "accept": "false start",
    "finalise": "final signature acknowledge",
    "correct": "wrong team wrong side mistake",
    "void": "invalid annul delete",
    "protest": "complaint appeal",
    "reissue": "change signed version",
    "waive": "ignore skip check",
    "note": "comment remark",
    "again": "repeat once more",
    "figures": "plot curves graph",
    "replay": "recording video",
    "export": "download share files",
    "dossier": "evidence",
    "take": "control",
    "engine": "restart reconnect",
    "leave": "quit exit close",
    "plan": "schedule order",
    "standings": "ranking",
    "messages": "log errors",
}
"""What people call a command, by its name: the palette finds it by these words, too."""


def bindings() -> list[Binding]:
    """Textual's bindings; they come before the widgets', so keys act in the order of typing.

    A text field keeps the letters for itself (`check_consume_key`); Enter is first the widget's.
    """
    return [
        Binding(
            pressed,
            f"press('{key.name}', '{pressed}')",
            key.label,
            show=False,
            priority=pressed != "enter",
        )
        for key in KEYS.values()
        for pressed in filter(None, key.keys.split(","))
    ]
