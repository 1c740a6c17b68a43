"""`python -m madrob_console.engine.runtime.scoring_worker HANDLE`: scores for an engine.

It answers questions from the socket with this handle and ends when the engine closes its end. It
writes no file: the engine writes its results.
"""

from __future__ import annotations

import signal
import sys
from contextlib import suppress
from pathlib import Path

from madrob_console.engine.core.scored_run import EarlierRun, RenderedResult, ScoringRequest
from madrob_console.engine.runtime.scorer import RunScorer
from madrob_console.engine.runtime.worker_questions import answer_questions
from scoring.kinematics import load_filters

FIRST_TO_GO = 500
"""Out-of-memory score (of 1000): the kernel ends this process rather than the engine."""


def main() -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # of a whole group: the engine still needs its result
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(FIRST_TO_GO))
    load_filters()
    runs = RunScorer()

    def answer(question: ScoringRequest | Path) -> RenderedResult | EarlierRun:
        return runs.score(question) if isinstance(question, ScoringRequest) else runs.read(question)

    answer_questions(int(sys.argv[1]), answer)


if __name__ == "__main__":
    main()
