"""What the scoring child does: it scores a closed bag."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.run_record import RunRecord
from madrob_console.archive.scored import Scored, assess_recording
from madrob_console.referee.run import Run
from scoring.result import Result


@dataclass(frozen=True, slots=True)
class Question:
    """A run that is over, and whose bag is closed."""

    folder: Path
    record: RunRecord
    run: Run


def score(question: Question) -> Result:
    """Score a run as `madrob score` does."""
    record, run = question.record.corrected(question.run), question.run
    assessment = assess_recording(question.folder, record, run, stored=False)
    return Scored.of(record, run, assessment).result
