"""From messages to what is shown and judged: decoding, topics, and the run's tracker."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from madrob_console.engine.core.run_tracker import Happening, RunTracker
from madrob_console.engine.core.scored_run import PastRun
from madrob_console.engine.core.sensors import Sensors
from madrob_console.messages.codec import ROBOT_TYPES, Decoder
from madrob_console.messages.mapping import TopicMapping
from madrob_console.messages.types import MessageError, MessageTypes
from madrob_console.referee.run import Run
from madrob_console.referee.topic_health import SensorLimits
from recorder.bag import RawMessage
from scoring.procedure import Procedure, StepRecord
from scoring.protocol import Event, Thresholds

NEWEST = 20
"""Most events of the door, and of the latch, that screens show."""


class Observation:
    """Decodes messages, watches the topics, follows a run and judges it. Writes nothing."""

    def __init__(
        self,
        mappings: Sequence[TopicMapping],
        thresholds: Thresholds,
        limits: SensorLimits,
        types: MessageTypes,
    ) -> None:
        self.sensors = Sensors(mappings, thresholds, limits)
        self.tracker: RunTracker | None = None
        self.procedure: Procedure | None = None
        self._past: PastRun | None = None
        self._mappings, self._types = mappings, types
        self._decoder = Decoder(mappings, types)

    @property
    def steps(self) -> tuple[StepRecord, ...]:
        return () if self.procedure is None else self.procedure.steps

    @property
    def provisional(self) -> Mapping[str, float]:
        """The time indicators known so far, by file name, s."""
        if self.tracker is not None and self.procedure is not None:
            return self.tracker.assessment.provisional(self.procedure)
        return {} if self._past is None else self._past.provisional

    @property
    def provisional_doubts(self) -> Mapping[str, tuple[str, ...]]:
        if self.tracker is not None:
            return self.tracker.assessment.provisional_doubts()
        return {} if self._past is None else self._past.doubts

    @property
    def events(self) -> tuple[Event, ...]:
        """The newest events of the run that goes on or has just stopped."""
        return () if self.tracker is None else self.tracker.assessment.events(newest=NEWEST)

    @property
    def largest_force(self) -> float | None:
        """Largest abs(force) since the start of the run, N."""
        if self.tracker is not None:
            return self.tracker.assessment.largest_force
        return None if self._past is None else self._past.largest_force

    def follow(self, tracker: RunTracker) -> None:
        """Follow a run from its countdown; what the decoder remarks is then of this run."""
        self.tracker = tracker
        self._decoder = Decoder(self._mappings, self._types)

    def look_back(self, past: PastRun | None = None) -> None:
        self.tracker, self._past = None, past
        self.procedure = None if past is None else past.procedure

    def receive(self, message: RawMessage, *, recorded: bool, shown: bool) -> None:
        """Take a message; only `recorded` ones count for a run, only `shown` ones reach screens."""
        tracker = self.tracker if recorded else None
        if tracker is not None and message.topic in ROBOT_TYPES:
            tracker.hear_robot(message)
        if not shown and tracker is None:
            self.sensors.note_arrival(message)
            return
        sample = None
        try:
            sample = self._decoder.decode(message)
            problem = self._decoder.doubt
        except MessageError as error:
            problem = str(error)
            if tracker is not None:
                tracker.assessment.report_problem(problem)
        absent = self._decoder.absent
        if absent is not None:
            self.sensors.note_absence(message, absent)
        elif shown:
            self.sensors.receive(message, sample, problem)
        else:
            self.sensors.note_arrival(message)
        if tracker is not None and sample is not None:
            tracker.feed(sample)
        remark = self._decoder.remark
        if tracker is not None and remark is not None:
            tracker.assessment.report_problem(*remark)

    def advance(self, run: Run, now: float, fed_until: float) -> tuple[Run, list[Happening]]:
        if self.tracker is None or not run.active:
            return run, []
        advanced = self.tracker.advance(run, now, fed_until)
        self.procedure = self.tracker.procedure
        return advanced

    def judge(self, run: Run) -> None:
        if self.tracker is not None:
            self.procedure = self.tracker.assessment.procedure(run.rulings, run.stop)
