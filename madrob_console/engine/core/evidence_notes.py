"""What a run's journal says of its evidence."""

from __future__ import annotations

import math
from collections.abc import Iterator

from madrob_console.common.formatting import listed
from madrob_console.engine.core.run_faults import FaultNotes
from madrob_console.referee.evidence_account import EvidenceGap, EvidenceStatus

PERIOD = 5.0
"""Topic faults are noted at most this often, s: many topics fail one after the other, and must not
hide the sensors' events.
"""


class EvidenceNotes:
    """What the journal says of one run's evidence.

    Gaps, and silences of topics, when they begin and when they end; each trouble of a topic once.
    """

    def __init__(self) -> None:
        self._faults = FaultNotes()
        self._told = -math.inf
        self._gaps: list[EvidenceGap] = []
        self._silent: dict[str, float] = {}

    def due(self, status: EvidenceStatus, start: float, now: float) -> list[str]:
        """What is to be noted now, in words; `start` of the run and `now` are s since the epoch."""
        return [
            *self._of_gaps(status, start),
            *self._of_silences(status, start),
            *self._of_topics(status, now),
        ]

    def _of_gaps(self, status: EvidenceStatus, start: float) -> Iterator[str]:
        known, self._gaps = self._gaps, list(status.gaps)
        for number, gap in enumerate(status.gaps):
            since = gap.since(start)
            if number >= len(known):
                yield f"nothing is recorded since {since.begin:+.1f} s: {gap.why}"
            if gap.end is not None and (number >= len(known) or known[number].end is None):
                yield f"recorded again, missing {since.words}"

    def _of_silences(self, status: EvidenceStatus, start: float) -> Iterator[str]:
        known, silent = self._silent, dict[str, float]()
        for one in status.recorded:
            if one.silent_since is not None:
                silent[one.topic] = one.silent_since
        if begun := [topic for topic in silent if topic not in known]:
            yield f"{listed(begun)}: silent since {silent[begun[0]] - start:+.1f} s"
        if back := [topic for topic in known if topic not in silent]:
            yield f"{listed(back)}: comes again, silent since {known[back[0]] - start:+.1f} s"
        self._silent = silent

    def _of_topics(self, status: EvidenceStatus, now: float) -> Iterator[str]:
        if 0 <= now - self._told < PERIOD:
            return
        topics: dict[str, list[str]] = {}
        for key in self._faults.due(status.troubles, now):
            topics.setdefault(status.troubles[key], []).append(key[0])
        if topics:
            self._told = now
        for words, names in topics.items():
            yield f"{listed(names)}: {words}"
