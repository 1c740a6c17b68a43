"""The pre-start checks."""

from __future__ import annotations

import weakref
from contextlib import suppress
from dataclasses import dataclass

from madrob_console.archive.folders import recording_problem
from madrob_console.common.files import OpenFolder, free_space
from madrob_console.engine.disk import RepeatedReading
from madrob_console.engine.replay import EngineContext
from madrob_console.engine.sensors import Sensors
from madrob_console.referee.checks import Check, EvidenceReading, Readings, preflight
from madrob_console.referee.competition_plan import NO_PLAN, Plan
from madrob_console.referee.lists import NO_TEAMS, TeamList
from madrob_console.referee.run import Phase, Run
from madrob_console.testbeds.source import Source

_DISK_PERIOD = 2.0


class PreStart:
    """Reads what the pre-start checks need."""

    def __init__(self, engine_context: EngineContext, sensors: Sensors) -> None:
        self._config = engine_context.config
        self._sensors = sensors
        self._evidence_client = engine_context.evidence_client
        self._room = engine_context.room
        self._starts_next = self._practice = False
        self._results: OpenFolder | None = None
        disk = engine_context.keepers.own  # whose silence is the disk's
        self._disk = RepeatedReading(
            self._look_at_disk, disk.submit_job, _DISK_PERIOD, _UNKNOWN, forgets=True
        )

    def checks(
        self,
        run: Run,
        source: Source,
        now: float,
        drift: float | None = None,
        teams: TeamList = NO_TEAMS,
        plan: Plan = NO_PLAN,
    ) -> tuple[Check, ...]:
        """`now` is s since the epoch; for `drift` (N) see `Readings`."""
        sensors, config = self._sensors, self._config
        self._starts_next = run.phase is Phase.READY
        self._practice = run.setup is not None and run.setup.practice
        force, disk = sensors.force(now), self._look(now)
        readings = Readings(
            topic_faults=sensors.topic_faults(source.status(), now),
            angle=sensors.angle(now),
            closed_angle=config.thresholds.closed_angle,
            near_zero=config.thresholds.near_zero,
            force=None if force is None else force - run.handle_zero,
            rest_force=config.thresholds.touch_force / 2,
            zero=run.zero_samples,
            drift=drift,
            occupied=sensors.occupied(now),
            skew=sensors.skew(now),
            least_skew=sensors.skew(now, min),
            simulated_time=source.announcement.simulated_time,
            largest_skew=config.thresholds.largest_skew,
            disk_free=disk.free,
            disk_needed=config.disk_needed,
            recorder_problem=disk.problem,
            other_referee=source.other_referee,
            evidence=self._evidence(disk.free, now),
            teams=teams,
            plan=plan,
            usual=None if run.setup is None else config.usual_setup(run.setup),
        )
        return preflight(readings, run)

    def _evidence(self, free: int | None, now: float) -> EvidenceReading | None:
        if (plan := self._config.evidence) is None:
            return None
        self._room.measure_room(now)
        status, left = self._evidence_client.status, self._room.left(free)
        return EvidenceReading(status, left, self.evidence_lasts(now), plan.least_room)

    def evidence_lasts(self, now: float) -> float | None:
        """How long evidence can be recorded at its recent rate, s; None = unknown."""
        status = self._evidence_client.status
        if status is None:
            return None
        return self._room.lasts(self.free_disk(now), status.byte_rate, now)

    def free_disk(self, now: float) -> int | None:
        """Bytes free for results; None = unknown, or no answer comes."""
        return self._look(now).free

    def _look(self, now: float) -> _Disk:
        return self._disk.look(now, (self._starts_next, self._practice))

    def _look_at_disk(self) -> _Disk:
        """In the thread of the disk: it may hang."""
        results = self._config.results
        problem = recording_problem(results, attempt=self._starts_next, practice=self._practice)
        return _Disk(free_space(results), problem or self._moved() or "")

    def _moved(self) -> str | None:
        """Whether the results folder is another one than before: it has other run numbers."""
        if self._results is not None and self._results.is_deleted:
            self._results = None
        if self._results is None:
            with suppress(OSError):  # there is none yet
                self._results = OpenFolder(self._config.results.resolve())
                weakref.finalize(self, self._results.close)
        if self._results is None:
            return None
        with suppress(OSError):  # else its words say why
            self._results.open_again()
        return self._results.problem()


@dataclass(frozen=True, slots=True)
class _Disk:
    free: int | None
    problem: str | None


_UNKNOWN = _Disk(None, None)
