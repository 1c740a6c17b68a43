"""How much evidence fits into the results folder."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial

from madrob_console.archive.evidence_held import evidence_held
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.live.reading import Reader

_PERIOD = 20.0
"""All runs are looked through this often, s."""

STEADY_FOR = 10.0
"""Room is told at the largest rate of so long, s: a rate that begins or ends says little."""


class EvidenceRoom:
    """Knows what there is, and what may still come.

    Args:
        config: the results folder and the budget.
        reading: looks through the runs.
    """

    def __init__(self, config: EngineConfig, reading: Reader) -> None:
        self._config = config
        self._reading = reading
        self._asked: float | None = None
        self._answered = True
        self._held: int | None = None
        self._rates: list[tuple[float, float]] = []

    def look(self, now: float) -> None:
        """Look through the runs now and then; nothing where no evidence is wanted.

        Args:
            now: s since the epoch.
        """
        if self._config.evidence is None:
            return
        if self._asked is None or not 0 <= now - self._asked < _PERIOD:
            self._asked = now
            if self._answered:
                self._answered = False
                self._reading.ask(partial(evidence_held, self._config.results), self._heard)

    def _heard(self, answer: Future[int]) -> None:
        self._answered = True
        self._held = None if answer.exception() else answer.result()

    @property
    def budget_left(self) -> int:
        """Bytes that the budget leaves; all of it while nobody knows what there is."""
        plan = self._config.evidence
        return 0 if plan is None else max(0, plan.budget - (self._held or 0))

    def left(self, free: int | None) -> int | None:
        """Bytes of evidence that can be recorded; None = not known.

        Args:
            free: on the disk, bytes; None = unknown.
        """
        if self._held is None or free is None:
            return None
        return max(0, min(self.budget_left, free - self._config.disk_needed))

    def lasts(self, free: int | None, byte_rate: float, now: float) -> float | None:
        """How long evidence can be recorded, s; None = not known, or nothing has come of late.

        Args:
            free: on the disk, bytes; None = unknown.
            byte_rate: of what comes now, bytes a second.
            now: s since the epoch.
        """
        known = [(at, rate) for at, rate in self._rates if abs(now - at) < STEADY_FOR]
        # what was less before says nothing any more
        self._rates = [*(one for one in known if one[1] > byte_rate), (now, byte_rate)]
        left, rate = self.left(free), self._rates[0][1]
        return left / rate if left is not None and rate else None
