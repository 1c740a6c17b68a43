"""What a run's journal says of its evidence."""

from __future__ import annotations

import math
from collections.abc import Iterator

from madrob_console.common.formatting import listed
from madrob_console.engine.core.run_faults import FaultNotes
from madrob_console.referee.evidence_state import EvidenceState

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
        self._noted_at = -math.inf
        self._before = EvidenceState()

    def due(self, state: EvidenceState, start: float, now: float) -> list[str]:
        """What is to be noted now, in words; `start` of the run and `now` are s since the epoch."""
        before, self._before = self._before, state
        return [
            *_gaps(before, state, start),
            *_silences(before, state, start),
            *self._of_topics(state, now),
        ]

    def _of_topics(self, state: EvidenceState, now: float) -> Iterator[str]:
        if 0 <= now - self._noted_at < PERIOD:
            return
        topics: dict[str, list[str]] = {}
        for key in self._faults.due(state.troubles, now):
            topics.setdefault(state.troubles[key], []).append(key[0])
        if topics:
            self._noted_at = now
        for words, names in topics.items():
            yield f"{listed(names)}: {words}"


def _gaps(before: EvidenceState, state: EvidenceState, start: float) -> Iterator[str]:
    earlier = {gap.begin: gap for gap in before.gaps}
    for gap in state.gaps:
        since, noted = gap.since(start), earlier.get(gap.begin)
        if noted is None:
            yield f"nothing is recorded since {since.begin:+.1f} s: {gap.why}"
        if gap.end is not None and (noted is None or noted.end is None):
            yield f"recorded again, missing {since.words}"


def _silences(before: EvidenceState, state: EvidenceState, start: float) -> Iterator[str]:
    earlier, silent = before.silences, state.silences
    if begun := [topic for topic in silent if topic not in earlier]:
        yield f"{listed(begun)}: silent since {silent[begun[0]] - start:+.1f} s"
    if back := [topic for topic in earlier if topic not in silent]:
        yield f"{listed(back)}: comes again, silent since {earlier[back[0]] - start:+.1f} s"
