"""The screens' end of the connection: an engine that fails becomes words, never an exception."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from madrob_console.errors import MadrobError

if TYPE_CHECKING:
    from madrob_console.engine.shown.client import EngineClient
    from madrob_console.engine.shown.requests import Command, Request, T
    from madrob_console.engine.shown.snapshot import Snapshot

LONGEST_SILENCE = 2.0
"""An engine of which nothing is heard for longer is called silent, s."""

NOT_YET = "the engine is starting"


class EngineLink:
    """An engine client that keeps the last snapshot.

    Args:
        open_client: makes the client; called once, by `connect`.
        monotonic: a clock for the engine's silence, s.
    """

    def __init__(
        self, open_client: Callable[[], EngineClient], monotonic: Callable[[], float]
    ) -> None:
        self._open_client = open_client
        self._monotonic = monotonic
        self._client: EngineClient | None = None
        self._latest: Snapshot | None = None
        self._moved = 0.0
        self._failure: str | None = None

    def connect(self) -> None:
        """Connect to the engine; may take seconds, so not on the loop of the screens.

        Raises:
            MadrobError: there is no engine to be had, or it gives no snapshot at all.
        """
        client = self._open_client()
        self._latest = client.snapshot()
        self._moved = self._monotonic()
        self._client = client

    @property
    def connected(self) -> bool:
        """Whether there is an engine."""
        return self._client is not None

    @property
    def trouble(self) -> str | None:
        """Why the snapshot cannot be trusted, in words; None when it can."""
        if self._failure is not None:
            return f"{self._failure}: what you see is old"
        silence = self._monotonic() - self._moved
        if self.connected and silence > LONGEST_SILENCE:
            return f"the engine is silent for {silence:.0f} s: what you see is old"
        return None

    def snapshot(self) -> Snapshot | None:
        """The latest snapshot, or the last one that the engine gave; None before the first."""
        if self._client is None:
            return None
        try:
            snapshot = self._client.snapshot()
        except MadrobError as error:
            self._failure = str(error)
            return self._latest
        self._failure = None
        if snapshot is not self._latest:
            self._moved = self._monotonic()
        self._latest = snapshot
        return snapshot

    def ask(self, request: Request[T]) -> T:
        """Have a request carried out; may take as long as its timeout.

        Raises:
            MadrobError: it failed, or there is no engine that answers.
        """
        if self._client is None:
            raise MadrobError(NOT_YET)
        return self._client.ask(request)

    def do(self, command: Command) -> str | None:
        """The same; returns in words why it is refused or failed, None when it is done."""
        try:
            return self.ask(command)
        except MadrobError as error:
            return str(error)

    def close(self) -> None:
        """Let the engine go."""
        if self._client is not None:
            self._client.close()
