"""How much evidence the results folder has, and how much more can be recorded."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from madrob_console.archive.evidence import evidence_held
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.runtime.disk import DiskJobs
from madrob_console.engine.runtime.disk_watch import RepeatedReading
from madrob_console.referee.evidence_state import EvidenceState

_PERIOD = 20.0
"""How often all runs are looked through, s."""

STEADY_FOR = 10.0
"""The room is that at the largest rate of this long, s: a rate just begins or ends."""


class EvidenceBudget:
    """Measures what is left of the budget of evidence, and how long that lasts."""

    def __init__(self, config: EngineConfig, reading: DiskJobs) -> None:
        self._config = config
        used = partial(evidence_held, config.results)
        self._used: RepeatedReading[int | None]
        self._used = RepeatedReading(used, reading.submit_job, _PERIOD, None)
        self._rates: list[tuple[float, float]] = []

    @property
    def left(self) -> int:
        """Bytes left of the budget; all of it until the runs were looked through."""
        plan = self._config.evidence
        return 0 if plan is None else max(0, plan.budget - (self._used.value or 0))

    def with_room(self, state: EvidenceState, free: int | None, now: float) -> EvidenceState:
        """The state with its room; `free` is in bytes, `now` in s since the epoch."""
        rate = state.byte_rate
        larger = [
            each for each in self._rates if abs(now - each[0]) < STEADY_FOR and each[1] > rate
        ]
        self._rates = [*larger, (now, rate)]
        if self._used.look(now) is None or free is None:
            return state
        room, most = max(0, min(self.left, free - self._config.disk_needed)), self._rates[0][1]
        return replace(state, room=room, lasts=room / most if most else None)
