"""What an engine needs to know."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random

from madrob_console.engine.live.limits import SensorLimits
from madrob_console.engine.live.witness import EvidencePlan
from madrob_console.messages.codec import MessageTypes, TopicMapping
from madrob_console.referee.protests import USUAL_PROTEST_TIMES, ProtestTimes
from madrob_console.referee.run_identity import Randomness
from madrob_console.version import software_version
from scoring.protocol import Thresholds


@dataclass(frozen=True, slots=True)
class EngineConfig:
    """What an engine needs to know.

    Attributes:
        results: the results folder.
        mappings: which topic carries which signal.
        disk_needed: bytes that must be free before a start.
        thresholds: the testbed's numbers.
        limits: what counts as a healthy testbed.
        competition: its name.
        testbed: the testbed's name; empty = it has none.
        protest_times: the competition's deadlines for protests.
        version: of the software.
        evidence: how much of it may be recorded; None = none is wanted.
        lossless: wait for the disk instead of dropping messages (virtual time).
        random: tells the identity of a run from all others; asks the system for nothing, for the
            core does.
    """

    results: Path
    mappings: tuple[TopicMapping, ...]
    disk_needed: int
    thresholds: Thresholds = field(default_factory=Thresholds)
    limits: SensorLimits = field(default_factory=SensorLimits)
    competition: str = ""
    testbed: str = ""
    protest_times: ProtestTimes = USUAL_PROTEST_TIMES
    version: str = field(default_factory=software_version)
    evidence: EvidencePlan | None = None
    lossless: bool = False
    random: Randomness = field(default_factory=lambda: Random().randbytes)

    def limited(self, types: MessageTypes) -> EngineConfig:
        """The same with a limit for the messages of each topic."""
        return replace(self, mappings=tuple(m.limited(types) for m in self.mappings))
