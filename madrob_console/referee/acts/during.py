"""Acts during and after a run: abort, timeout, incidents, rulings, notes, void."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.common.formatting import relative_text, seconds_of
from madrob_console.referee.acts.act import (
    LONGEST_TEXT,
    NO_REASON,
    NO_THE_RUN_GOES_ON,
    Act,
    Ask,
    Asked,
    Consequence,
    Option,
    Pick,
    RunView,
    Situation,
    Sure,
    Write,
    ask_why,
    meanwhile,
    reasons,
)
from madrob_console.referee.records import DecisionKind, Incident, IncidentKind, Note, Voiding
from madrob_console.referee.run import (
    Phase,
    Run,
    begin_countdown,
    changed,
    decide_false_starts,
    resume_countdown,
    stop,
    time_out,
)
from scoring.procedure import Ruling
from scoring.protocol import Outcome, Step

# Accept the false start: it may pass.


@dataclass(frozen=True, slots=True)
class AcceptFalseStart(Act):
    """Accept the false starts so far, with a reason; a held countdown goes on."""

    name = "accept the false start"
    phases = (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)
    missing = "accepting a false start needs a reason"
    title = "Accept the false start"
    done = "false start accepted"
    questions = (ask_why("nothing gained", "sensor false alarm", "caused by a person"),)
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        undecided = situation.run.undecided_false_start
        return "there is no false start to accept" if undecided is None else None

    def apply(self, situation: Situation, at: float) -> Run:
        return resume_countdown(decide_false_starts(situation.run, self.reason), at)


# A note beside the run.


@dataclass(frozen=True, slots=True)
class AddNote(Act):
    """Write a note beside the run."""

    name = "note"
    phases = tuple(phase for phase in Phase if phase is not Phase.IDLE)
    missing = "the note is empty"
    title = "Note"
    done = "note written"
    questions = (Write("Text:", missing=missing),)
    note: str

    def apply(self, situation: Situation, at: float) -> Run:
        run = situation.run
        return replace(run, notes=(*run.notes, Note(at, self.note)))


# Declare the timeout: the robot gave up.


@dataclass(frozen=True, slots=True)
class DeclareTimeout(Act):
    """The robot gave up: a valid timeout at this instant (section 8)."""

    name = "declare timeout"
    phases = (Phase.RUNNING,)
    title = "DECLARE TIMEOUT: the run ends now and stays valid"
    done = "timeout declared"
    questions = (
        meanwhile("the team gives up", "robot stuck", "robot stopped by itself"),
        Sure("Timeout now?"),
    )
    urgent = True
    reason: str = ""

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        if situation.run.timeout_at is None:
            return None
        return "the timeout is already there; a settle time is being waited for"

    def apply(self, situation: Situation, at: float) -> Run:
        """A running settle time may still complete the run."""
        return time_out(situation.run, at, self.reason or "declared by the referee")


# Mark an incident.


_LATEST = 86_400.0
"""s from the start; later events cannot concern the run."""

_NAMED = [kind for kind in IncidentKind if kind is not IncidentKind.OTHER]

_NOTE = "note"
_WHICH = Pick(
    "Which? It changes no indicator.",
    (
        *(Option(kind.value[0], kind.value, kind.value) for kind in _NAMED),
        Option("o", "other: type it", IncidentKind.OTHER),
        Option("n", "a note, no incident", _NOTE),
    ),
)
_WHAT = Write("What happened?", missing="say what happened")
_TIME = Write(
    "When? Seconds from the start of the run (12.5, 1:05; after its stop, too):",
    missing="its time is needed: the run has stopped",
)


@dataclass(frozen=True, slots=True)
class MarkIncident(Act):
    """Mark an incident now, or `after_start` s from the start (section 7)."""

    undoable = True
    name = "mark an incident"
    phases = (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)
    title = "Mark an incident"
    done = "incident marked: {act.kind}{act.when}"
    log = "incident: {act.kind}{act.when}"
    stands_out = True
    kind: IncidentKind
    note: str = ""
    after_start: float | None = None

    @classmethod
    def ask_questions(cls, view: RunView, pressed: str) -> Ask[Asked]:
        """A text typed during the run gets the time at which its kind was chosen."""
        stopped, now = view.run.phase is Phase.STOPPED, view.elapsed

        def chosen(word: str) -> Asked:
            if word == _NOTE:
                return AddNote.ask_questions(view, pressed)
            kind = IncidentKind(word)
            other = kind is IncidentKind.OTHER
            asked = (*((_WHAT,) if other else ()), *((_TIME,) if stopped else ()))
            if not asked:
                return cls(kind)

            def made(*typed: str) -> Act | str:
                after = seconds_of(typed[-1]) if stopped else now
                if after is None and stopped:
                    return f"{typed[-1]!r} is no time: 12.5, -3 or 1:05 is one"
                return cls(kind, typed[0] if other else "", after)

            return Ask(f"{cls.title}: {kind}", asked, made)

        title = f"{cls.title} {'of the run' if stopped else 'now'}"
        return Ask(title, (_WHICH,), chosen)

    def problem(self, situation: Situation) -> str | None:
        """The time must not be before the recording."""
        run, after = situation.run, self.after_start
        if after is None or run.start is None:
            return None
        began = (run.countdown_began or run.start) - run.start
        if began <= after < _LATEST:
            return None
        return f"{after:g} s from the start: the recording began at {began:.1f} s"

    def apply(self, situation: Situation, at: float) -> Run:
        run = situation.run
        if self.after_start is not None and run.start is not None:
            at = run.start + self.after_start
        mark = Incident(at, self.kind, self.note)
        return replace(
            run, decided=run.decided_and(DecisionKind.INCIDENT), incidents=(*run.incidents, mark)
        )

    @property
    def when(self) -> str:
        return "" if self.after_start is None else f" at {self.after_start:+.2f} s"


# Restart the countdown.


@dataclass(frozen=True, slots=True)
class RestartCountdown(Act):
    """Begin the countdown again after a false start."""

    name = "restart the countdown"
    phases = (Phase.COUNTDOWN,)
    title = "Restart the countdown"
    done = "the countdown begins again"
    questions = (ask_why("robot not ready", "person in the way", "testbed not ready"),)
    at_once = False
    consequences = Consequence.COUNTDOWN
    reason: str = "false start"

    @classmethod
    def ask_questions(cls, view: RunView, pressed: str) -> Act | Ask[Act]:
        if view.run.undecided_false_start is not None:
            return cls()
        return Ask(cls.title, cls.questions, cls)

    def apply(self, situation: Situation, at: float) -> Run:
        """Plans a new start; earlier false starts count as decided by the restart."""
        return begin_countdown(decide_false_starts(situation.run, "countdown restarted"), at)


# Rule on a step.


RULED = {True: "confirmed", False: "denied", None: "as the sensors say"}

_REASON = "reason"
_VERDICTS = {"confirm": True, "deny": False, "sensors": None}
_LOGGED = {True: "confirms", False: "denies", None: "takes back the ruling on"}
_WHY = ask_why(
    "seen by the referee", "sensor missed it", "sensor false alarm", "seen on video", "my mistake"
)


@dataclass(frozen=True, slots=True)
class Rule(Act):
    """Confirm or deny a step (section 7), or take that back. The latest ruling counts."""

    undoable = True
    name = "rule on a step"
    phases = (Phase.RUNNING, Phase.STOPPED)
    missing = "a ruling needs a reason"
    step: Step
    confirmed: bool | None
    reason: str

    @classmethod
    def ask_questions(cls, view: RunView, pressed: str) -> Ask[Asked]:
        return cls._ask_verdict(view, Step(int(pressed)), NO_REASON)

    @classmethod
    def _ask_verdict(cls, view: RunView, step: Step, reason: str) -> Ask[Asked]:
        record = next((record for record in view.steps if record.step is step), None)
        found = None if record is None else record.sensors
        sensors = "not done" if found is None else relative_text(found, view.run.start) + " s"
        verdict = Pick(
            f"Sensors: {sensors}. Referee: {_said(record.referee if record else None)}.",
            (
                Option("c", "confirm", "confirm"),
                Option("d", "deny", "deny"),
                Option("s", "as the sensors say", "sensors"),
                Option("r", "give a reason", _REASON),
            ),
        )
        title = f"Step {step}: {step.text}"

        def ruled(word: str) -> Asked:
            if word != _REASON:
                return cls(step, _VERDICTS[word], reason)
            return Ask(title, (_WHY,), lambda other: cls._ask_verdict(view, step, other))

        return Ask(f"{title} ({reason})", (verdict,), ruled)

    def apply(self, situation: Situation, at: float) -> Run:
        run = situation.run
        ruling = Ruling(self.step, self.confirmed, at, self.reason, run.referee)
        decided = run.decided_and(DecisionKind.RULING)
        return changed(replace(run, decided=decided, rulings=(*run.rulings, ruling)), at)

    @property
    def done_text(self) -> str:
        return f"step {self.step} {RULED[self.confirmed]}"

    @property
    def logged(self) -> str:
        return f"referee {_LOGGED[self.confirmed]} step {self.step}"


def _said(ruling: Ruling | None) -> str:
    if ruling is None:
        return "nothing yet"
    return f"{RULED[ruling.confirmed]} ({ruling.reason})"


# Void: a valid run counts nowhere.


_SURE = Sure("Void it? z takes it back.")


@dataclass(frozen=True, slots=True)
class Void(Act):
    """The run stays on record with its indicators and counts nowhere (section 2).

    A final result is opened again: the next issue gets a number, the old one stays.
    """

    name = "void"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = "voiding a run needs a reason"
    title = "VOID this run: it does not count"
    questions = (ask_why("robot unsafe", "testbed fault", "referee's mistake", "protest upheld"),)
    done = "the run is void, it does not count"
    log = "run voided"
    stands_out = True
    undoable = True
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        run = situation.run
        if run.voided is not None:
            return "the run is void already: that can be taken back"
        if run.outcome is Outcome.ABORTED:
            return "an aborted run is invalid already"
        return None if run.valid else "an interrupted run does not count anyway"

    @classmethod
    def instead_of_abort(cls, reason: str) -> Ask[Act]:
        title = f"The run was over before the abort ({reason}). {cls.title}"
        return Ask(title, (_SURE,), lambda: cls(reason))

    def apply(self, situation: Situation, at: float) -> Run:
        run = changed(self.opened_again(situation.run, at), at)
        voided = Voiding(at, self.reason, run.referee)
        return replace(run, decided=run.decided_and(DecisionKind.VOID), voided=voided)


@dataclass(frozen=True, slots=True)
class Abort(Act):
    """Interrupt the run: it is invalid (section 2). Wins over everything."""

    name = "abort"
    phases = (Phase.COUNTDOWN, Phase.RUNNING)
    title = "ABORT the run: it becomes invalid"
    done = "the run is aborted"
    questions = (
        Pick(
            "The run and its clock go on meanwhile. A reason first, or y at once.",
            (
                NO_THE_RUN_GOES_ON,
                Option("y", f"ABORT now, {NO_REASON}", NO_REASON, last=True),
                *reasons(
                    "robot unsafe", "testbed fault", "referee's mistake", "the team asks for it"
                ),
            ),
        ),
        Sure("Abort now?"),
    )
    urgent = True
    reason: str = ""

    def __post_init__(self) -> None:
        """Cuts a long reason: nothing refuses an abort."""
        object.__setattr__(self, "reason", self.reason[:LONGEST_TEXT])

    @classmethod
    def impossible(cls, situation: Situation) -> str | None:
        """A run that is over can be voided instead, if it counts."""
        refused = super(Abort, cls).impossible(situation)
        if refused is not None and Void.impossible(situation) is None:
            return f"{refused}: void it instead"
        return refused

    def apply(self, situation: Situation, at: float) -> Run:
        return stop(situation.run, Outcome.ABORTED, at, self.reason or "aborted by the referee")
