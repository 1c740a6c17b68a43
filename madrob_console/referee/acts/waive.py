"""Waive a check: it may fail in this run."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, RunView, Situation
from madrob_console.referee.on_record import CheckName, DecisionKind, Waiver
from madrob_console.referee.preflight import blocking
from madrob_console.referee.questions import Ask, Option, Pick, reasons
from madrob_console.referee.run import Phase, Run

_NONE_FAILS = "no check fails"
_WHY = Pick(
    "Why may it pass?", reasons("checked by hand", "known testbed fault", "the organiser agrees")
)


@dataclass(frozen=True, slots=True)
class Waive(Act):
    """Let a failed check pass for this run."""

    name = "waive a check"
    phases = (Phase.READY,)
    missing = "a waiver needs a reason"
    check: CheckName
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Some check must fail."""
        return None if blocking(situation.checks) else _NONE_FAILS

    def problem(self, situation: Situation) -> str | None:
        """It is for a check that fails."""
        return _passes(self.check, situation)

    @classmethod
    def ask(cls, view: RunView, pressed: str) -> Ask[Act] | str:
        """Which failing check, and why."""
        blocks = blocking(view.checks)
        failing = [check.name for check in blocks if check.waivable or len(blocks) == 1]
        if len(failing) < 2:
            return cls.ask_why(view, failing[0]) if failing else _NONE_FAILS
        which = tuple(Option(str(i), str(name), str(name)) for i, name in enumerate(failing, 1))
        return Ask(
            "Waive a failing check for this run",
            (Pick("Which?", which), _WHY),
            lambda name, reason: cls(CheckName(name), reason),
        )

    @classmethod
    def ask_why(cls, view: RunView, check: CheckName) -> Ask[Act] | str:
        """Why this check may pass."""
        if refused := _passes(check, view):
            return refused
        title = f"Waive '{check}' for this run"
        return Ask(title, (_WHY,), lambda reason: cls(check, reason))

    def apply(self, situation: Situation, at: float) -> Run:
        """One more waiver."""
        run = situation.run
        waiver = Waiver(self.check, self.reason, run.referee, at)
        return replace(
            run, decided=run.decided_and(DecisionKind.WAIVER), waivers=(*run.waivers, waiver)
        )

    @property
    def done(self) -> str:
        """Which check."""
        return f"'{self.check}' waived"

    @property
    def logged(self) -> str:
        """Which check."""
        return f"check waived: {self.check}"


def _passes(check: CheckName, where: Situation | RunView) -> str | None:
    found = next((found for found in blocking(where.checks) if found.name is check), None)
    if found is None:
        return f"the check '{check}' does not fail"
    return None if found.waivable else f"the check '{check}' cannot be waived: {found.reason}"
