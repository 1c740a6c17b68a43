"""The screens' end of the connection: an engine that fails becomes words, never an exception."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from madrob_console.errors import MadrobError
from madrob_console.referee.acts import Act

if TYPE_CHECKING:
    from madrob_console.engine.shown.client import EngineClient
    from madrob_console.engine.shown.curves import Curves
    from madrob_console.engine.shown.playback import AnyCommand
    from madrob_console.engine.shown.snapshot import Snapshot

LONGEST_SILENCE = 2.0
"""An engine whose time stands still for longer is called silent, s."""

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
        if self._latest is None or snapshot.time != self._latest.time or _stands(snapshot):
            self._moved = self._monotonic()
        self._latest = snapshot
        return snapshot

    def act(self, act: Act) -> str | None:
        """Hand in an act; returns why it did not take effect, None when it did."""
        if self._client is None:
            return NOT_YET
        try:
            return self._client.act(act)
        except MadrobError as error:
            return str(error)

    def next_run_number(self, subject: int, condition_number: int) -> int | str:
        """The next free run number, or why there is none."""
        if self._client is None:
            return NOT_YET
        try:
            return self._client.next_run_number(subject, condition_number)
        except MadrobError as error:
            return str(error)

    def open_run(self, folder: str, *, invalid: bool = False) -> str | None:
        """Show an earlier run; returns why that is not possible, None when it is shown."""
        if self._client is None:
            return NOT_YET
        try:
            return self._client.open_run(folder, invalid=invalid)
        except MadrobError as error:
            return str(error)

    def export_team(self, subject: int) -> str | None:
        """Pack a team's runs; returns why not, None when it is on its way."""
        if self._client is None:
            return NOT_YET
        try:
            return self._client.export_team(subject)
        except MadrobError as error:
            return str(error)

    def control(self, command: AnyCommand) -> str | None:
        """Pause, step or move a replay; returns why not."""
        if self._client is None:
            return NOT_YET
        try:
            return self._client.control(command)
        except MadrobError as error:
            return str(error)

    def take_over(self) -> str | None:
        """Take the right to act; returns why not."""
        if self._client is None:
            return NOT_YET
        try:
            return self._client.take_over()
        except MadrobError as error:
            return str(error)

    def curves(self) -> Curves | None:
        """What the figures show; None without a result.

        Raises:
            MadrobError: the engine has failed.
        """
        return None if self._client is None else self._client.curves()

    def close(self) -> None:
        """Let the engine go."""
        if self._client is not None:
            self._client.close()


def _stands(snapshot: Snapshot) -> bool:
    """Whether its time is meant to stand still."""
    playback = snapshot.playback
    return playback is not None and (playback.paused or playback.ended)
