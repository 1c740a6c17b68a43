"""Zero the handle."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Consequence, Situation
from madrob_console.referee.run import Phase, Run


@dataclass(frozen=True, slots=True)
class ZeroHandle(Act):
    """Take the mean handle force of the last second as zero (section 4)."""

    name = "zero the handle"
    phases = (Phase.IDLE, Phase.READY, Phase.FINAL)
    consequences = Consequence.HANDLE_ZERO

    @classmethod
    def hindrance(cls, situation: Situation) -> str | None:
        """Needs fresh handle data."""
        return "no fresh handle force" if situation.handle_mean is None else None

    def apply(self, situation: Situation, at: float) -> Run:
        """The handle zero is the mean."""
        assert situation.handle_mean is not None
        return replace(situation.run, handle_zero=situation.handle_mean)
