"""Correct: what was set up wrongly is put right after the stop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from madrob_console.errors import MadrobError
from madrob_console.names import clean_name
from madrob_console.referee.acts.act import Act, Asked, RunView, Situation
from madrob_console.referee.on_record import Correction, DecisionKind
from madrob_console.referee.questions import Ask, Option, Pick, Sure, Write, reasons
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.teams import TeamList
from madrob_console.referee.transitions import changed
from scoring.protocol import BenchmarkType, Condition

_NO_RUN = "no run is set up yet"
_WHY = Pick("Why?", reasons("typed wrongly", "the set-up of the run before was kept"))


@dataclass(frozen=True, slots=True)
class Correct(Act):
    """Correct subject, sides or benchmark type; the run is scored again (section 2).

    The folder keeps its name. In another series (subject and condition) the run has a number of
    that series: the one that it had there before, else the next that was never used. A final
    result is opened again by that.

    Attributes:
        subject, condition: as they should have been set.
        reason: why.
        team: the name of another subject, which the engine takes from the list of teams.
        run_number: given out by the engine; 0 = not yet.
    """

    name = "correct"
    phases = (Phase.STOPPED, Phase.FINAL)
    at_once = False
    missing = "a correction needs a reason"
    stands_out = True
    subject: int
    condition: Condition
    reason: str
    team: str = ""
    run_number: int = 0

    def problem(self, situation: Situation) -> str | None:
        """Something is to be corrected, and the result is there."""
        setup = situation.run.setup
        if setup is None:
            return _NO_RUN
        if (self.subject, self.condition) == (setup.subject, setup.condition):
            return "that is what is set up"
        return self._corrected(setup, 1).problem() or (
            None if situation.scored else "the result is being written"
        )

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Ask[Asked] | str:
        """What was wrong; then the right value, and why."""
        setup = view.run.setup
        if setup is None:
            return _NO_RUN
        condition = setup.condition
        opening, starting = condition.opening_side, condition.starting_side
        types = [kind for kind in BenchmarkType if kind is not condition.benchmark_type]
        found: dict[str, Condition] = {
            "opening": replace(condition, opening_side=opening.opposite),
            "starting": replace(condition, starting_side=starting.opposite),
            **{kind.value: replace(condition, benchmark_type=kind) for kind in types},
        }
        options = (
            Option("s", f"subject: it is not {setup.subject}", "subject"),
            Option("o", f"opening side: it is {opening.opposite.upper()}", "opening"),
            Option("t", f"starting side: it is {starting.opposite.upper()}", "starting"),
            *(Option(str(n), f"type: it is {kind}", kind.value) for n, kind in enumerate(types, 1)),
        )

        def right(what: str) -> Ask[Asked]:
            if what == "subject":
                return cls._ask_subject(setup, view.teams)
            after = replace(setup, condition=found[what])
            return Ask(
                f"Correct the {corrected_words(setup, after)}",
                (_WHY, _sure(after)),
                lambda reason: cls(setup.subject, found[what], reason),
            )

        title = "Correct what was set up: the run is scored again"
        return Ask(title, (Pick("What was wrong? Its folder keeps its name.", options),), right)

    @classmethod
    def _ask_subject(cls, setup: RunSetup, teams: TeamList) -> Ask[Asked]:
        """The number; then whose it is, and why."""

        def right(text: str) -> Asked:
            if not (text.isascii() and text.isdigit() and len(text) < 4):
                return f"subject '{text[:20]}': use a number from 1 to 999"
            number, title = int(text), f"Correct the {_subject_words(setup.subject, int(text))}"
            if teams.names:
                listed = teams.names.get(number, "which is not in the list of teams!")
                return Ask(
                    f"{title}, {listed}",
                    (_WHY, _sure(setup)),
                    lambda reason: cls(number, setup.condition, reason),
                )

            def named(name: str, reason: str) -> Act | str:
                try:
                    return cls(number, setup.condition, reason, clean_name(name, "team"))
                except MadrobError as error:
                    return str(error)

            return Ask(title, (Write("Team (Enter for no name):"), _WHY, _sure(setup)), named)

        return Ask(
            f"Correct the subject, which is {setup.subject}",
            (Write("Subject:", missing="a number is needed"),),
            right,
        )

    def numbered(self, number: int) -> Correct:
        """With the run number that it got."""
        return replace(self, run_number=number)

    def named(self, situation: Situation) -> Correct:
        """With the team's name as it is in the list."""
        return replace(self, team=situation.teams.names.get(self.subject, self.team))

    def _corrected(self, setup: RunSetup, number: int) -> RunSetup:
        pose = setup.start_pose
        if pose.side is not self.condition.starting_side:
            pose = pose.mirrored
        after = replace(setup, run_number=number, condition=self.condition, start_pose=pose)
        if self.subject == setup.subject:
            return after
        return replace(after, subject=self.subject, team=self.team, team_reason="")

    def apply(self, situation: Situation, at: float) -> Run:
        """Set up as it should have been."""
        run = changed(self.opened_again(situation.run, at), at)
        setup = run.setup
        if setup is None:
            raise ValueError(_NO_RUN)
        corrected = self._corrected(setup, self.run_number)
        words = corrected_words(setup, corrected)
        correction = Correction(at, self.reason, run.referee, words, setup)
        return replace(
            run,
            decided=run.decided_and(DecisionKind.CORRECTION),
            setup=corrected,
            corrections=(*run.corrections, correction),
        )

    @property
    def done(self) -> str:
        """As which run it counts."""
        number = f", run {self.run_number}" if self.run_number else ""
        return f"corrected to subject {self.subject}, condition {self.condition.number}{number}"

    @property
    def logged(self) -> str:
        """As which run it counts."""
        return self.done


def corrected_words(before: RunSetup, after: RunSetup) -> str:
    """What a correction changed: `starting side from CCW to CW`."""
    return ", ".join(_changes(before, after)) or "set-up"


def _changes(before: RunSetup, after: RunSetup) -> Iterator[str]:
    if before.subject != after.subject:
        yield _subject_words(before.subject, after.subject)
    old, new = before.condition, after.condition
    if old.opening_side is not new.opening_side:
        yield f"opening side from {old.opening_side.upper()} to {new.opening_side.upper()}"
    if old.starting_side is not new.starting_side:
        yield f"starting side from {old.starting_side.upper()} to {new.starting_side.upper()}"
    if old.benchmark_type is not new.benchmark_type:
        yield f"benchmark type from {old.benchmark_type} to {new.benchmark_type}"


def _subject_words(before: int, after: int) -> str:
    return f"subject from {before} to {after}"


def _sure(after: RunSetup) -> Sure:
    number = after.condition.number
    return Sure(
        f"Correct it? It gets a run number of the right subject in condition {number}, and can be"
        " taken back."
    )
