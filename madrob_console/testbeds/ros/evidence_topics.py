"""The topics of the settings that are recorded beside the run, as bytes."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from functools import cache, partial
from types import TracebackType
from typing import Self

from madrob_console.testbeds.ros.connection import Connection
from madrob_console.testbeds.ros.intake import Intake
from madrob_console.testbeds.ros.subscriptions import arrival
from madrob_console.testbeds.ros.types import describe_installed, prefixes
from madrob_console.testbeds.ros.watches import console_name
from recorder.bag import Durability, RawMessage, Topic

DISCOVERY_PERIOD = 0.5
"""How often publishers are looked for, s."""

DEPTH = 100
"""Messages of a topic that DDS keeps between two takes: 3 s of a camera."""

SILENT_AFTER = 2.0
"""Seconds without a message after which a topic is silent."""

_MOST_AT_ONCE = 64
"""Messages of one topic in one take: a flood delays no other topic."""


class EvidenceTopics:
    """Subscriptions to topics in a ROS domain, as their publishers need them. One thread.

    Raises MadrobError where ROS does not start.
    """

    def __init__(self, domain: int, names: Sequence[str]) -> None:
        self._connection = Connection(domain)
        node = self._connection.node(console_name().replace("console", "evidence", 1), spun=False)
        describe = cache(partial(describe_installed, prefixes(os.environ)))
        self._intakes = [Intake(node, name, describe, depth=DEPTH) for name in names]
        self._next_discovery = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for intake in self._intakes:
            intake.close()
        self._connection.close()

    def take_messages(self, now_ns: int) -> list[RawMessage]:
        """Return what has arrived; `now_ns` is the steady time of now (protocol section 8)."""
        if time.monotonic() >= self._next_discovery:
            self._next_discovery = time.monotonic() + DISCOVERY_PERIOD
            for intake in self._intakes:
                intake.discover()
        wall = time.time_ns()
        messages = []
        for intake in self._intakes:
            for each in intake.take_messages(_MOST_AT_ONCE):
                at = arrival(each.received_ns, now_ns, wall)
                sequence = each.sequence or 0
                message = RawMessage(
                    intake.name, intake.type, each.data, each.source_ns, at, sequence
                )
                messages.append(message)
        return messages

    @property
    def topics(self) -> list[Topic]:
        """Those whose type is known, and installed here."""
        return [intake.topic for intake in self._intakes if intake.topic is not None]

    @property
    def kept_for_late(self) -> set[str]:
        """Names of topics whose publishers keep messages for late joiners: they may be silent."""
        latched = Durability.TRANSIENT_LOCAL
        return {topic.name for topic in self.topics if topic.qos.durability is latched}

    @property
    def problems(self) -> dict[str, str]:
        """Why topics cannot be recorded, in words, by name."""
        return {intake.name: intake.problem for intake in self._intakes if intake.problem}

    def lost(self) -> dict[str, int]:
        """Return the messages lost on the way, as far as sequence numbers or DDS tell, by name."""
        lost = {}
        for intake in self._intakes:
            numbered = intake.lost
            lost[intake.name] = intake.reported_lost if numbered is None else numbered
        return lost
