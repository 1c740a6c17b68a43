"""What of the evidence's troubles stands in a run's journal."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping

from madrob_console.engine.live.fault_notes import FaultNotes
from madrob_console.engine.live.witness import WitnessStatus, first_words, silent_since
from madrob_console.referee.amounts import listed

PERIOD = 5.0
"""What topics lack is told so often at most, s: many lack the same one after the other, and the
sensors' events shall be seen among it."""


class EvidenceNotes:
    """What is told of one run.

    Gaps, and silences of topics, when they begin and when they end; the first message of a topic
    that appears late; each trouble of a topic once.
    """

    def __init__(self) -> None:
        self._faults = FaultNotes()
        self._told = -math.inf
        self._begun = self._over = 0
        self._silences: Counter[str] = Counter()
        self._back: Counter[str] = Counter()
        self._appeared: set[str] = set()

    def due(self, status: WitnessStatus, start: float, now: float) -> list[str]:
        """What is to be noted now, in words.

        Args:
            status: of the evidence.
            start: of the run, s since the epoch.
            now: s since the epoch.
        """
        return [
            *self._of_gaps(status, start),
            *self._of_silences(status, start),
            *self._of_topics(status, now),
        ]

    def _of_gaps(self, status: WitnessStatus, start: float) -> Iterator[str]:
        for gap in status.gaps[self._begun :]:
            self._begun += 1
            yield f"nothing is recorded since {gap.since(start).begin:+.1f} s: {gap.why}"
        for gap in status.gaps[self._over :]:
            if gap.end is None:
                return
            self._over += 1
            yield f"recorded again, missing {gap.since(start).words}"

    def _of_silences(self, status: WitnessStatus, start: float) -> Iterator[str]:
        """Which topics come late, fall silent or come again; of several at once when the first."""
        late = [topic for topic in status.appeared if topic not in self._appeared]
        self._appeared.update(late)
        told = {topic: first_words(status.appeared[topic], start) for topic in late}
        yield from _in_a_line({topic: words for topic, words in told.items() if words})
        silent: dict[str, str] = {}
        back: dict[str, str] = {}
        for topic, pauses in status.pauses.items():
            over = sum(pause.end is not None for pause in pauses)
            if over > self._back[topic]:
                back[topic] = f"comes again, silent {pauses[over - 1].since(start).words}"
            elif len(pauses) > max(over, self._silences[topic]):
                silent[topic] = silent_since(pauses[-1], start)
            self._silences[topic], self._back[topic] = len(pauses), max(over, self._back[topic])
        yield from _in_a_line(silent)
        yield from _in_a_line(back)

    def _of_topics(self, status: WitnessStatus, now: float) -> Iterator[str]:
        if 0 <= now - self._told < PERIOD:
            return
        topics: dict[str, list[str]] = {}
        for topic, words in self._faults.due(status.troubles, now):
            topics.setdefault(words, []).append(topic)
        if topics:
            self._told = now
        for words, names in topics.items():
            yield f"{listed(names)}: {words}"


def _in_a_line(words: Mapping[str, str]) -> Iterator[str]:
    """What is said of each of some topics, as it is said of the first; none where there is none."""
    if words:
        yield f"{listed(list(words))}: {next(iter(words.values()))}"
