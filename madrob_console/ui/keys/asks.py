"""What is asked before each act, and which reasons are offered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from madrob_console.engine.shown.playback import JumpTo
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    Act,
    AddNote,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Waive,
    WithdrawIncident,
)
from madrob_console.referee.preflight import blocking
from madrob_console.referee.run import CheckName, IncidentKind, Phase, RunSetup, TeamWord
from madrob_console.ui.keys.questions import (
    Ask,
    Leave,
    Open,
    Option,
    Pick,
    Question,
    Sure,
    Write,
    reasons,
)
from madrob_console.ui.look.words import RULED, relative_text, seconds_of
from scoring.protocol import Outcome, Step

if TYPE_CHECKING:
    from madrob_console.archive.unfinished import Unfinished
    from madrob_console.engine.shown.snapshot import Snapshot
    from scoring.procedure import Ruling

_NO = Option("n", "no, the run goes on", None)
_MEANWHILE = "Why? The run and its clock go on meanwhile."

ABORT = Ask(
    "ABORT the run: it becomes invalid and stays on record",
    (
        Pick(
            _MEANWHILE,
            (
                _NO,
                *reasons(
                    "robot unsafe", "testbed fault", "referee's mistake", "the team asks for it"
                ),
            ),
        ),
        Sure("Abort now?"),
    ),
    lambda reason: Abort(reason=reason),
)
"""Why, and then `y`."""

TIMEOUT = Ask(
    "DECLARE TIMEOUT: the run ends now and stays valid",
    (
        Pick(
            _MEANWHILE,
            (_NO, *reasons("the team gives up", "robot stuck", "robot stopped by itself")),
        ),
        Sure("Timeout now?"),
    ),
    lambda reason: DeclareTimeout(reason=reason),
)
"""Why, and then `y`."""

INCIDENT = Ask(
    "Mark an incident now",
    (
        Pick(
            "Which? It changes no indicator; n adds a note later.",
            tuple(Option(kind.value[0], kind.value, kind.value) for kind in IncidentKind),
        ),
    ),
    lambda kind: MarkIncident(IncidentKind(kind)),
)
"""Which kind: the second key marks it."""

WITHDRAW = Ask(
    "Withdraw the last incident; it stays on record as withdrawn",
    (Pick("Why?", reasons("marked by mistake", "it was another kind")), Sure("Withdraw it?")),
    WithdrawIncident,
)
"""Why, and then `y`."""

RESTART = Ask(
    "Restart the countdown",
    (Pick("Why?", reasons("robot not ready", "person in the way", "testbed not ready")),),
    RestartCountdown,
)
"""Why, where no false start says so."""


def ask_restart(snapshot: Snapshot) -> Act | Ask:
    """At once after a false start."""
    return RESTART if snapshot.run.undecided_false_start is None else RestartCountdown()


NOTE = Ask("Note", (Write("Text:", missing="the note is empty"),), AddNote)
"""The text."""

FALSE_START = Ask(
    "Accept the false start",
    (Pick("Why?", reasons("nothing gained", "sensor false alarm", "caused by a person")),),
    AcceptFalseStart,
)
"""Why it may pass."""

REISSUE = Ask(
    "Re-issue the final result; the old issue stays",
    (
        Pick("Why?", reasons("a step was ruled wrongly", "protest of the team accepted")),
        Sure("Open the result again?"),
    ),
    Reissue,
)
"""Why, and then `y`."""


def _jump(text: str) -> JumpTo | str:
    at = seconds_of(text)
    return f"{text!r} is no time: 12.5, -3 or 1:05 is one" if at is None else JumpTo(at)


JUMP = Ask(
    "Jump to a time of the run",
    (Write("Seconds from its start (12.5, -3, 1:05):", missing="a time is needed"),),
    _jump,
)
"""Where to; what is shown there is worked out anew."""


def ask_unfinished(run: Unfinished) -> Ask:
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
        lambda word: Open(run.folder, invalid=word == "void"),
    )


def ask_ruling(snapshot: Snapshot, step: Step) -> Ask:
    """Confirmed or denied, and why."""
    record = next((r for r in snapshot.steps if r.step is step), None)
    found = None if record is None else record.sensors
    sensors = "not done" if found is None else relative_text(found, snapshot.run.start) + " s"
    verdict = Pick(
        f"Sensors: {sensors}. Referee: {_said(record.ruling if record else None)}.",
        (
            Option("c", "confirm: it is done", "confirm"),
            Option("d", "deny: it is not done", "deny"),
            Option("s", "as the sensors say: take a ruling back", "sensors"),
        ),
    )
    words = {"confirm": True, "deny": False, "sensors": None}
    why = reasons("seen by the referee", "sensor missed it", "sensor false alarm", "seen on video")
    return Ask(
        f"Step {step}: {step.text}",
        (verdict, Pick("Why?", why), Sure("Is that right? It can be ruled again.")),
        lambda word, reason: Rule(step, words[word], reason),
    )


def _said(ruling: Ruling | None) -> str:
    if ruling is None:
        return "nothing yet"
    return f"{RULED[ruling.confirmed]} ({ruling.reason})"


def ask_waiver(snapshot: Snapshot, check: CheckName | None = None) -> Ask | str:
    """Which failing check, and why; in words if there is none."""
    failing = [c.name for c in blocking(snapshot.checks)]
    if check is not None and check not in failing:
        return f"the check '{check}' does not fail"
    if not failing:
        return "no check fails"
    why = Pick(
        "Why may it pass?", reasons("checked by hand", "known testbed fault", "practice run")
    )
    if check is None and len(failing) == 1:
        check = failing[0]
    if check is not None:
        name = check
        return Ask(f"Waive '{name}' for this run", (why,), lambda reason: Waive(name, reason))
    which = tuple(Option(str(i), str(name), str(name)) for i, name in enumerate(failing, 1))
    return Ask(
        "Waive a failing check for this run",
        (Pick("Which?", which), why),
        lambda name, reason: Waive(CheckName(name), reason),
    )


def ask_finalise(snapshot: Snapshot) -> Ask:
    """The team's word, a note, and the referee's name where it is missing."""
    setup = snapshot.run.setup
    referee = "" if setup is None else setup.referee
    words = (
        Option("a", "acknowledged", TeamWord.ACKNOWLEDGED),
        Option("p", "protested", TeamWord.PROTESTED),
        Option("b", "absent", TeamWord.ABSENT),
    )
    no = Option("n", "not yet", None)
    team = Pick("What does the team say?", (no, *words))
    note = Write("Note (Enter for none):")
    name = Write("Referee's name:", missing="finalising needs the referee's name")
    questions: tuple[Question, ...] = (team, note) if referee else (team, note, name)
    return Ask(
        "Finalise the result",
        questions,
        lambda word, text, by=referee: Finalise(TeamWord(word), by, text),
    )


def ask_next_run(snapshot: Snapshot, setup: RunSetup) -> Act | Ask:
    """At once; asked first if the last result is not final."""
    run = snapshot.run
    if run.phase is not Phase.STOPPED or run.outcome is Outcome.ABORTED:
        return SetUp(setup)
    return Ask(
        "Next run",
        (Sure("The last result is not final: it stays as it is. Set up the next run?"),),
        lambda: SetUp(setup),
    )


def ask_leave(snapshot: Snapshot) -> Ask | Leave:
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
