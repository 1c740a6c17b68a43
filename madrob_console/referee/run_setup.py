"""The set-up of a run, which is fixed before its start, and its identity (protocol section 2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated
from uuid import UUID

from msgspec import Meta

from scoring.indicator_table import RulesetName
from scoring.protocol import Condition, LockDetection, StartPose

Randomness = Callable[[int], bytes]

_MILLISECOND = 1_000_000  # ns


def new_run_id(now_ns: int, random: Randomness) -> str:
    """The identity of a new run: a UUID of version 7 (RFC 9562), sorted by time."""
    time = (now_ns // _MILLISECOND) % 2**48
    chance = int.from_bytes(random(10), "big") % 2**74
    number = time << 80 | 7 << 76 | (chance >> 62) << 64 | 0b10 << 62 | chance % 2**62
    return str(UUID(int=number))


_OF_SETTINGS = {
    "timeout": "timeout",
    "countdown": "countdown",
    "ruleset": "ruleset",
    "lock_detection": "lock by",
    "start_pose": "start pose",
}
"""What the settings say of every set-up, in words."""


def _setting(value: float | StrEnum | StartPose) -> str:
    match value:
        case StartPose(x, y, yaw):
            return f"{x:g} {y:g} {yaw:g}"
        case float():
            return f"{value:g} s"
    return str(value)


StoredRuleset = Annotated[str, Meta(pattern="^[a-z0-9-]{1,40}$(?!\n)")]
"""A name of rules, maybe of such as have gone."""


@dataclass(frozen=True, slots=True)
class RunSetup:
    """Everything set for a run before its start.

    Attributes:
        subject: the robot's number, 1 to 999.
        team: the team's name, cleaned.
        run_number: the repetition, 1 to 999.
        condition: what the robot has to do.
        start_pose: where the robot stands; on the starting side.
        referee: the referee's name, cleaned.
        timeout: s from the start.
        countdown: s before the start; the recording needs at least 1 s.
        ruleset: which rules make the indicators; of a stored run maybe one that has gone.
        lock_detection: what decides step 6 (protocol section 7).
        team_reason: why the team has another name than in the list of teams; empty = it has not.
        practice: it counts for nothing and stands apart from official runs (protocol section 2).
        out_of_plan: it was set up beyond the competition's plan.
        run_id: which run of all testbeds it is, a UUID. Set-ups that differ in nothing but
            this, `testbed` and `competition` are equal.
        testbed: the name of the testbed; likewise.
        competition: the name of the competition; likewise.
    """

    subject: int
    team: str
    run_number: int
    condition: Condition
    start_pose: StartPose
    referee: str
    timeout: float
    countdown: float
    ruleset: StoredRuleset
    lock_detection: LockDetection
    team_reason: str = ""
    practice: bool = False
    out_of_plan: bool = False
    run_id: str = field(default="", compare=False)
    testbed: str = field(default="", compare=False)
    competition: str = field(default="", compare=False)

    def differences(self, usual: RunSetup) -> Iterator[str]:
        """What differs from `usual`, a set-up as the settings have it."""
        for name, words in _OF_SETTINGS.items():
            here, there = getattr(self, name), getattr(usual, name)
            if here != there:
                yield f"{words} {_setting(here)}, the settings say {_setting(there)}"

    def problem(self) -> str | None:
        """Why a run cannot be set up like this, naming the field; None when it can."""
        if not 1 <= self.subject <= 999:
            return f"subject {self.subject}: use a number from 1 to 999"
        if not 1 <= self.run_number <= 999:
            return f"run number {self.run_number}: use a number from 1 to 999"
        pose = self.start_pose
        if not all(math.isfinite(value) for value in (pose.x, pose.y, pose.yaw)):
            return "start pose: x, y and yaw must be numbers"
        side = pose.side
        if side is not self.condition.starting_side:
            where = "on the threshold" if side is None else f"on the {side.upper()} side"
            wanted = self.condition.starting_side
            sign = "x > 0" if wanted.sign > 0 else "x < 0"
            return f"start pose lies {where}: it must lie on the {wanted.upper()} side ({sign})"
        if not 1.0 <= self.timeout <= 86400.0:
            return f"timeout {self.timeout:g} s: use 1 to 86400 s"
        if not 0.0 <= self.countdown <= 600.0:
            return f"countdown {self.countdown:g} s: use 0 to 600 s"
        if self.ruleset not in [*RulesetName]:
            return f"ruleset {self.ruleset}: use {' or '.join(RulesetName)}"
        return None
