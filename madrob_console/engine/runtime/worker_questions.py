"""Questions to a child process and its answers, as they cross the socket.

Questions are pickled: a run's samples go as the engine holds them, and only the engine can write
to the process. Answers are frames as those of screens (`engine/ipc/wire.py`), checked against their
types.
"""

from __future__ import annotations

import copyreg
import pickle
import socket
from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from madrob_console.common.errors import MadrobError
from madrob_console.engine.ipc.wire import Reply, frame, raw

READY = 0
"""Number of a new process's first message: everything is imported, answers are quick now."""

_REDUCERS = copyreg.dispatch_table | {
    array: lambda samples: (array, (samples.typecode, pickle.PickleBuffer(samples)))
}


class _Parts(list[bytes | memoryview]):
    def write(self, part: bytes) -> None:
        self.append(part)  # in Python: in between, the engine's other threads have their turn


def question_parts(number: int, question: object) -> Sequence[bytes | memoryview]:
    """A question, in parts to be sent one after the other; arrays are sent without copying them."""
    pickled, arrays = _Parts(), list[pickle.PickleBuffer]()
    pickler = pickle.Pickler(pickled, pickle.HIGHEST_PROTOCOL, buffer_callback=arrays.append)
    pickler.dispatch_table = _REDUCERS
    pickler.dump(question)
    samples = [each.raw() for each in arrays]
    return [pickle.dumps((number, [*map(len, samples)])), *samples, *pickled]


def answer_questions(handle: int, answer: Callable[[Any], object]) -> None:
    """Answer the engine's questions, one after the other, until it ends. In the child process."""
    link = socket.socket(fileno=handle)
    ended = (EOFError, pickle.UnpicklingError, ConnectionError)
    with suppress(*ended), link.makefile("rb") as stream:
        reply = Reply(READY)
        while True:
            with suppress(OSError):  # the engine has ended: what it asked before is still done
                link.sendall(frame(reply))
            number, sizes = pickle.load(stream)
            question = pickle.load(stream, buffers=[stream.read(size) for size in sizes])
            try:
                reply = Reply(number, raw(answer(question)))
            except (MadrobError, OSError) as error:
                reply = Reply(number, failed=str(error))
