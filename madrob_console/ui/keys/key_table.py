"""The keys, the same on every screen, and the lines of the menu that Enter opens.

Function keys work while a text is typed, letters when none is. The footer shows the keys that are
possible now; all of them work everywhere. On a replay the keys that move it take the place of
those that act.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from textual.binding import Binding

from madrob_console.engine.playback import (
    LONG_STEP,
    SAMPLE_STEP,
    Faster,
    PlaybackCommand,
    PlayOrPause,
    Skip,
    Slower,
)
from madrob_console.engine.requests import ExportDossier, ExportTeam, GiveFrames, TakeOver
from madrob_console.referee import acts
from madrob_console.referee.acts.after import PROTEST_OPEN
from madrob_console.referee.acts.protest import WRITE_NOTE
from madrob_console.referee.checks import CHANGE_SETUP, CORRECT_TEAM, OR_WAIVE
from madrob_console.ui.keys.console_questions import JUMP, ask_leave, ask_take
from madrob_console.ui.keys.questions import Ask, Intent, Option, Pick, Press
from madrob_console.ui.keys.result_questions import (
    REISSUE,
    VOID,
    ask_correction,
    ask_doubts,
    ask_protest,
    ask_signature,
    ask_take_back,
)
from madrob_console.ui.keys.run_questions import (
    ACCEPT_FALSE_START,
    ADD_NOTE,
    DECLARE_TIMEOUT,
    ask_abort,
    ask_incident,
    ask_restart,
    ask_ruling,
    ask_waiver,
)

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

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
        asks: what it asks before, or brings about at once; None = the screen itself does it.
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
    asks: Intent | Callable[[Snapshot, str], Intent] | None = None
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
        refused = snapshot.refusal(self.act) if self.act else None
        return None if refused is None else with_caps(refused)

    def intent(self, snapshot: Snapshot, pressed: str) -> Intent | None:
        return self.asks(snapshot, pressed) if callable(self.asks) else self.asks

    def question(self, snapshot: Snapshot, pressed: str) -> Ask | str:
        """What it asks as things stand, or in words why it asks nothing."""
        if (refused := self.refusal(snapshot)) is not None:
            return refused
        intent = self.intent(snapshot, pressed)
        if isinstance(intent, Ask | str):
            return intent
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
        acts.Start.name, acts.Start(), commits=True,
    ),
    Key(
        "pose", "f6", "F6", "Pose", "confirm: the robot stands at its start pose",
        acts.ConfirmPose.name, acts.ConfirmPose(), commits=True,
    ),
    Key(
        "zero", "f7", "F7", "Zero", "take the handle force of the last second as zero",
        acts.ZeroHandle.name, acts.ZeroHandle(), where=_SETUP | _LIVE,
    ),
    Key(
        "abort", "f8", "F8", "ABORT", "interrupt the run: F8 y, or a reason, then y; it is invalid",
        acts.Abort.name, ask_abort, over=True, answered=True,
    ),
    Key(
        "timeout", "f9", "F9", "Timeout", "the robot gave up; asks why, y confirms; it is valid",
        acts.DeclareTimeout.name, DECLARE_TIMEOUT, answered=True,
    ),
    Key(
        "leave", "f10,ctrl+q,ctrl+c", "F10", "Leave", "leave the console; a run goes on",
        asks=ask_leave, over=True,
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
        acts.Rule.name, ask_ruling, where=_RUN,
    ),
    Key(
        "incident", "i", "i", "Incident", "mark an incident, or write a note",
        acts.MarkIncident.name, ask_incident, where=_RUN,
    ),
    Key(
        "take_back", "z", "z", "Take back",
        "take back the last decision",
        acts.TakeBack.name, ask_take_back, where=_RUN | _SETUP,
    ),
    Key("history", "h", "h", "History", "all runs", pane="history"),
    Key("plan", "p", "p", "Plan", "the competition's plan: done, next and left", pane="plan"),
    Key("standings", "s", "s", "Standings", "teams and conditions compared", pane="standings"),
    Key("palette", "ctrl+p", "^P", "Commands", "every command by name; themes"),
    Key(
        "engine", "ctrl+r", "^R", "Engine", "start the engine again after it has ended",
        START_ENGINE,
    ),
)  # fmt: skip

_LISTS = frozenset({"history"})


MENU = (
    Key("open", "", "o", "Open", "show its result and what can be decided", where=_LISTS),
    Key(
        "doubts", "", "d", "Accept doubts", "the values to check stand as they are",
        acts.AcceptDoubts.name, ask_doubts, where=_RESULTS,
    ),
    Key(
        "restart", "r", "r", "Restart", "begin the countdown again",
        acts.RestartCountdown.name, ask_restart, where=_LIVE,
    ),
    Key(
        "accept", "a", "a", "Accept", "accept the false start",
        acts.AcceptFalseStart.name, ACCEPT_FALSE_START, where=_RUN,
    ),
    Key(
        "finalise", "", "f", "Sign", "sign the result with the team's word",
        acts.Finalise.name, ask_signature, where=_RESULTS,
    ),
    Key(
        "correct", "", "c", "Correct", "another subject, side or type; it is scored again",
        acts.Correct.name, ask_correction, where=_RUN,
    ),
    Key(
        "void", "", "v", "Void", "cancel it; gives the attempt back; z takes that back",
        acts.Void.name, VOID, where=_RESULTS,
    ),
    Key(
        "protest", "", "P", "Protest", "file one; decide an open one, or the team withdraws it",
        acts.FileProtest.name, ask_protest, where=_RESULTS,
    ),
    Key(
        "reissue", "", "u", "Re-issue", "change a signed result; the old version stays",
        acts.Reissue.name, REISSUE, where=_RESULTS,
    ),
    Key(
        "waive", "", "w", "Waive", "let a failing check pass for this run",
        acts.Waive.name, ask_waiver, where=_LIVE,
    ),
    Key(
        "note", "", "n", "Note", "write a note beside the run",
        acts.AddNote.name, ADD_NOTE, where=_RUN,
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
        TakeOver.name, ask_take, where=_RUN,
    ),
)  # fmt: skip
"""The lines of the menu, by pane; first what decides an open question. Two are keys, too."""


def ask_menu(
    title: str, lines: Sequence[tuple[Key, str | None]], direct: Sequence[Key] = (), hint: str = ""
) -> Ask | str:
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
    hints = [f"{key.cap} {key.help}" for key in direct]
    unlisted = tuple(Option(each, "", each) for key in direct for each in key.keys.split(","))
    listed = tuple(replace(option, value=option.key) for option in options)
    question = Pick(hint or "; ".join(hints), (*listed, *unlisted), below=below)
    return Ask(title, (question,), lambda each: Press(pressed[each], each))


PLAYBACK_KEYS = (
    Key(
        "play", "space", "Spc", "Pause", "pause the replay, go on",
        PlaybackCommand.name, PlayOrPause(), where=_RUN,
    ),
    Key(
        "sample", "full_stop,comma", ",.", "20ms", "one door sample back, or on; pauses",
        PlaybackCommand.name, lambda _s, k: _skip(k, SAMPLE_STEP), where=_RUN,
    ),
    Key(
        "second", "greater_than_sign,less_than_sign", "<>", "1s", "a second back, or on; pauses",
        PlaybackCommand.name, lambda _s, k: _skip(k, LONG_STEP), where=_RUN,
    ),
    Key(
        "speed", "plus,equals_sign,minus", "+-", "Speed", "from half to ten times as fast",
        PlaybackCommand.name, lambda _s, k: Slower() if k == "minus" else Faster(), where=_RUN,
    ),
    Key(
        "jump", "j", "j", "Jump", "to a time of the run",
        PlaybackCommand.name, JUMP, where=_RUN,
    ),
    Key(
        "frames", "o", "o", "Frames",
        "what the cameras saw at the instant that is shown, as files; y copies where",
        PlaybackCommand.name, GiveFrames(), where=_RUN,
    ),
)  # fmt: skip
"""Keys of a replay; elsewhere they do not exist and are left to the panes."""


def _skip(pressed: str, duration: float) -> Skip:
    return Skip(-duration if pressed in ("comma", "less_than_sign") else duration)


KEYS = {key.name: key for key in (*FUNCTION_KEYS, *LETTER_KEYS, *PLAYBACK_KEYS, *MENU)}
CAPS: Mapping[str, str] = {key.name: key.cap for key in KEYS.values()}
"""The caps of the keys, for sentences that name one: `{zero} zeroes the handle`."""

A_RUN = (
    "{menu} sets up, {zero} zeroes the handle, {pose} confirms the pose, {start} starts."
).format_map(CAPS)

_BY_KEY = {
    words: with_key.format_map(CAPS)
    for words, with_key in (
        (acts.ZeroHandle.name, "{zero} zeroes the handle"),
        (acts.ConfirmPose.name, "{pose} confirms the start pose"),
        (CORRECT_TEAM, "{setup} corrects the team"),
        (CHANGE_SETUP, "{setup} changes it"),
        (OR_WAIVE, ", {menu} waives"),
        (PROTEST_OPEN, f"{PROTEST_OPEN} ({{menu}}, then {{protest}})"),
        (WRITE_NOTE, f"{WRITE_NOTE} ({{note}})"),
    )
}
"""What a rule says is to be done -> the same with the key that does it."""

_DONE_BY_KEY = re.compile(rf"({'|'.join(_BY_KEY)})(?! \()")


def with_caps(text: str) -> str:
    """A sentence of the rules, which know no keys, with the keys that do what it says."""
    return _DONE_BY_KEY.sub(lambda words: _BY_KEY[words[1]], text)


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
