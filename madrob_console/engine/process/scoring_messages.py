"""What crosses the pipe between an engine and the process that scores for it.

Frames as those of screens (`engine/shown/wire.py`). The bytes of a result's files do not cross:
they lie in a sealed piece of memory whose handle comes with the answer. Nobody copies them.
"""

from __future__ import annotations

import fcntl
import mmap
import os
from collections.abc import Mapping
from pathlib import PurePath

import msgspec

from madrob_console.archive.run_record import RunRecord
from madrob_console.engine.live.scorer import PastRun, RenderedResult
from madrob_console.engine.shown.wire import decoded
from madrob_console.errors import MadrobError
from madrob_console.referee.journal import Entry
from madrob_console.referee.run import Run
from scoring.result import Result
from scoring.samples import Sample

_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE


class Follow(msgspec.Struct, frozen=True, tag=True):
    """A run begins, or its countdown anew: the samples that come now are of it."""

    key: int
    record: RunRecord
    start: float


class Feed(msgspec.Struct, frozen=True, tag=True):
    """The next samples of the run that is followed."""

    samples: list[Sample]


class Remark(msgspec.Struct, frozen=True, tag=True):
    """Something wrong with the recording of the run that is followed, in words."""

    text: str


class Lost(msgspec.Struct, frozen=True, tag=True):
    """Samples of the run that is followed were lost on the way: it is read from its bag."""


class ReadBack(msgspec.Struct, frozen=True, tag=True):
    """Read an earlier run.

    Attributes:
        number: of the question.
        key: of the run.
        at_hand: the run whose data are kept, too.
        folder: of the run.
    """

    number: int
    key: int
    at_hand: int
    folder: str


class Score(msgspec.Struct, frozen=True, tag=True):
    """Score a run that is over; one that is not known any more is read from its bag.

    Attributes:
        number: of the question.
        key: of the run.
        record: what was set.
        run, folder, missing, files: as for `ToScore`.
        stored: a run from its bag keeps what its stored result says of its data.
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
        number: of the question.
        record, run: of a run that was read back; nothing where the engine knows them.
        entries: the journal of a run that was read back.
        out_of_date: as for `EarlierRun`.
        result, past: what is shown.
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
    """A message of the engine."""
    return _questions.decode(data)


def answer_of_process(data: bytes) -> ToEngine:
    """A message of the process.

    Raises:
        MadrobError: it is something else.
    """
    return decoded(_answers, data, "a message of the process that scores")


def put_into_memory(rendered: RenderedResult) -> int:
    """A piece of memory with all of a result's bytes, which nobody can change any more.

    Returns:
        Its handle; the caller closes it.

    Raises:
        OSError: there is no memory or no handle.
    """
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
    """The files, the curves and the report in a piece of memory.

    Args:
        memory: its handle; the caller closes it.
        made: tells what lies where.

    Raises:
        MadrobError: it holds something else, or could still change.
        OSError: it cannot be looked at.
    """
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
