"""One run after the other: its state, its lines, and what sensors and clock decide."""

from __future__ import annotations

import asyncio
from functools import partial

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.clock import Clock, seconds
from madrob_console.common.names import SourceKind
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.core.observation import Observation
from madrob_console.engine.core.run_tracker import RunTracker
from madrob_console.engine.public_state import PublishedState
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    REFEREE_STATE_TOPIC,
    encode_text,
    referee_topics,
)
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import Act, Consequence, Situation
from madrob_console.referee.checks import Check, Readings, preflight
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change, after
from madrob_console.referee.run import Phase, Run, begin_countdown
from madrob_console.referee.run_setup import new_run_id
from madrob_console.testbeds.source import Source
from recorder import RawMessage
from scoring.result import Result
from tests.slice.disk import Disk, Job
from tests.slice.intake import Intake
from tests.slice.recording import Recording


class CurrentRun:
    """The run that is set up, goes on or is over.

    Attributes:
        run: its state by acts, sensors and clock.
        lines: of its journal that stand, on disk or on the way there.
        recording: its open files; None before the start.
        stopped: is set when it stops.
        result: None until it is scored.
    """

    def __init__(
        self,
        source: Source,
        clock: Clock,
        config: EngineConfig,
        types: MessageTypes,
        intake: Intake,
        disk: Disk,
    ) -> None:
        self._source = source
        self._clock = clock
        self._config = config
        self._types = types
        self._type_names = {topic.name: topic.type for topic in referee_topics(types)}
        self._intake = intake
        self.disk = disk
        self.observation = Observation(config.mappings, config.thresholds, config.limits, types)
        self.run = Run()
        self.lines: list[Entry] = []
        self.recording: Recording | None = None
        self.stopped = asyncio.Event()
        self.result: Result | None = None

    def now(self) -> float:
        """Steady time, s since the epoch."""
        return seconds(self._clock.now_ns())

    # What the referee decides.

    def apply(self, act: Act, line: Entry) -> None:
        """Put an act into effect.

        Its line follows in its order.
        """
        if Consequence.NEW_RUN in act.consequences:
            self._begin_next()
        self.change(act.apply(self.situation(), line.time))
        self.note(line)
        if Consequence.NEW_RUN in act.consequences and self.run.setup is not None:
            self._source.configure(self.run.setup.condition)

    def take_effect(self, act: Act, line: Entry) -> None:
        """Put an act into effect whose line is on disk."""
        self._keep(line)
        if Consequence.COUNTDOWN not in act.consequences:
            self.change(act.apply(self.situation(), line.time))
            return

        # The countdown begins when its start is on disk: a line of its own says when.
        now = self.now()
        begins = Entry(now, Origin.CLOCK, Change.COUNTDOWN_BEGINS, details={"time": now})
        self.note(begins)
        self.change(after(self.run, begins))

    def _begin_next(self) -> None:
        if self.recording is not None:
            self.disk.queue(self.recording.close, required=False)
        self.run = self.run.cleared
        self.lines = []
        self.recording = None
        self.result = None
        self.observation.look_back()

    # What sensors and clock decide.

    def advance(self) -> None:
        """Decide what follows from all that was judged until now."""
        now = self.now()
        judged = min(now, self._intake.judged_until)
        run, happened = self.observation.advance(self.run, now, judged)
        for each in happened:
            what = each.change.value
            self.note(Entry(now, each.origin, what, reason=each.reason, details=each.details))
        self.change(run)

    def change(self, run: Run) -> None:
        """Put the run into a new state, tell the testbed, and wake who waits for the stop."""
        before = self.run
        if run is before:
            return
        self.run = run
        if run.start != before.start:
            self._count_down()
        state = PublishedState.of(run)
        if state != PublishedState.of(before):
            self._source.publish(self._message(REFEREE_STATE_TOPIC, state.text))
        if before.active and run.phase is Phase.STOPPED:
            self.observation.judge(run)
            self.stopped.set()

    def _count_down(self) -> None:
        """Have the sensors followed from the countdown on, or from its new beginning."""
        tracker = self.observation.tracker
        if tracker is not None:
            tracker.restart(self.run, self.now())
        elif self.run.phase is Phase.COUNTDOWN and self.recording is not None:
            before = self.observation.sensors.newest()
            lost = self._config.limits.lost
            tracker = RunTracker(self.recording.record, self.run, lost, before)
            self.observation.follow(tracker)

    # The files of the run.

    def open_recording(self, line: Entry) -> Job:
        """Have the files of the run opened, with all lines until now and the start's."""
        start = begin_countdown(self.run, line.time).start
        assert start is not None
        self._clock.hold_steady()
        work = partial(
            Recording,
            self._config.results,
            self._record(),
            start,
            self._source.topics(),
            (*self.lines, line),
            lossless=self._config.lossless,
        )
        return self.disk.queue(work, required=False)

    def begin_recording(self, opened: Recording) -> None:
        """Record what comes from now on."""
        self.recording = opened
        self._intake.record(opened.bag)

    def note(self, line: Entry) -> None:
        """Write a line that takes effect whatever the disk says."""
        self._keep(line)
        self.queue_line(line)

    def queue_line(self, line: Entry) -> None:
        """Have a line written that stands whatever the disk says."""
        if self.recording is not None:
            self.disk.queue(partial(self.recording.append, line), required=True)

    def write(self, line: Entry) -> Job:
        """Have a line written that takes effect when it is on disk."""
        assert self.recording is not None
        return self.disk.queue(partial(self.recording.append, line), required=False)

    def _keep(self, line: Entry) -> None:
        """Keep a line that stands, and record it on the topic of events."""
        self.lines.append(line)
        message = self._message(REFEREE_EVENT_TOPIC, line.to_json())
        self._intake.record_own(message)
        self._source.publish(message)

    def _message(self, topic: str, text: str) -> RawMessage:
        now = self._clock.now_ns()
        data = encode_text(self._types, text)
        return RawMessage(topic, self._type_names[topic], data, now, now)

    def _record(self) -> RunRecord:
        simulated = self._source.announcement.simulated is not None
        assert self.run.setup is not None
        return RunRecord(
            setup=self.run.setup,
            handle_zero=self.run.handle_zero,
            thresholds=self._config.thresholds,
            mappings=self._config.mappings,
            source=SourceKind.SIMULATED if simulated else self._source.kind,
            competition=self._config.competition,
            version=self._config.version,
            zero_samples=self.run.zero_samples,
        )

    def close(self) -> None:
        """Leave the files of the run.

        What the disk has not taken is lost.
        """
        if self.recording is not None:
            self.recording.close()

    # What an act is checked against.

    def situation(self) -> Situation:
        """Return what an act is checked against now."""
        taken = self._intake.taken_until
        return Situation(
            run=self.run,
            scored=self.result is not None,
            look=partial(self.checks, taken),
            measure=partial(self.observation.sensors.handle_rest, taken),
            rest_force=self._config.thresholds.touch_force / 2,
            steps=self.observation.steps,
            simulated=self._source.announcement.simulated,
            testbed=self._config.testbed,
            competition=self._config.competition,
            new_id=partial(new_run_id, self._clock.now_ns(), self._config.random),
            refused=self.disk.refused,
        )

    def checks(self, taken: float) -> tuple[Check, ...]:
        """Return the checks before a start, by what was taken until then (s since the epoch)."""
        sensors = self.observation.sensors
        thresholds = self._config.thresholds
        force = sensors.force(taken)
        readings = Readings(
            topic_faults=sensors.topic_faults(self._source.status(), taken),
            angle=sensors.angle(taken),
            closed_angle=thresholds.closed_angle,
            near_zero=thresholds.near_zero,
            force=None if force is None else force - self.run.handle_zero,
            rest_force=thresholds.touch_force / 2,
            zero=self.run.zero_samples,
            drift=None,
            occupied=sensors.occupied(taken),
            unread_range=sensors.unread_range(taken),
            skew=sensors.skew(taken),
            least_skew=sensors.skew(taken, min),
            largest_skew=thresholds.largest_skew,
            disk_free=1 << 40,
            disk_needed=0,
            recorder_problem="",
            other_referee=self._source.other_referee,
        )
        return preflight(readings, self.run)
