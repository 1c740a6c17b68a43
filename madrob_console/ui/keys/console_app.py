"""What the parts of the screens ask of the program that they are shown by."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from madrob_console.kinds import ThemeName
    from madrob_console.ui.keys.key_table import Key


class ConsoleApp(Protocol):
    """The program.

    Attributes:
        rings: whether the bell rings.
    """

    rings: bool

    def ring(self) -> None:
        """Ring the terminal's bell, where that is wanted."""
        ...

    def toggle_bell(self) -> None:
        """Ring, or be silent."""
        ...

    def set_theme(self, name: ThemeName) -> None:
        """Change the colours, as far as the terminal has them."""
        ...

    def has_key(self, key: Key) -> bool:
        """Whether there is such a key now: those of a replay are there on a replay only."""
        ...

    def key_refusal(self, key: Key) -> str | None:
        """Why a key does nothing now; None when it does."""
        ...

    def action_press(self, name: str, pressed: str) -> Awaitable[None]:
        """A key of the console was pressed."""
        ...

    def withdraw(self) -> bool:
        """Take back what waits for the disk; False where nothing does."""
        ...
