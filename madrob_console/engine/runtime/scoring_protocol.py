"""Messages between an engine and its scoring process.

Questions are pickled: they have the samples of a run as the engine holds them, and only the engine
can write to the process. Answers are frames as those of screens (`engine/ipc/wire.py`), checked
against their types.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from pathlib import Path

import msgspec

from madrob_console.engine.core.scored_run import RenderedResult, ToScore
from madrob_console.engine.ipc.wire import decoded
from madrob_console.referee.journal import Entry


class Ready(msgspec.Struct, frozen=True, tag=True):
    """Everything is imported: from now on answers are quick."""


class Failed(msgspec.Struct, frozen=True, tag=True):
    """There is no answer to a question, and why, in words."""

    number: int
    why: str


class Answered(msgspec.Struct, frozen=True, tag=True):
    """A scored run; `entries` and `out_of_date` as for `EarlierRun`, of one that was read."""

    number: int
    scored: RenderedResult
    entries: tuple[Entry, ...] = ()
    out_of_date: bool = False


ToEngine = Ready | Failed | Answered

_answers: msgspec.msgpack.Decoder[ToEngine] = msgspec.msgpack.Decoder(ToEngine)


def answer_of_process(data: memoryview) -> ToEngine:
    return decoded(_answers, data, "a message of the process that scores")


class _Parts(list[bytes]):
    def write(self, part: bytes) -> None:
        self.append(part)  # in Python: in between, the engine's other threads have their turn


def question_parts(number: int, what: ToScore | Path) -> Sequence[bytes]:
    """A run to be scored, or a folder to be read, in parts to be sent one after the other."""
    parts = _Parts()
    pickle.Pickler(parts, pickle.HIGHEST_PROTOCOL).dump((number, what))
    return parts
