"""What a screen knows of its engine."""

from __future__ import annotations

from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Protocol

from madrob_console.engine.shown.requests import NO_ANSWER, UNSURE
from madrob_console.errors import MadrobError

if TYPE_CHECKING:
    from concurrent.futures import Future

    from madrob_console.engine.shown.requests import Request, T
    from madrob_console.engine.shown.snapshot import Snapshot


ON_ITS_WAY = 0.5
"""The engine's own word that it gave a request up may come so much later, s."""


class UnsureError(MadrobError):
    """No answer came to a request that may have begun: nobody can say whether it took effect."""


class EngineClient(Protocol):
    """A connection to an engine: in this process or in another one."""

    def snapshot(self) -> Snapshot:
        """The latest snapshot; always the same object while nothing is heard of the engine.

        Raises:
            MadrobError: the engine has failed or the connection is lost.
        """
        ...

    def begin(self, request: Request[T]) -> Future[T]:
        """Have a request carried out, and do not wait.

        Returns:
            The answer to come, or the `MadrobError` that tells why there is none. What is
            cancelled will never take effect; what has begun cannot be cancelled.
        """
        ...

    def ask(self, request: Request[T]) -> T:
        """Have a request carried out; waits no longer than its timeout.

        Raises:
            MadrobError: it failed, or the engine has ended or does not answer.
        """
        ...

    def close(self) -> None:
        """End the connection; an engine in this process ends with it."""
        ...


def awaited(answer: Future[T], patience: float) -> T:
    """The answer to a request, or the end of patience with it (s): then it is given up.

    Raises:
        UnsureError: it had begun.
        MadrobError: it failed, or was given up before it began.
    """
    try:
        return answer.result(patience)
    except CancelledError:
        raise MadrobError(NO_ANSWER) from None
    except TimeoutError:
        raise given_up(answer) from None


def given_up(answer: Future[T]) -> MadrobError:
    """Give a request up; why there is no answer."""
    return MadrobError(NO_ANSWER) if answer.cancel() else UnsureError(UNSURE)
