"""Mark an incident."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Asked, RunView, Situation
from madrob_console.referee.on_record import DecisionKind, Incident, IncidentKind
from madrob_console.referee.questions import Ask, Option, Pick, Write
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_times import seconds_of

_LATEST = 86_400.0
"""Nothing that happens later than this has to do with the run, s from its start."""

_NAMED = [kind for kind in IncidentKind if kind is not IncidentKind.OTHER]

_WHICH = Pick(
    "Which? It changes no indicator; n adds a note later.",
    (
        *(Option(kind.value[0], kind.value, kind.value) for kind in _NAMED),
        Option("o", "other: type it", IncidentKind.OTHER),
    ),
)
_WHAT = Write("What happened?", missing="say what happened")
_TIME = Write(
    "When? Seconds from the start of the run (12.5, 1:05; after its stop, too):",
    missing="its time is needed: the run has stopped",
)


@dataclass(frozen=True, slots=True)
class MarkIncident(Act):
    """Mark an incident, at this instant or after the start that is named (section 7).

    Attributes:
        kind: what happened.
        note: of the referee.
        after_start: when, s from the start; null = now.
    """

    name = "mark an incident"
    phases = (Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED)
    title = "Mark an incident"
    stands_out = True
    kind: IncidentKind
    note: str = ""
    after_start: float | None = None

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Ask[Asked]:
        """Which kind: the second key marks it; what another was is typed, and when after the stop.

        What is typed while the run goes on counts from when its kind was chosen.
        """
        stopped, now = view.run.phase is Phase.STOPPED, view.elapsed

        def chosen(kind: IncidentKind) -> Asked:
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
        return Ask(title, (_WHICH,), lambda word: chosen(IncidentKind(word)))

    def problem(self, situation: Situation) -> str | None:
        """A time is one of the recording, or later."""
        run, after = situation.run, self.after_start
        if after is None or run.start is None:
            return None
        began = (run.countdown_began or run.start) - run.start
        if began <= after < _LATEST:
            return None
        return f"{after:g} s from the start: the recording began at {began:.1f} s"

    def apply(self, situation: Situation, at: float) -> Run:
        """One more incident."""
        run = situation.run
        if self.after_start is not None and run.start is not None:
            at = run.start + self.after_start
        mark = Incident(at, self.kind, self.note)
        return replace(
            run, decided=run.decided_and(DecisionKind.INCIDENT), incidents=(*run.incidents, mark)
        )

    @property
    def done(self) -> str:
        """Which kind, and when."""
        return f"{self.kind} marked{self._when}"

    @property
    def logged(self) -> str:
        """Which kind, and when."""
        return f"incident: {self.kind}{self._when}"

    @property
    def _when(self) -> str:
        return "" if self.after_start is None else f" at {self.after_start:+.2f} s"
