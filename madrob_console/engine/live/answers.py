"""What acts were answered, so that one that comes twice is carried out once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

MOST_KNOWN = 1000
"""Acts whose answers are remembered."""

Told = Callable[[str | None], None]
"""Told once what became of an act: why it was refused, in words, or None."""


class _Known:
    """An act with an id: who waits for its answer, and the answer once there is one."""

    def __init__(self) -> None:
        self.answered = False
        self.refused: str | None = None
        self.waiting: list[Told] = []


class Answers:
    """Remembers acts by the ids that their screens made."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, _Known] = OrderedDict()

    def expect(self, name: str, done: Told) -> Told | None:
        """Who is to be told what becomes of an act.

        Args:
            name: its id; empty = it has none.
            done: who asks.

        Returns:
            To be told once; None if the act is known: then `done` gets the same answer as before.
        """
        if not name:
            return done
        known = self._known.get(name)
        if known is None:
            self._known[name] = known = _Known()
            known.waiting.append(done)
            while len(self._known) > MOST_KNOWN:
                self._known.popitem(last=False)
            return lambda refused: _tell(known, refused)
        if known.answered:
            done(known.refused)
        else:
            known.waiting.append(done)
        return None


def _tell(known: _Known, refused: str | None) -> None:
    known.answered, known.refused = True, refused
    waiting, known.waiting = known.waiting, []
    for done in waiting:
        done(refused)
