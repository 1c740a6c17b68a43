"""What is asked in the engine's thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from madrob_console.engine.shown.requests import NO_ANSWER
from madrob_console.errors import MadrobError

Done = Callable[[Any], None]
"""Takes the answer to a question, once."""


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Something that waits to be asked or sent, and its answer to come.

    Attributes:
        question: asks, and hands the answer on, now or later.
        deadline: what has not begun by then never happens, s of the monotonic clock.
        answer: to come; what is cancelled before its turn never happens either.
    """

    question: Callable[[Done], None]
    deadline: float
    answer: Future[Any]

    def begin(self) -> bool:
        """From now on it cannot be cancelled; False where it must not happen any more."""
        if time.monotonic() > self.deadline:
            fail(self.answer, NO_ANSWER)
        return begun(self.answer)


def begun(answer: Future[Any]) -> bool:
    """Whether what is asked may begin: nobody has given it up. It cannot be any more."""
    if not answer.done():
        with suppress(RuntimeError):  # it has failed just now
            return answer.set_running_or_notify_cancel()
    return False


def fail(answer: Future[Any], why: MadrobError | str) -> None:
    """Say why there is no answer, if there is none yet."""
    with suppress(InvalidStateError):
        answer.set_exception(MadrobError(why) if isinstance(why, str) else why)
