"""What a screen knows of its engine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from madrob_console.engine.shown.requests import Request, T
    from madrob_console.engine.shown.snapshot import Snapshot


class EngineClient(Protocol):
    """A connection to an engine: in this process or in another one."""

    def snapshot(self) -> Snapshot:
        """The latest snapshot; always the same object where the engine stands still.

        Raises:
            MadrobError: the engine has failed or the connection is lost.
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
