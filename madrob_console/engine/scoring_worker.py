"""`python -m madrob_console.engine.scoring_worker HANDLE`: scores for an engine.

It reads questions from the socket with this handle and ends when the engine closes its end. It
writes no file: what it makes, the engine writes.
"""

from __future__ import annotations

import gc
import math
import os
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

import msgspec

from madrob_console.archive.run_record import RunRecord
from madrob_console.archive.scored import assess_recording
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine.scorer import RenderedResult, ScorableRun, ToScore, read_earlier
from madrob_console.engine.scoring_protocol import (
    Failed,
    Feed,
    Follow,
    Lost,
    Made,
    ReadBack,
    Ready,
    Remark,
    Score,
    ToEngine,
    ToProcess,
    put_into_memory,
    question_of,
)
from madrob_console.engine.wire import LENGTH, frame
from madrob_console.referee.records import RunSetup
from madrob_console.referee.run import Phase, Run
from scoring.kinematics import load_filters
from scoring.protocol import Condition, LockDetection, Outcome, StartPose, Thresholds
from scoring.rulesets import RulesetName
from scoring.signals import DoorSample, HandleSample

_REHEARSED = 3.0  # s

FIRST_TO_GO = 500
"""Out-of-memory score (of 1000): the kernel ends this process rather than the engine."""


class ScoringLink:
    """The socket to the engine. When it closes, this process ends."""

    def __init__(self, link: socket.socket) -> None:
        self._link = link

    def next(self) -> ToProcess:
        (length,) = LENGTH.unpack(self._read(LENGTH.size))
        return question_of(self._read(length))

    def _read(self, size: int) -> bytes:
        data = bytearray(size)
        view = memoryview(data)
        while view:
            if not (got := self._link.recv_into(view)):
                sys.exit()
            view = view[got:]
        return bytes(data)

    def send(self, message: ToEngine, memory: int | None = None) -> None:
        data = frame(message)
        if memory is not None:
            socket.send_fds(self._link, [data[:1]], [memory])
            data = data[1:]
        self._link.sendall(data)


class Desk:
    """Answers the engine's questions one after the other."""

    def __init__(self, line: ScoringLink) -> None:
        self._line = line
        self._runs: dict[int, ScorableRun] = {}
        self._followed: int | None = None

    def work(self) -> None:
        while True:
            match self._line.next():
                case ReadBack() | Score() as asked:
                    self._answer(asked)
                case Follow(key, record, start):
                    self._runs = {key: ScorableRun(record, record.assessment(start))}
                    self._followed = key
                case Feed() | Remark() | Lost() as told:
                    if self._followed is not None:
                        self._follow(self._followed, told)

    def _follow(self, key: int, told: Feed | Remark | Lost) -> None:
        assessment = self._runs[key].assessment
        match told:
            case Feed(samples):
                for sample in samples:
                    assessment.feed(sample)
            case Remark(text):
                assessment.report_problem(text)
            case Lost():
                self._followed = None
                del self._runs[key]

    def _answer(self, asked: ReadBack | Score) -> None:
        try:
            if isinstance(asked, ReadBack):
                made, memory = self._read(asked)
            else:
                made, memory = self._score(asked)
        except (MadrobError, OSError) as error:
            self._line.send(Failed(asked.number, str(error)))
            return
        self._line.send(made, memory)
        os.close(memory)

    def _read(self, asked: ReadBack) -> tuple[Made, int]:
        earlier, run = read_earlier(Path(asked.folder), asked.key)
        needed = (asked.at_hand, self._followed)
        kept = {key: data for key, data in self._runs.items() if key in needed}
        self._runs = kept | {asked.key: run}
        told = msgspec.structs.replace(
            _made(asked.number, earlier.scored),
            record=earlier.scored.record,
            run=earlier.scored.run,
            entries=earlier.entries,
            out_of_date=earlier.out_of_date,
        )
        return told, put_into_memory(earlier.scored)

    def _score(self, asked: Score) -> tuple[Made, int]:
        self._followed = None  # it is over
        folder = Path(asked.folder)
        run = self._runs.get(asked.key)
        if run is None:
            assessment = assess_recording(folder, asked.record, asked.run, stored=asked.stored)
            run = self._runs[asked.key] = ScorableRun(asked.record, assessment, stored=asked.stored)
        rendered = run.score(ToScore(asked.run, folder, asked.missing, asked.files))
        return _made(asked.number, rendered), put_into_memory(rendered)


def _made(number: int, rendered: RenderedResult) -> Made:
    return Made(
        number=number,
        result=rendered.result,
        past=rendered.past,
        files={name: len(content) for name, content in rendered.files.items()},
        curves=len(rendered.curves),
        report=len(rendered.report),
    )


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
    rendered = RenderedResult.of(record, run, assessment, Path(os.devnull, "run"))
    os.close(put_into_memory(rendered))


def main() -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # of a whole group: the engine still needs its result
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(FIRST_TO_GO))
    line = ScoringLink(socket.socket(fileno=int(sys.argv[1])))
    load_filters()
    _rehearse()
    gc.freeze()  # what was imported stays
    with suppress(ConnectionError):
        line.send(Ready())
        Desk(line).work()


if __name__ == "__main__":
    main()
