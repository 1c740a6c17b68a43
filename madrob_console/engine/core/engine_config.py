"""What an engine is configured with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random

from madrob_console.common.version import software_version
from madrob_console.messages.mapping import TopicMapping
from madrob_console.referee.run_setup import Randomness, RunSetup
from madrob_console.referee.topic_health import SensorLimits
from scoring.protocol import Thresholds


@dataclass(frozen=True, slots=True)
class EngineConfig:
    """What an engine needs to know.

    Attributes:
        disk_needed: bytes that must be free before a start.
        lossless: wait for the disk instead of dropping messages (virtual time).
        usual_setup: gives a set-up the values of the settings, to compare it with.
        random: makes run identities without asking the system, because the core calls it.
    """

    results: Path
    mappings: tuple[TopicMapping, ...]
    disk_needed: int
    thresholds: Thresholds = field(default_factory=Thresholds)
    limits: SensorLimits = field(default_factory=SensorLimits)
    competition: str = ""
    testbed: str = ""
    version: str = field(default_factory=software_version)
    lossless: bool = False
    usual_setup: Callable[[RunSetup], RunSetup] = lambda setup: setup
    random: Randomness = field(default_factory=lambda: Random().randbytes)

    def limited(self) -> EngineConfig:
        """The same with a limit for the messages of each topic."""
        return replace(self, mappings=tuple(m.limited() for m in self.mappings))
