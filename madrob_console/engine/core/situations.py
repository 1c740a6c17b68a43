"""What an act is judged against: the run, its result, and the pre-start checks."""

from __future__ import annotations

from functools import partial

from madrob_console.engine.core.current_run import CurrentRun
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.core.now import Now
from madrob_console.engine.core.observation import Observation
from madrob_console.referee.acts import Situation
from madrob_console.referee.checks import Check, Readings, preflight
from madrob_console.referee.run_setup import new_run_id


class SituationFactory:
    """Makes the situation of the current run at any moment."""

    def __init__(
        self, config: EngineConfig, observation: Observation, current_run: CurrentRun
    ) -> None:
        self.config = config
        self._observation = observation
        self._current = current_run

    def at(self, now: Now) -> Situation:
        current, result, config = self._current, self._current.state.result, self.config
        return Situation(
            run=current.run,
            scored=result.is_settled,
            hopeless=now.workers.hopeless,
            simulated=now.testbed.announcement.simulated,
            indicators=result.indicators,
            refused=result.problem or now.disk.journal_problem or "",
            look=partial(self._checks, now),
            measure=partial(self._observation.sensors.handle_rest, now.taken),
            rest_force=config.thresholds.touch_force / 2,
            teams=now.teams,
            steps=self._observation.steps,
            testbed=config.testbed,
            competition=config.competition,
            new_id=partial(new_run_id, round(now.time * 1e9), config.random),
        )

    def _checks(self, now: Now) -> tuple[Check, ...]:
        sensors, config, run = self._observation.sensors, self.config, self._current.run
        taken, testbed, force = now.taken, now.testbed, sensors.force(now.taken)
        readings = Readings(
            topic_faults=sensors.topic_faults(testbed.topics, taken),
            angle=sensors.angle(taken),
            closed_angle=config.thresholds.closed_angle,
            near_zero=config.thresholds.near_zero,
            force=None if force is None else force - run.handle_zero,
            rest_force=config.thresholds.touch_force / 2,
            zero=run.zero_samples,
            drift=self._current.drift,
            occupied=sensors.occupied(taken),
            unread_range=sensors.unread_range(taken),
            skew=sensors.skew(taken),
            least_skew=sensors.skew(taken, min),
            largest_skew=config.thresholds.largest_skew,
            disk_free=now.disk.free,
            disk_needed=config.disk_needed,
            recorder_problem=now.disk.problem,
            other_referee=testbed.other_referee,
            teams=now.teams,
            plan=now.plan,
            usual=None if run.setup is None else config.usual_setup(run.setup),
        )
        return preflight(readings, run)
