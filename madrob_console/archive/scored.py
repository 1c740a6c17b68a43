"""A run that is over, and its result: live, replayed, opened again or scored from disk."""

from __future__ import annotations

from dataclasses import dataclass

from madrob_console.archive.run_record import RunRecord
from madrob_console.referee.run import Run
from scoring.evaluate import Assessment
from scoring.protocol import Outcome
from scoring.result import Ending, Result
from scoring.rows import Rows


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """A scored run.

    Attributes:
        record: what was set.
        run: its state, with what the referee said.
        result: what the sensors and the referee make of it.
        rows: the pre-processed data behind the result, cut to the run.
    """

    record: RunRecord
    run: Run
    result: Result
    rows: Rows

    @classmethod
    def of(cls, record: RunRecord, run: Run, assessment: Assessment) -> Scored:
        """Score a run that is over.

        Args:
            record: what was set.
            run: its state after everything that was said of it.
            assessment: fed with all of its samples.
        """
        return cls(record, run, *assessment.result(ending_of(run), run.rulings, run.remarks()))


def ending_of(run: Run) -> Ending:
    """How a run ended, for its result.

    An interrupted run has no stop: the time at which the machine failed says nothing about the
    robot. So does a run whose journal ends before its stop.
    """
    if run.outcome is None:
        return Ending(Outcome.INTERRUPTED, "no stop is recorded: the run was cut off", None)
    interrupted = run.outcome is Outcome.INTERRUPTED
    return Ending(run.outcome, run.outcome_reason, None if interrupted else run.stop)
