"""The screens' end of the connection: an engine that fails becomes words, never an exception."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from madrob_console.errors import MadrobError
from madrob_console.referee.acts import Act

if TYPE_CHECKING:
    from madrob_console.engine.client import EngineClient
    from madrob_console.engine.snapshot import Snapshot

LONGEST_SILENCE = 2.0
"""An engine whose time stands still for longer is called silent, s."""


class EngineLink:
    """An engine client that keeps the last snapshot.

    Args:
        client: the engine.
        monotonic: a clock for the engine's silence, s.

    Raises:
        MadrobError: the engine gives no snapshot at all.
    """

    def __init__(self, client: EngineClient, monotonic: Callable[[], float]) -> None:
        self._client = client
        self._monotonic = monotonic
        self._latest = client.snapshot()
        self._moved = monotonic()
        self._failure: str | None = None

    @property
    def trouble(self) -> str | None:
        """Why the snapshot cannot be trusted, in words; None when it can."""
        if self._failure is not None:
            return f"{self._failure}: what you see is old"
        silence = self._monotonic() - self._moved
        if silence > LONGEST_SILENCE:
            return f"the engine is silent for {silence:.0f} s: what you see is old"
        return None

    def snapshot(self) -> Snapshot:
        """The latest snapshot, or the last one that the engine gave."""
        try:
            snapshot = self._client.snapshot()
        except MadrobError as error:
            self._failure = str(error)
            return self._latest
        self._failure = None
        if snapshot.time != self._latest.time:
            self._moved = self._monotonic()
        self._latest = snapshot
        return snapshot

    def act(self, act: Act) -> str | None:
        """Hand in an act; returns why it did not take effect, None when it did."""
        try:
            return self._client.act(act)
        except MadrobError as error:
            return str(error)

    def next_run_number(self, subject: int, condition_number: int) -> int | str:
        """The next free run number, or why there is none."""
        try:
            return self._client.next_run_number(subject, condition_number)
        except MadrobError as error:
            return str(error)
