"""What crosses the pipe between the engine and its scoring process, both ways."""

from __future__ import annotations

import fcntl
import mmap
import os
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePath

import msgspec

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.errors import MadrobError
from madrob_console.engine.scorer import PastRun, RenderedResult
from madrob_console.engine.wire import decoded
from madrob_console.referee.journal import Entry
from madrob_console.referee.run import Run
from scoring.result import Result
from scoring.signals import Sample

# Messages between an engine and its scoring process.
#
# The frames are those of screens (`engine/wire.py`). The bytes of a result's files do not cross:
# they lie in sealed memory, whose handle comes with the answer.


_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE


class Follow(msgspec.Struct, frozen=True, tag=True):
    """A run or its countdown begins (anew): the samples that follow belong to it."""

    key: int
    record: RunRecord
    start: float


class Feed(msgspec.Struct, frozen=True, tag=True):
    """The next samples of the followed run."""

    samples: list[Sample]


class Remark(msgspec.Struct, frozen=True, tag=True):
    """Something wrong with the recording of the followed run, in words."""

    text: str


class Lost(msgspec.Struct, frozen=True, tag=True):
    """Samples of the followed run were lost on the way: it is read from its bag."""


class ReadBack(msgspec.Struct, frozen=True, tag=True):
    """Read an earlier run; data of the run `at_hand` are kept, too."""

    number: int
    key: int
    at_hand: int
    folder: str


class Score(msgspec.Struct, frozen=True, tag=True):
    """Score a run that is over; an unknown one is read from its bag.

    For `run`, `folder`, `missing` and `files` see `ToScore`; with `stored` a run from its
    bag keeps the stored result's remarks on its data.
    """

    number: int
    key: int
    record: RunRecord
    run: Run
    folder: str
    missing: tuple[str, ...]
    stored: bool
    files: bool


class Ready(msgspec.Struct, frozen=True, tag=True):
    """Everything is imported: from now on answers are quick."""


class Failed(msgspec.Struct, frozen=True, tag=True):
    """There is no answer to a question, and why, in words."""

    number: int
    why: str


class Made(msgspec.Struct, frozen=True, tag=True):
    """A scored run; a piece of memory comes with it.

    Attributes:
        record, run, entries: of a run that was read back; the engine knows the others.
        out_of_date: as for `EarlierRun`.
        files: the sizes of its files by their names; they lie in the memory, in this order.
        curves, report: their sizes; they lie behind the files.
    """

    number: int
    result: Result
    past: PastRun
    files: dict[str, int]
    curves: int
    report: int
    record: RunRecord | None = None
    run: Run | None = None
    entries: tuple[Entry, ...] = ()
    out_of_date: bool = False


ToProcess = Follow | Feed | Remark | Lost | ReadBack | Score
ToEngine = Ready | Failed | Made

_questions: msgspec.msgpack.Decoder[ToProcess] = msgspec.msgpack.Decoder(ToProcess)
_answers: msgspec.msgpack.Decoder[ToEngine] = msgspec.msgpack.Decoder(ToEngine)


def question_of(data: bytes) -> ToProcess:
    return _questions.decode(data)


def answer_of_process(data: bytes) -> ToEngine:
    return decoded(_answers, data, "a message of the process that scores")


