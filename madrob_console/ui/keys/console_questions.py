"""The questions before what is no act of the referee: open, copy, take over, leave."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING

from madrob_console.archive.folders import lies_in_practice
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import seconds_of
from madrob_console.common.names import clean_name
from madrob_console.engine.playback import JumpTo
from madrob_console.engine.requests import OpenRun, TakeOver
from madrob_console.referee.protests import open_protests
from madrob_console.referee.run import Run
from madrob_console.ui.keys.questions import (
    Ask,
    Copy,
    Leave,
    Option,
    OtherName,
    Pick,
    Press,
    Sure,
    Write,
    reasons,
)

if TYPE_CHECKING:
    from madrob_console.archive.unfinished_runs import Unfinished
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.referee.run_summary import RunSummary


@dataclass(frozen=True, slots=True)
class SelectedRun:
    """The run that a key is about; `folder` as seen from the results folder.

    `at` is the instant that a protest is about, s from its start; None = nobody protested.
    """

    folder: str
    at: float | None

    @classmethod
    def of_list(cls, run: RunSummary) -> SelectedRun:
        at = 0.0 if run.protest_filed is not None else None  # where none was named
        return cls(run.folder, at if run.protest_at is None else run.protest_at)

    @classmethod
    def of_shown(cls, folder: str, run: Run) -> SelectedRun:
        """The current run; `folder` is its whole path."""
        path = PurePath(folder)
        name = f"{path.parent.name}/{path.name}"
        of = (*open_protests(run.protests), *reversed(run.protests))
        at = None
        if of and run.start is not None:
            at = 0.0 if of[0].at is None else of[0].at - run.start
        return cls(name if lies_in_practice(name) else path.name, at)


def _jump(text: str) -> JumpTo | str:
    at = seconds_of(text)
    return f"{text!r} is no time: 12.5, -3 or 1:05 is one" if at is None else JumpTo(at)


JUMP = Ask(
    "Jump to a time of the run",
    (Write("Seconds from its start (12.5, -3, 1:05):", missing="a time is needed"),),
    _jump,
)
"""Asks where to; what is shown there is worked out anew."""


def ask_other_name(subject: int, listed: str, typed: str) -> Ask:
    """Asks what a team is called, and why not as in the list (`listed`; empty = not in it)."""

    def named(text: str, reason: str) -> OtherName | str:
        try:
            return OtherName(subject, clean_name(text, "team"), reason)
        except MadrobError as error:
            return str(error)

    in_list, why = "it is not in the list", reasons("not in the list yet", "a guest")
    if listed:
        in_list = f"it is {listed} in the list"
        why = reasons("the list is wrong", "renamed since")
    return Ask(
        f"ANOTHER NAME for subject {subject}: {in_list}",
        (
            Write("Name:", initial=typed or listed, missing="a name is needed"),
            Pick(
                "Why? The reason stands with the result.",
                (Option("n", "no other name", None), *why),
            ),
        ),
        named,
    )


def ask_unfinished(run: Unfinished) -> Ask:
    options: tuple[Option, ...] = (
        Option("l", "leave it for later: the history (h) opens it", None),
        Option("s", "score it: interrupted, no attempt used; a declared timeout stays", "score"),
        Option("i", "invalid, as if aborted: uses up an attempt of the team", "void"),
    )
    title = "A RUN WAS CUT OFF"
    if run.stopped:
        title = "A RESULT IS MISSING"
        options = (*options[:1], Option("s", "score it as it ended", "score"))
    return Ask(
        f"{title}: {run.words}",
        (Pick("What becomes of it? Nothing of what was recorded is lost.", options),),
        lambda word: OpenRun(run.folder, invalid=word == "void"),
    )


def ask_false_start(run: Run) -> Ask | str:
    """Asks what becomes of a held countdown; a text says that it is not held."""
    mark = run.undecided_false_start
    if run.held is None or run.start is None or mark is None:
        return "it is decided: the countdown is not held any more"
    left = f"{run.start - run.held:.1f} s"
    return Ask(
        f"FALSE START: {mark.event.words}. The countdown is held {left} before the start.",
        (
            Pick(
                "",
                (
                    Option("r", "begin the countdown again", "restart"),
                    Option("a", "accept it: the countdown goes on", "accept"),
                ),
                below=("F8 aborts the run.",),
            ),
        ),
        lambda key: Press(key, ""),
    )


def ask_copy(
    row: str, result: str, folder: str, zipped: str, host: str, pictures: str = ""
) -> Ask | str:
    """Asks what to copy of what there is; empty = there is none.

    `row` is the marked one, with its heads. `folder`, `zipped` (the last zip) and `pictures`
    (what cameras saw) are whole paths. Others copy files from `host`, as `user@host`.
    """

    def scp(path: str, option: str = "") -> str:
        return f"scp {option}{shlex.quote(f'{host}:{path}')} ." if path else ""

    offered = (
        ("m", "the marked row", row),
        ("r", "the result as text", result),
        ("p", "the run's folder", folder),
        ("s", "a line that fetches it", scp(folder, "-r ")),
        ("f", "the folder of the pictures", pictures),
        ("g", "a line that fetches it", scp(pictures, "-r ")),
        ("z", "the zip", zipped),
        ("l", "a line that fetches it", scp(zipped)),
    )
    there = {key: Copy(what, text) for key, what, text in offered if text}
    if not there:
        return "there is no row, no result and no run to copy"
    options = tuple(Option(key, _offer(copy), key) for key, copy in there.items())
    text = "What? It goes to the clipboard of your own machine (OSC 52)."
    return Ask("Copy", (Pick(text, options),), lambda key: there[key])


def _offer(copy: Copy) -> str:
    lines = copy.text.splitlines()
    return f"{copy.what}: {copy.text}" if len(lines) == 1 else copy.what


def ask_take(snapshot: Snapshot, _pressed: str) -> Ask:
    """Asks before taking the right to act; the console that loses it is told, can take it back."""
    goes_on = " A run goes on." if snapshot.run.active else ""
    return Ask(
        "Take the right to act",
        (Sure(f"{snapshot.right.holder} has it, and can do nothing then.{goes_on} Take it?"),),
        TakeOver,
    )


def ask_leave(snapshot: Snapshot, _pressed: str) -> Ask | Leave:
    """Leaves at once; with the right to act asks first during a run and before a run is on disk."""
    run, pulse = snapshot.run, snapshot.pulse
    if snapshot.playback is not None or pulse.gone or snapshot.right.only_watches:
        return Leave()
    if pulse.server and run.active:
        return Ask(
            "LEAVE the console while the engine is silent",
            (Sure("Nobody can say whether the run goes on. Leave?"),),
            Leave,
        )
    if (pulse.unsaved or pulse.waiting) and not run.active:
        return Ask(
            "Leave the console",
            (
                Sure(
                    "A run is NOT ON DISK yet: only the engine has it, which goes on trying and"
                    " does not end before. Leave?"
                ),
            ),
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
