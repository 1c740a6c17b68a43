"""What the console proposes before the referee has typed anything."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from madrob_console.kinds import ThemeName
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose
from scoring.rulesets import RulesetName


@dataclass(frozen=True, slots=True)
class PosePreset:
    """A start pose with a name."""

    name: str
    pose: StartPose


POSE_PRESETS = (
    PosePreset("CCW, 1.5 m", StartPose(1.5, 0.0, 180.0)),
    PosePreset("CW, 1.5 m", StartPose(-1.5, 0.0, 0.0)),
)
"""One pose a side, in front of the door and facing it."""

FIRST_CONDITION = Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW)
"""Condition 1."""


@dataclass(frozen=True, slots=True)
class Look:
    """How the screens present themselves.

    Attributes:
        theme: of the colours.
        ascii: draw with ASCII characters only; None = find out from the environment.
        bell: ring the terminal's bell on start, stop and fault.
        mouse: let the terminal report the mouse.
    """

    theme: ThemeName = ThemeName.DARK
    ascii: bool | None = None
    bell: bool = True
    mouse: bool = True


@dataclass(frozen=True, slots=True)
class ConsoleDefaults:
    """The first run's proposal; later runs start from the one before.

    Attributes:
        competition: its name, for the top line.
        results: the folder in which the runs are stored.
        host: name of the machine, for the top line.
        best_runs: as many of a team's runs count in the standings; 0 = all.
        hint: what the first message says.
        problems: what is wrong with the teams file, one line each.
        subject, team, referee: who.
        teams: subject -> team's name, as far as known.
        condition: benchmark type, opening side and starting side.
        start_pose: None = the first preset of the starting side.
        poses: start poses to choose from.
        timeout, countdown: s.
        ruleset: which rules make the indicators.
        lock_detection: what decides step 6.
    """

    competition: str = ""
    results: Path = Path()
    host: str = ""
    best_runs: int = 0
    hint: str = "F1 lists the keys."
    problems: tuple[str, ...] = ()
    subject: int = 1
    team: str = ""
    referee: str = ""
    teams: Mapping[int, str] = field(default_factory=dict)
    condition: Condition = FIRST_CONDITION
    start_pose: StartPose | None = None
    poses: tuple[PosePreset, ...] = POSE_PRESETS
    timeout: float = 300.0
    countdown: float = 5.0
    ruleset: RulesetName = RulesetName.PROTOCOL
    lock_detection: LockDetection = LockDetection.AUTO

    def preset(self, side: Side) -> StartPose:
        """The first preset pose on `side`; the usual one if there is none."""
        for preset in (*self.poses, *POSE_PRESETS):
            if preset.pose.side is side:
                return preset.pose
        raise AssertionError("POSE_PRESETS has one for each side")
