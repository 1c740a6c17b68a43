"""What of the evidence's troubles stands in a run's journal."""

from __future__ import annotations

import math
from collections.abc import Iterator

from madrob_console.engine.live.fault_notes import FaultNotes
from madrob_console.engine.live.witness import WitnessStatus

PERIOD = 5.0
"""What topics lack is told so often at most, s: many lack the same one after the other, and the
sensors' events shall be seen among it."""

_NAMED = 2


class EvidenceNotes:
    """Of one run: each gap when it begins and when it ends, each trouble of a topic once."""

    def __init__(self) -> None:
        self._faults = FaultNotes()
        self._told = -math.inf
        self._begun = self._over = 0

    def due(self, status: WitnessStatus, start: float, now: float) -> list[str]:
        """What is to be noted now, in words.

        Args:
            status: of the evidence.
            start: of the run, s since the epoch.
            now: s since the epoch.
        """
        return [*self._of_gaps(status, start), *self._of_topics(status, now)]

    def _of_gaps(self, status: WitnessStatus, start: float) -> Iterator[str]:
        for gap in status.gaps[self._begun :]:
            self._begun += 1
            yield f"nothing is recorded since {gap.since(start).begin:+.1f} s: {gap.why}"
        for gap in status.gaps[self._over :]:
            if gap.end is None:
                return
            self._over += 1
            yield f"recorded again, missing {gap.since(start).words}"

    def _of_topics(self, status: WitnessStatus, now: float) -> Iterator[str]:
        if 0 <= now - self._told < PERIOD:
            return
        topics: dict[str, list[str]] = {}
        for topic, words in self._faults.due(status.troubles, now):
            topics.setdefault(words, []).append(topic)
        if topics:
            self._told = now
        for words, names in topics.items():
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            yield f"{', '.join(names[:_NAMED])}{more}: {words}"
