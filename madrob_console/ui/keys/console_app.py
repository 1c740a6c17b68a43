"""What screens ask of the app around them."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from madrob_console.ui.keys.key_table import Key


class ConsoleApp(Protocol):
    """The app around the screens."""

    rings: bool

    def ring(self) -> None: ...

    def toggle_bell(self) -> None: ...

    def set_theme(self, name: str) -> None: ...

    def has_key(self, key: Key) -> bool:
        """Whether the key exists now: keys of a replay do so on a replay only."""
        ...

    def key_refusal(self, key: Key) -> str | None: ...

    def action_press(self, name: str, pressed: str) -> Awaitable[None]: ...

    def withdraw(self) -> bool:
        """Withdraws what waits for the disk; False if nothing does."""
        ...
