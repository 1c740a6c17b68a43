"""What the console proposes before the referee has typed anything."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from madrob_console.config.tables import DEFAULT_START_POSES, RunDefaults, StartPoseSetting
from scoring.protocol import BenchmarkType, Condition, Side

FIRST_CONDITION = Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW)
"""Condition 1: what the first run's set-up proposes, for subject 1."""


@dataclass(frozen=True, slots=True)
class ConsoleDefaults:
    """The first run's proposal; later runs start from the one before.

    Attributes:
        competition: its name, for the top line.
        results: the folder in which the runs are stored.
        host: name of the machine, for the top line.
        best_runs: as many of a team's runs count in the standings; 0 = all.
        hint: what the first message says.
        team, referee: who.
        poses: start poses to choose from.
        run: timeout, countdown, ruleset and what decides step 6.
    """

    competition: str = ""
    results: Path = Path()
    host: str = ""
    best_runs: int = 0
    hint: str = "F1 lists the keys."
    team: str = ""
    referee: str = ""
    poses: tuple[StartPoseSetting, ...] = DEFAULT_START_POSES
    run: RunDefaults = field(default_factory=RunDefaults)
