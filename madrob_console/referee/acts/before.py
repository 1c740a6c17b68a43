"""Acts before a start: set-up, pose, zero, waivers, start."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Consequence, Situation
from madrob_console.referee.checks import Check, blocking, causes
from madrob_console.referee.records import CheckName, DecisionKind, Waiver
from madrob_console.referee.run import Phase, Run, begin_countdown
from madrob_console.referee.run_setup import RunSetup
from scoring.rest import HandleRest


@dataclass(frozen=True, slots=True)
class SetUp(Act):
    """Set up the next run. A form asks for the set-up, not a dialog."""

    name = "set up"
    phases = (Phase.IDLE, Phase.READY, Phase.STOPPED, Phase.FINAL)
    consequences = Consequence.NEW_RUN
    setup: RunSetup

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Not before the result of the last run is written, if it can be."""
        over = situation.run.phase in (Phase.STOPPED, Phase.FINAL)
        if over and not (situation.scored or situation.hopeless):
            return "the result of the last run is being written"
        return None

    def problem(self, situation: Situation) -> str | None:
        return self.setup.problem() or situation.teams.problem(self.setup)

    def settled(self, situation: Situation) -> Act:
        """Adds the identity and whether it is practice (protocol section 2)."""
        practice = self.setup.practice or situation.only_practice
        return SetUp(
            replace(
                self.setup,
                practice=practice,
                run_id=situation.new_id(),
                testbed=situation.testbed,
                competition=situation.competition,
            )
        )

    def apply(self, situation: Situation, at: float) -> Run:
        return replace(situation.run.cleared, phase=Phase.READY, setup=self.setup)

    @property
    def reason_given(self) -> str:
        return self.setup.team_reason

    @property
    def done_text(self) -> str:
        kind = "practice run" if self.setup.practice else "run"
        return f"{kind} {self.setup.run_number} of subject {self.setup.subject} is set up"


@dataclass(frozen=True, slots=True)
class ConfirmPose(Act):
    """Confirm that the robot stands at its start pose."""

    name = "confirm the start pose"
    done = "start pose confirmed"
    phases = (Phase.READY,)

    def apply(self, situation: Situation, at: float) -> Run:
        return replace(situation.run, pose_confirmed=True)


@dataclass(frozen=True, slots=True)
class Start(Act):
    """Open the recording and begin the countdown."""

    name = "start"
    done = "the countdown begins"
    phases = (Phase.READY,)
    at_once = False
    consequences = Consequence.RECORDING | Consequence.COUNTDOWN

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        setup = situation.run.setup
        if situation.only_practice and setup is not None and not setup.practice:
            return "the testbed is simulated, a run on it is practice: set it up again"
        blocks = causes(situation.checks)
        if not blocks:
            return None
        more = f" (and {len(blocks) - 1} more)" if len(blocks) > 1 else ""
        return f"{blocks[0].reason}{more}"

    def apply(self, situation: Situation, at: float) -> Run:
        return begin_countdown(situation.run, at)


NO_CHECK_FAILS = "no check fails"


@dataclass(frozen=True, slots=True)
class Waive(Act):
    """Let a failed check pass for this run."""

    undoable = True
    name = "waive a check"
    phases = (Phase.READY,)
    missing = "a waiver needs a reason"
    done = log = "check waived: {act.check}"
    check: CheckName
    reason: str

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        return None if blocking(situation.checks) else NO_CHECK_FAILS

    def problem(self, situation: Situation) -> str | None:
        return waiver_problem(self.check, situation.checks)

    def apply(self, situation: Situation, at: float) -> Run:
        run = situation.run
        waiver = Waiver(self.check, self.reason, run.referee, at)
        return replace(
            run, decided=run.decided_and(DecisionKind.WAIVER), waivers=(*run.waivers, waiver)
        )


def waiver_problem(name: CheckName, checks: Iterable[Check]) -> str | None:
    """Why the check of that name cannot be waived; None = it can."""
    check = next((check for check in blocking(checks) if check.name is name), None)
    if check is None:
        return f"the check '{name}' does not fail"
    return None if check.waivable else f"the check '{name}' cannot be waived: {check.reason}"


@dataclass(frozen=True, slots=True)
class ZeroHandle(Act):
    """Take the mean handle force of the last second as zero (protocol sections 4 and 11).

    The engine adds the `samples`.
    """

    name = "zero the handle"
    done = "handle zeroed"
    phases = (Phase.IDLE, Phase.READY, Phase.FINAL)
    consequences = Consequence.HANDLE_ZERO

    samples: HandleRest | None = None

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        rest = situation.handle_rest
        if rest is None:
            return "no handle force comes now"
        moves = rest.deviation > situation.rest_force
        return "the handle force is not steady: let go of it, wait a second" if moves else None

    def settled(self, situation: Situation) -> Act:
        return ZeroHandle(situation.handle_rest)

    def apply(self, situation: Situation, at: float) -> Run:
        """Sets their mean; without samples the zero stays."""
        samples, run = self.samples, situation.run
        if samples is None:
            return run
        return replace(run, handle_zero=samples.mean, zero_samples=samples)

    @property
    def logged(self) -> str:
        rest = self.samples
        return self.name if rest is None else f"{self.name}: {rest.mean:.3f} N, {rest.scatter}"
