"""The questions before acts on a run, before its start and while it goes on."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from madrob_console.common.formatting import relative_text, seconds_of
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    Act,
    AddNote,
    DeclareTimeout,
    MarkIncident,
    RestartCountdown,
    Rule,
    Waive,
)
from madrob_console.referee.acts.before import NO_CHECK_FAILS, waiver_problem
from madrob_console.referee.acts.during import RULED
from madrob_console.referee.checks import blocking
from madrob_console.referee.competition_plan import TESTBED_FAULT
from madrob_console.referee.records import CheckName, IncidentKind
from madrob_console.referee.run import Phase
from madrob_console.ui.keys.questions import (
    NO_REASON,
    Ask,
    Intent,
    Option,
    Pick,
    Sure,
    Write,
    ask_why,
    reasons,
)
from scoring.protocol import Step

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

_WAIVER = ask_why("checked by hand", "known testbed fault", "the organiser agrees")


def ask_waiver(snapshot: Snapshot, check: str) -> Intent:
    """About the check that the list of checks names; else about any, for the menu."""
    if check in [*CheckName]:
        return _ask_about(snapshot, CheckName(check))
    blocks = blocking(snapshot.checks)
    failing = [each.name for each in blocks if each.waivable or len(blocks) == 1]
    if len(failing) < 2:
        return _ask_about(snapshot, failing[0]) if failing else NO_CHECK_FAILS
    which = tuple(Option(str(i), str(name), str(name)) for i, name in enumerate(failing, 1))
    return Ask(
        "Waive a failing check for this run",
        (Pick("Which?", which), _WAIVER),
        lambda name, reason: Waive(CheckName(name), reason),
    )


def _ask_about(snapshot: Snapshot, check: CheckName) -> Intent:
    if refused := waiver_problem(check, snapshot.checks):
        return refused
    return Ask(f"Waive '{check}' for this run", (_WAIVER,), lambda reason: Waive(check, reason))


ACCEPT_FALSE_START = Ask(
    "Accept the false start",
    (ask_why("nothing gained", "sensor false alarm", "caused by a person"),),
    AcceptFalseStart,
)

ADD_NOTE = Ask("Note", (Write("Text:", missing=AddNote.missing),), AddNote)

_RESTART = Ask(
    "Restart the countdown",
    (ask_why("robot not ready", "person in the way", "testbed not ready"),),
    RestartCountdown,
)


def ask_restart(snapshot: Snapshot, _pressed: str) -> Intent:
    """A false start that is not decided is the reason."""
    return _RESTART if snapshot.run.undecided_false_start is None else RestartCountdown()


_THE_RUN_GOES_ON = Option("n", "no, the run goes on", None)

DECLARE_TIMEOUT = Ask(
    "DECLARE TIMEOUT: the run ends now and stays valid",
    (
        Pick(
            "Why? The run and its clock go on meanwhile.",
            (
                _THE_RUN_GOES_ON,
                *reasons("the team gives up", "robot stuck", "robot stopped by itself"),
            ),
        ),
        Sure("Timeout now?"),
    ),
    DeclareTimeout,
)

_WHY_ABORTED = Pick(
    "The run and its clock go on meanwhile. A reason first, or y at once.",
    (
        _THE_RUN_GOES_ON,
        Option("y", f"ABORT now, {NO_REASON}", NO_REASON, last=True),
        *reasons("robot unsafe", TESTBED_FAULT, "referee's mistake", "the team asks for it"),
    ),
    below=("Wrong team? Let the run end, then correct it: Enter, c.",),
)


def ask_abort(snapshot: Snapshot, _pressed: str) -> Ask:
    """The same two keys on every console: one without the right to act takes it over with y."""
    why = _WHY_ABORTED
    if not snapshot.practice:
        uses_up = f"It uses up the attempt, but for '{TESTBED_FAULT}'."
        why = replace(why, below=(uses_up, *why.below))
    if snapshot.right.holder:
        why = replace(why, text=f"{snapshot.right.holder} has the right to act: y takes it over.")
    return Ask("ABORT the run: it becomes invalid", (why, Sure("Abort now?")), Abort)


_MARK = "Mark an incident"
_WHICH = Pick(
    "Which? It changes no indicator.",
    (
        Option("n", "no", None),
        *(
            Option(kind.value[0], kind.value, kind.value)
            for kind in IncidentKind
            if kind is not IncidentKind.OTHER
        ),
        Option("o", "other: type it", IncidentKind.OTHER),
        Option("w", "write a note, no incident", AddNote.name),
    ),
)
_WHAT = Write("What happened?", missing="say what happened")
_TIME = Write(
    "When? Seconds from the start of the run (12.5, 1:05; after its stop, too):",
    missing="its time is needed: the run has stopped",
)


def ask_incident(snapshot: Snapshot, _pressed: str) -> Ask:
    """A text typed during the run gets the time at which its kind was chosen."""
    stopped, now = snapshot.run.phase is Phase.STOPPED, snapshot.elapsed

    def chosen(word: str) -> Intent:
        if word == AddNote.name:
            return ADD_NOTE
        kind = IncidentKind(word)
        other = kind is IncidentKind.OTHER
        questions = (*((_WHAT,) if other else ()), *((_TIME,) if stopped else ()))
        if not questions:
            return MarkIncident(kind)

        def marked(*typed: str) -> Act | str:
            after = seconds_of(typed[-1]) if stopped else now
            if after is None and stopped:
                return f"{typed[-1]!r} is no time: 12.5, -3 or 1:05 is one"
            return MarkIncident(kind, typed[0] if other else "", after)

        return Ask(f"{_MARK}: {kind}", questions, marked)

    return Ask(f"{_MARK} {'of the run' if stopped else 'now'}", (_WHICH,), chosen)


_REASON = "reason"
_VERDICTS = {"confirm": True, "deny": False, "sensors": None}
_WHY_RULED = ask_why(
    "seen by the referee", "sensor missed it", "sensor false alarm", "seen on video", "my mistake"
)


def ask_ruling(snapshot: Snapshot, pressed: str) -> Ask:
    return _ask_verdict(snapshot, Step(int(pressed)), NO_REASON)


def _ask_verdict(snapshot: Snapshot, step: Step, reason: str) -> Ask:
    record = next((record for record in snapshot.steps if record.step is step), None)
    done = None if record is None else record.sensors
    sensors = "not done" if done is None else relative_text(done, snapshot.run.start) + " s"
    ruling = None if record is None else record.referee
    ruled = f"{RULED[ruling.confirmed]} ({ruling.reason})" if ruling else "nothing yet"
    verdict = Pick(
        f"Sensors: {sensors}. Referee: {ruled}.",
        (
            Option("c", "confirm", "confirm"),
            Option("d", "deny", "deny"),
            Option("s", "as the sensors say", "sensors"),
            Option("r", "give a reason", _REASON),
        ),
    )
    title = f"Step {step}: {step.text}"

    def chosen(word: str) -> Intent:
        if word != _REASON:
            return Rule(step, _VERDICTS[word], reason)
        return Ask(title, (_WHY_RULED,), lambda other: _ask_verdict(snapshot, step, other))

    return Ask(f"{title} ({reason})", (verdict,), chosen)
