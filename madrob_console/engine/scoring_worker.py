"""`python -m madrob_console.engine.scoring_worker HANDLE`: scores for an engine.

It reads questions from the socket with this handle and ends when the engine closes its end. It
writes no file: what it makes, the engine writes.
"""

from __future__ import annotations

import gc
import math
import os
import pickle
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine.scorer import ScoringDesk, ToScore
from madrob_console.engine.scoring_protocol import (
    Answered,
    Failed,
    Ready,
    ToEngine,
    question_parts,
)
from madrob_console.engine.wire import frame
from madrob_console.referee.records import RunSetup
from madrob_console.referee.run import Phase, Run
from scoring.kinematics import load_filters
from scoring.protocol import Condition, LockDetection, Outcome, StartPose, Thresholds
from scoring.rulesets import RulesetName
from scoring.signals import DoorSample, HandleSample

_REHEARSED = 3.0  # s

FIRST_TO_GO = 500
"""Out-of-memory score (of 1000): the kernel ends this process rather than the engine."""


def _answer(desk: ScoringDesk, number: int, what: ToScore | Path) -> ToEngine:
    try:
        if isinstance(what, ToScore):
            return Answered(number, desk.score(what))
        earlier = desk.read(what)
        return Answered(number, earlier.scored, earlier.entries, earlier.out_of_date)
    except (MadrobError, OSError) as error:
        return Failed(number, str(error))


def _rehearse() -> None:
    """Score a made-up run: whatever is used for the first time takes twice as long."""
    condition, begin = Condition.from_number(1), 1.0
    setup = RunSetup(
        subject=1,
        team="",
        run_number=1,
        condition=condition,
        start_pose=StartPose(float(condition.starting_side.sign), 0.0, 0.0),
        referee="",
        timeout=_REHEARSED,
        countdown=1.0,
        ruleset=RulesetName.PROTOCOL,
        lock_detection=LockDetection.AUTO,
    )
    record = RunRecord(setup, 0.0, Thresholds(), (), SourceKind.SIMULATED, "", "")
    end = begin + _REHEARSED
    run = Run(Phase.STOPPED, setup, start=begin, stop=end, outcome=Outcome.TIMEOUT, issue=1)
    assessment = record.assessment(begin)
    for number in range(int(100 * _REHEARSED)):
        at = begin + number / 100
        assessment.feed(DoorSample(at, at, math.sin(number / 50)))
        assessment.feed(HandleSample(at, at, math.cos(number / 50)))
    nowhere = Path(os.devnull, "run")
    wanted = ToScore(record, run, nowhere, nowhere, assessment)
    frame(_answer(ScoringDesk(), *pickle.loads(b"".join(question_parts(0, wanted)))))


def main() -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # of a whole group: the engine still needs its result
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(FIRST_TO_GO))
    link = socket.socket(fileno=int(sys.argv[1]))
    load_filters()
    _rehearse()
    gc.freeze()  # what was imported stays
    desk = ScoringDesk()
    ended = (ConnectionError, EOFError, pickle.UnpicklingError)
    with suppress(*ended), link.makefile("rb") as questions:
        link.sendall(frame(Ready()))
        while True:
            link.sendall(frame(_answer(desk, *pickle.load(questions))))


if __name__ == "__main__":
    main()