def put_into_memory(rendered: RenderedResult) -> int:
    """Put all of a result's bytes into sealed memory; the caller closes the handle."""
    memory = os.memfd_create("result", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        for part in (*rendered.files.values(), rendered.curves, rendered.report):
            left = memoryview(part)
            while left:
                left = left[os.write(memory, left) :]
        fcntl.fcntl(memory, fcntl.F_ADD_SEALS, _SEALS)
    except BaseException:
        os.close(memory)
        raise
    return memory


def parts_in_memory(
    memory: int, made: Made
) -> tuple[Mapping[str, memoryview], memoryview, memoryview]:
    """The files, the curves and the report in a piece of memory; the caller closes its handle."""
    sizes = (*made.files.values(), made.curves, made.report)
    whole = sum(sizes)
    plain = all(name == PurePath(name).name for name in made.files)
    sealed = fcntl.fcntl(memory, fcntl.F_GET_SEALS) & _SEALS == _SEALS
    fits = min(sizes) >= 0 < whole == os.fstat(memory).st_size
    if not (plain and sealed and fits):
        raise MadrobError("not the memory that was announced")
    view = memoryview(mmap.mmap(memory, whole, flags=mmap.MAP_PRIVATE, prot=mmap.PROT_READ))
    parts, begin = [], 0
    for size in sizes:
        parts.append(view[begin : begin + size])
        begin += size
    return dict(zip(made.files, parts, strict=False)), parts[-2], parts[-1]


MOST_WAITING = 50_000
"""Samples that may wait for the process; with more it is given up for this run. 100 s of 500 Hz."""

MOST_AT_ONCE = 2_000
"""Samples handed on at once: packing them holds up the engine's thread."""

DELAYS = (0.0, 1.0, 5.0, 30.0)
"""Pause before the next try after so many failures, s."""

FEW = 3
"""After so many failures the referee is told what to do."""


def delay_after(failures: int) -> float:
    """In s."""
    return DELAYS[min(failures, len(DELAYS) - 1)]


@dataclass(slots=True, eq=False)
class Asked:
    """A question, until it is answered.

    Attributes:
        take: takes the answer and the memory that came with it, in the scorer's thread.
        refuse: takes why there is none, in words; None = it is retried without end.
        queued: whether it waits behind samples.
        due: when it may be tried (again), s of the monotonic clock.
    """

    question: Score | ReadBack
    take: Callable[[Made, int], None]
    refuse: Callable[[str], None] | None = None
    queued: bool = True
    failures: int = 0
    due: float = field(default_factory=time.monotonic)
    sent: bool = False
    why: str = ""

    def has_failed(self, why: str) -> None:
        self.due = time.monotonic() + delay_after(self.failures)
        self.failures += 1
        self.sent, self.why = False, why


class Questions:
    """What waits for the process, in its order, and what it has not answered yet.

    The engine's thread puts in, the scorer's takes out; neither keeps the other waiting.
    """

    def __init__(self) -> None:
        self.more = False
        self._lock = threading.Lock()  # who changes one of these has it
        self._outbox: list[Sample | ToProcess] = []
        self._asked: dict[int, Asked] = {}
        self._followed: int | None = None

    def __len__(self) -> int:
        return len(self._outbox)

    @property
    def following(self) -> bool:
        return self._followed is not None

    # ------------------------------------------------------------------ the engine's thread

    def follow(self, key: int, record: RunRecord, start: float) -> None:
        with self._lock:
            self._outbox.append(Follow(key, record, start))
            self._followed = key

    def hand_on(self, key: int, what: Sample | Remark) -> None:
        """Hand on samples or remarks of a run; ignored if it is no longer followed."""
        if self._followed != key:
            return
        with self._lock:
            if len(self._outbox) < MOST_WAITING:
                self._outbox.append(what)
                return
            messages = (Follow, Lost, ReadBack, Score)
            self._outbox = [each for each in self._outbox if isinstance(each, messages)]
            self._outbox.append(Lost())
            self._followed = None

    def end_following(self) -> None:
        self._followed = None

    def queue_question(self, asked: Asked) -> None:
        with self._lock:
            self._asked[asked.question.number] = asked
            self._outbox.append(asked.question)

    def forget(self, number: int) -> None:
        with self._lock:
            self._asked.pop(number, None)

    # ------------------------------------------------------------------ the scorer's thread

    def next(self, now: float) -> list[ToProcess]:
        """What is to be sent at `now` (s of the monotonic clock), in its order."""
        messages: list[ToProcess] = []
        samples: list[Sample] = []
        with self._lock:
            self.more = len(self._outbox) > MOST_AT_ONCE
            items = self._outbox[:MOST_AT_ONCE]
            del self._outbox[:MOST_AT_ONCE]
            for item in items:
                if isinstance(item, Sample):
                    samples.append(item)
                    continue
                if samples:
                    messages.append(Feed(samples))
                    samples = []
                if isinstance(item, Score | ReadBack):
                    if (asked := self._asked.get(item.number)) is not None:
                        asked.queued = False
                    continue
                messages.append(item)
            if samples:
                messages.append(Feed(samples))
            for asked in self._asked.values():
                if not asked.queued and not asked.sent and asked.due <= now:
                    asked.sent = True
                    messages.append(asked.question)
        return messages

    def question_of(self, number: int) -> Asked | None:
        with self._lock:
            return self._asked.get(number)

    def left(self) -> list[Asked]:
        with self._lock:
            return list(self._asked.values())

    def has_failed(self, number: int, why: str) -> None:
        """The process could not answer a question; it is retried, or refused."""
        with self._lock:
            asked = self._asked.get(number)
            if asked is not None:
                asked.has_failed(why)
                if asked.refuse is not None:
                    del self._asked[number]
        if asked is not None and asked.refuse is not None:
            asked.refuse(why)

    def all_failed(self, why: str, starts: int) -> None:
        """The next process gets the open questions; `starts` counts failed starts in a row."""
        refused = []
        with self._lock:
            for number, asked in list(self._asked.items()):
                if asked.sent:
                    asked.has_failed(why)
                if asked.refuse is not None and max(asked.failures, starts) >= FEW:
                    refused.append(self._asked.pop(number))
            if not any(isinstance(each, Follow) for each in self._outbox):
                self._followed = None  # what it knew of the run is gone
                self._outbox = [e for e in self._outbox if isinstance(e, Score | ReadBack)]
        for asked in refused:
            assert asked.refuse is not None
            asked.refuse(f"it cannot be read: {why}")
