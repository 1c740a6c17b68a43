"""Questions to a child process."""

from __future__ import annotations

import pickle

from madrob_console.engine.runtime.worker_questions import question_parts
from scoring.assessment import Assessment
from scoring.samples import DoorSample, HandleSample
from tests.madrob_console.engine.drive import PULL


def test_the_samples_of_a_run_are_sent_without_copying_them() -> None:
    run = Assessment(PULL, 100.0)
    for number in range(60_000):
        at = 100.0 + number / 500
        run.feed(DoorSample(at, at, 0.0))
        run.feed(HandleSample(at, at, 0.0))
    head, *parts = question_parts(7, run)
    copied = [part for part in parts if isinstance(part, bytes)]
    assert sum(map(len, copied)) < sum(map(len, parts)) / 10
    number, sizes = pickle.loads(head)
    arrays = [bytes(part) for part in parts if isinstance(part, memoryview)]
    assert (number, sizes) == (7, [len(each) for each in arrays])
    again = pickle.loads(b"".join(copied), buffers=arrays)
    assert (again.newest, again.quality()) == (run.newest, run.quality())
