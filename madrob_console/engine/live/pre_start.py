"""What the pre-start checks are judged by: the sensors, the disk, the engine's limits."""

from __future__ import annotations

from collections.abc import Sequence

from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.live.sensors import Sensors
from madrob_console.files.whole import free_space
from madrob_console.referee.preflight import Check, Readings, preflight
from madrob_console.referee.run import Run
from madrob_console.testbeds.source import TopicStatus

_DISK_PERIOD = 2.0


class PreStart:
    """Reads what the checks need.

    Args:
        config: limits and the results folder.
        sensors: the testbed as it is now.
    """

    def __init__(self, config: EngineConfig, sensors: Sensors) -> None:
        self._config = config
        self._sensors = sensors
        self._disk_free: int | None = None
        self._disk_asked: float | None = None

    def checks(self, run: Run, status: Sequence[TopicStatus], now: float) -> tuple[Check, ...]:
        """The pre-start checks at `now`, s since the epoch."""
        sensors, config = self._sensors, self._config
        force = sensors.force(now)
        readings = Readings(
            topic_problems=sensors.topic_problems(status, now),
            angle=sensors.angle(now),
            closed_angle=config.thresholds.closed_angle,
            force=None if force is None else force - run.handle_zero,
            rest_force=config.thresholds.touch_force / 2,
            occupied=sensors.occupied(now),
            skew=sensors.skew(now),
            largest_skew=config.thresholds.largest_skew,
            disk_free=self.free_disk(now),
            disk_needed=config.disk_needed,
            recorder_problem=None,
        )
        return preflight(readings, run)

    def free_disk(self, now: float) -> int | None:
        """Bytes free for results, asked every other second; None = unknown."""
        if self._disk_asked is None or not 0 <= now - self._disk_asked < _DISK_PERIOD:
            self._disk_free = free_space(self._config.results)
            self._disk_asked = now
        return self._disk_free
