"""What an engine works with."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.clock import Clock, seconds
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.live.evidence_room import EvidenceRoom
from madrob_console.engine.live.keeper import Keepers
from madrob_console.engine.live.replay import Replay
from madrob_console.engine.live.scorer import Scorer
from madrob_console.engine.live.witness import Witness
from madrob_console.messages.codec import MessageTypes
from madrob_console.testbeds.source import Source


@dataclass(frozen=True, slots=True, eq=False)
class Equipment:
    """What an engine was given, and all of its parts share.

    Attributes:
        source: the testbed.
        clock: steady time.
        config: what is to be known of testbed and results.
        types: the message types, shared with the source.
        replay: the recorded run that source and clock belong to; None = a live testbed.
        keepers: do what touches a file.
        scorer: makes the results.
        witness: records evidence.
        room: for evidence.
    """

    source: Source
    clock: Clock
    config: EngineConfig
    types: MessageTypes
    replay: Replay | None
    keepers: Keepers
    scorer: Scorer
    witness: Witness
    room: EvidenceRoom

    def now(self) -> float:
        """Steady time, s since the epoch."""
        return seconds(self.clock.now_ns())
