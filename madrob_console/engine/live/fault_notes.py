"""Which faults of the testbed stand in a run's journal and in its data quality."""

from __future__ import annotations

from collections.abc import Mapping

from madrob_console.engine.live.topic_watch import Trouble

LASTING = 0.5
"""A trouble that lasts this long is noted, s: not the wobble of a rate that is just beginning."""


class FaultNotes:
    """Each trouble of each topic is noted once a run."""

    def __init__(self) -> None:
        self._since: dict[tuple[str, Trouble], float] = {}
        self._noted: set[tuple[str, Trouble]] = set()

    def clear(self) -> None:
        """A new run."""
        self._since.clear()
        self._noted.clear()

    def due(self, troubles: Mapping[tuple[str, Trouble], str], now: float) -> list[tuple[str, str]]:
        """What is to be noted now: topics, and what is wrong with each in words.

        Args:
            troubles: what is wrong now, by topic and kind.
            now: s since the epoch.
        """
        self._since = {key: self._since.get(key, now) for key in troubles}
        due = [
            key
            for key, since in self._since.items()
            if key not in self._noted and abs(now - since) >= LASTING
        ]
        self._noted.update(due)
        return [(key[0], troubles[key]) for key in due]
