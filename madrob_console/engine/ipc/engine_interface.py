"""What a screen asks of an engine and what serves it, as types; both may be in one process."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import CancelledError, InvalidStateError
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

from madrob_console.common.errors import MadrobError
from madrob_console.engine.requests import NO_ANSWER, UNSURE, Request

if TYPE_CHECKING:
    from concurrent.futures import Future
    from pathlib import Path

    from madrob_console.engine.requests import T
    from madrob_console.engine.snapshot import Snapshot


ON_ITS_WAY = 0.5
"""Extra wait for the engine's own report that it gave a request up, s."""


class UnsureError(MadrobError):
    """No answer came to a request that may have begun: its effect is unknown."""


class EngineClient(Protocol):
    """A connection to an engine: in this process or in another one."""

    def snapshot(self) -> Snapshot:
        """The latest snapshot; always the same object while the engine is silent.

        Raises:
            MadrobError: the engine has failed or the connection is lost.
        """

    def begin_request(self, request: Request[T]) -> Future[T]:
        """Have a request carried out; never waits.

        A cancelled request never takes effect; one that has begun cannot be cancelled.
        """

    def send_request(self, request: Request[T]) -> T:
        """Have a request carried out; waits no longer than its timeout."""

    def close(self) -> None:
        """End the connection; an engine in this process ends with it."""


class ServedEngine(Protocol):
    """The engine behind the socket; see `LocalEngine`."""

    @property
    def results(self) -> Path: ...

    @property
    def busy(self) -> bool: ...

    @property
    def unsaved(self) -> bool: ...

    @property
    def not_on_disk(self) -> Sequence[str]: ...

    def snapshot(self) -> Snapshot: ...

    def begin_request(
        self,
        request: Request[T],
        deadline: float | None = None,
        *,
        first: bool = True,
    ) -> Future[T]: ...


def begun(answer: Future[Any]) -> bool:
    if not answer.done():
        with suppress(RuntimeError):  # it has failed just now
            return answer.set_running_or_notify_cancel()
    return False


def fail(answer: Future[Any], why: MadrobError | str) -> None:
    with suppress(InvalidStateError):
        answer.set_exception(MadrobError(why) if isinstance(why, str) else why)


def awaited(answer: Future[T], patience: float) -> T:
    """The answer to a request, which is given up after `patience` s.

    Raises:
        UnsureError: it had begun.
        MadrobError: it failed, or was given up before it began.
    """
    try:
        return answer.result(patience)
    except CancelledError:
        raise MadrobError(NO_ANSWER) from None
    except TimeoutError:
        return given_up(answer)


def given_up(answer: Future[T]) -> T:
    """Give a request up; returns its answer if that came just now.

    Raises:
        UnsureError: it had begun.
        MadrobError: it failed, or had not begun.
    """
    if answer.cancel():
        raise MadrobError(NO_ANSWER)
    if answer.done():
        return answer.result()
    raise UnsureError(UNSURE)
