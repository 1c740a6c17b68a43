"""Set-ups for tests."""

from __future__ import annotations

from madrob_console.referee.run_setup import RunSetup
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose
from scoring.rulesets import RulesetName


def a_setup(run_number: int = 1) -> RunSetup:
    """Condition 1, as the screens propose it at first."""
    return RunSetup(
        subject=1,
        team="Door Bots",
        run_number=run_number,
        condition=Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW),
        start_pose=StartPose(1.5, 0.0, 180.0),
        referee="Ada",
        timeout=300.0,
        countdown=5.0,
        ruleset=RulesetName.PROTOCOL,
        lock_detection=LockDetection.AUTO,
    )
