"""Counting lost messages by the publisher's own sequence numbers."""

from __future__ import annotations

from collections.abc import Iterable


class LossCounter:
    """Gaps in the sequence numbers of a topic's only publisher.

    With several publishers the numbers of one cannot be told from those of another: the loss
    is then unknown, until one is left.
    """

    def __init__(self) -> None:
        self._lost = 0
        self._last: int | None = None
        self._several = False
        self._numbered = True

    @property
    def lost(self) -> int | None:
        """Messages lost so far; None = unknown."""
        return None if self._several or not self._numbered else self._lost

    def restart(self) -> None:
        """The publisher is another one: its numbers start anew."""
        self._last = None

    def see(self, numbers: Iterable[int | None], publishers: int) -> None:
        """Count the messages of one take.

        Args:
            numbers: sequence numbers in the order of arrival; None = the middleware has none.
            publishers: how many publishers were matched, at most, during the take.
        """
        self._several = publishers > 1
        if not self._several:
            last = self._last
            for number in numbers:
                if number is None:
                    self._numbered = False
                elif last is None or number > last:
                    self._lost += 0 if last is None else number - last - 1
                    last = number
            self._last = last
        if publishers != 1:
            self.restart()
