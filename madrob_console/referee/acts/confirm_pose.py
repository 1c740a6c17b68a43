"""Confirm the start pose: the robot stands there."""

from __future__ import annotations

from dataclasses import dataclass, replace

from madrob_console.referee.acts.act import Act, Situation
from madrob_console.referee.run import Phase, Run


@dataclass(frozen=True, slots=True)
class ConfirmPose(Act):
    """The referee saw the robot standing at its start pose."""

    name = "confirm the start pose"
    phases = (Phase.READY,)

    def apply(self, situation: Situation, at: float) -> Run:
        """The pose is confirmed."""
        return replace(situation.run, pose_confirmed=True)
