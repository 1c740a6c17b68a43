"""Zero the handle."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Consequence, Situation
from madrob_console.referee.run import Phase, Run
from scoring.rest import HandleRest


@dataclass(frozen=True, slots=True)
class ZeroHandle(Act):
    """Take the mean handle force of the last second as zero (protocol sections 4 and 11).

    Attributes:
        samples: those behind it, which the engine measures; None before that, and in journals of
            earlier versions.
    """

    name = "zero the handle"
    phases = (Phase.IDLE, Phase.READY, Phase.FINAL)
    consequences = Consequence.HANDLE_ZERO

    samples: HandleRest | None = None

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Needs fresh handle data, of a handle that nobody moves."""
        rest = situation.handle_rest
        if rest is None:
            return "no fresh handle force"
        moves = rest.deviation > situation.rest_force
        return "the handle force is not steady: let go of it, wait a second" if moves else None

    def settled(self, situation: Situation) -> Act:
        """With the samples of the last second, whoever asks."""
        return ZeroHandle(situation.handle_rest)

    def apply(self, situation: Situation, at: float) -> Run:
        """The handle zero is their mean; that of a line without them is stored with the run."""
        samples, run = self.samples, situation.run
        if samples is None:
            return run
        return replace(run, handle_zero=samples.mean, zero_samples=samples)

    @property
    def logged(self) -> str:
        """What the samples say."""
        found = self.samples
        return self.name if found is None else f"{self.name}: {found.mean:.3f} N, {found.scatter}"
