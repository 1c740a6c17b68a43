"""What the testbed's messages say: the one path behind every source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from madrob_console.engine.live.course import Course, Happening
from madrob_console.engine.live.limits import SensorLimits
from madrob_console.engine.live.scorer import PastRun
from madrob_console.engine.live.sensors import Sensors
from madrob_console.messages.codec import Decoder, MessageError, MessageTypes, TopicMapping
from madrob_console.referee.run import Run
from recorder.message import RawMessage
from scoring.procedure import Procedure, StepRecord
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
        self._past: PastRun | None = None
        self._decoder = Decoder(mappings, types)

    @property
    def steps(self) -> tuple[StepRecord, ...]:
        """The six steps as they were judged last; empty before that."""
        return () if self.procedure is None else self.procedure.steps

    @property
    def provisional(self) -> Mapping[str, float]:
        """The time indicators known so far, by file name, s."""
        if self.course is not None and self.procedure is not None:
            return self.course.assessment.provisional(self.procedure)
        return {} if self._past is None else self._past.provisional

    @property
    def provisional_doubts(self) -> Mapping[str, tuple[str, ...]]:
        """What is doubted of the indicators so far, by file name."""
        if self.course is not None:
            return self.course.assessment.provisional_doubts()
        return {} if self._past is None else self._past.doubts

    @property
    def largest_force(self) -> float | None:
        """Largest abs(force) since the start of the run, N; None before any."""
        if self.course is not None:
            return self.course.assessment.largest_force
        return None if self._past is None else self._past.largest_force

    def look_back(self, past: PastRun | None = None) -> None:
        """Follow no run; an earlier one may be shown instead."""
        self.course, self._past = None, past
        self.procedure = None if past is None else past.procedure

    def receive(self, message: RawMessage, *, recorded: bool, shown: bool) -> None:
        """A message came.

        Args:
            message: it.
            recorded: whether it is in the bag; what is not says nothing of a run.
            shown: whether it says how the testbed is now; else it is too late for that.
        """
        judged = recorded and self.course is not None
        if not shown:
            self.sensors.note_arrival(message)
            if not judged:
                return
        sample, error = None, None
        try:
            sample = self._decoder.decode(message)
        except MessageError as problem:
            error = str(problem)
        if shown:
            self.sensors.receive(message, sample, error)
        if not judged:
            return
        assert self.course is not None
        if sample is not None:
            self.course.feed(sample)
        elif error is not None:
            self.course.assessment.report_problem(error)

    def advance(self, run: Run, now: float, seen: float) -> tuple[Run, list[Happening]]:
        """What has become of a run, and what happened; see `Course.advance`."""
        if self.course is None or not run.active:
            return run, []
        found = self.course.advance(run, now, seen)
        self.procedure = self.course.procedure
        return found

    def judge(self, run: Run) -> None:
        """What was live is judged as of the stop of the run."""
        if self.course is not None:
            self.procedure = self.course.assessment.procedure(run.rulings, run.stop)
