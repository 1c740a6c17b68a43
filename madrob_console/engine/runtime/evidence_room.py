"""How much evidence the results folder has, and how much more can be recorded."""

from __future__ import annotations

from functools import partial

from madrob_console.archive.evidence import evidence_held
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.runtime.disk import DiskJobs
from madrob_console.engine.runtime.disk_watch import RepeatedReading

_PERIOD = 20.0
"""How often all runs are looked through, s."""

STEADY_FOR = 10.0
"""Room is told at the largest rate of this long, s: a rate that begins or ends says little."""


class EvidenceRoom:
    """Tells how much evidence there is, and how much more can be recorded."""

    def __init__(self, config: EngineConfig, reading: DiskJobs) -> None:
        self._config = config
        look = partial(evidence_held, config.results)
        self._held: RepeatedReading[int | None]
        self._held = RepeatedReading(look, reading.submit_job, _PERIOD, None)
        self._rates: list[tuple[float, float]] = []

    def measure_room(self, now: float) -> None:
        if self._config.evidence is not None:
            self._held.look(now)

    @property
    def budget_left(self) -> int:
        """Bytes left of the budget; all of it until the runs were looked through."""
        plan = self._config.evidence
        return 0 if plan is None else max(0, plan.budget - (self._held.value or 0))

    def left(self, free: int | None) -> int | None:
        """Bytes of evidence that can be recorded; None = unknown. `free` is in bytes."""
        if self._held.value is None or free is None:
            return None
        return max(0, min(self.budget_left, free - self._config.disk_needed))

    def lasts(self, free: int | None, byte_rate: float, now: float) -> float | None:
        """How long evidence can be recorded, s; None = unknown, or nothing has come lately.

        `free` is in bytes, `byte_rate` in bytes a second, `now` in s since the epoch.
        """
        known = [(at, rate) for at, rate in self._rates if abs(now - at) < STEADY_FOR]
        # what was less before says nothing any more
        self._rates = [*(one for one in known if one[1] > byte_rate), (now, byte_rate)]
        left, rate = self.left(free), self._rates[0][1]
        return left / rate if left is not None and rate else None
