"""What a screen may ask of the engine."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from madrob_console.engine.shown.curves import Curves
    from madrob_console.engine.shown.playback import AnyCommand
    from madrob_console.engine.shown.snapshot import Snapshot
    from madrob_console.referee.acts import Act


class Role(StrEnum):
    """What a screen is there for."""

    REFEREE = "referee"
    WATCH = "watch"


class EngineClient(Protocol):
    """A connection to an engine.

    No call but `open_run` waits for more than a moment.
    """

    def snapshot(self) -> Snapshot:
        """The latest snapshot."""
        ...

    def act(self, act: Act) -> str | None:
        """Hand in an act; returns the refusal in words, None when it took effect."""
        ...

    def next_run_number(self, subject: int, condition_number: int) -> int:
        """The next run number that was never used for this subject and condition."""
        ...

    def open_run(self, folder: str, *, invalid: bool = False) -> str | None:
        """Show an earlier run; takes as long as reading its bag.

        Args:
            folder: its name in the results folder.
            invalid: a run that was cut off does not count; else it is interrupted.

        Returns:
            Why that is not possible, in words; None when it is shown.
        """
        ...

    def export_team(self, subject: int) -> str | None:
        """Pack a team's runs into a zip, in the background; `Snapshot.export` tells the rest.

        Returns:
            Why that is not possible, in words; None when it is on its way.
        """
        ...

    def curves(self) -> Curves | None:
        """What the figures show of the run with a result; None without one."""
        ...

    def control(self, command: AnyCommand) -> str | None:
        """Pause, step or move a replay; returns why not, None when it is done or on its way."""
        ...

    def take_over(self) -> str | None:
        """Take the right to act from another screen; returns why not."""
        ...

    def close(self) -> None:
        """End the connection; an engine in this process ends with it."""
        ...
