"""What the testbed's messages say: the one path behind every source."""

from __future__ import annotations

from collections.abc import Sequence

from madrob_console.archive.run_record import RunRecord
from madrob_console.archive.scored import Scored
from madrob_console.engine.live.course import Course, Happening
from madrob_console.engine.live.limits import SensorLimits
from madrob_console.engine.live.sensors import Sensors
from madrob_console.messages.codec import Decoder, MessageError, MessageTypes, TopicMapping
from madrob_console.referee.run import Run
from recorder.message import RawMessage
from scoring.evaluate import Assessment
from scoring.procedure import Procedure
from scoring.protocol import Thresholds


class Observation:
    """Decodes messages, watches the topics, follows a run and judges it. Writes nothing.

    Args:
        mappings: which topic carries which signal.
        thresholds: the testbed's numbers.
        limits: what counts as healthy.
        types: the message types, shared with the source.

    Attributes:
        sensors: the topics and what they said last.
        course: of the run that is followed; None = none is.
        procedure: the six steps as they were judged last; None = not yet.
    """

    def __init__(
        self,
        mappings: Sequence[TopicMapping],
        thresholds: Thresholds,
        limits: SensorLimits,
        types: MessageTypes,
    ) -> None:
        self.sensors = Sensors(mappings, thresholds, limits)
        self.course: Course | None = None
        self.procedure: Procedure | None = None
        self._past: Assessment | None = None
        self._decoder = Decoder(mappings, types)

    @property
    def assessment(self) -> Assessment | None:
        """Of the run that is followed or looked back on; None = there is none."""
        return self._past if self.course is None else self.course.assessment

    def look_back(self, assessment: Assessment | None = None) -> None:
        """Follow no run; that of an earlier run may be shown instead."""
        self.course, self.procedure, self._past = None, None, assessment

    def receive(self, message: RawMessage, *, recorded: bool = True) -> None:
        """A message came; what is not recorded says nothing of a run."""
        sample, error = None, None
        try:
            sample = self._decoder.decode(message)
        except MessageError as problem:
            error = str(problem)
        self.sensors.receive(message, sample, error)
        if not recorded or self.course is None:
            return
        if sample is not None:
            self.course.feed(sample)
        elif error is not None:
            self.course.assessment.report_problem(error)

    def advance(self, run: Run, now: float) -> tuple[Run, list[Happening]]:
        """What has become of a run at `now` (s since the epoch), and what happened."""
        if self.course is None or not run.active:
            return run, []
        found = self.course.advance(run, now)
        self.procedure = self.course.procedure
        return found

    def judge(self, run: Run) -> None:
        """What was live is judged as of the stop of the run."""
        if (assessment := self.assessment) is not None:
            self.procedure = assessment.procedure(run.rulings, run.stop)

    def score(self, record: RunRecord, run: Run) -> Scored:
        """The result of a run that is over, and what is behind it."""
        assessment = self.assessment
        assert assessment is not None
        self.judge(run)
        return Scored.of(record, run, assessment)
