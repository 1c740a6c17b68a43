"""How much of a journal a result is made of: the result says so, and can be held to it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

from madrob_console.referee.acts import (
    Correct,
    DecideProtest,
    FileProtest,
    Finalise,
    Reissue,
    TakeBack,
    Void,
    WithdrawProtest,
)
from madrob_console.referee.journal import Entry
from madrob_console.referee.on_record import JournalMark
from madrob_console.referee.rebuild import Change

_BESIDE = {
    *(Change.EVENT, Change.EVIDENCE, Change.EVIDENCE_REMOVED),
    *(Change.RESULT_WRITTEN, Change.WITHDRAWN),
}
"""From these no result changes; where they stand among the others may differ."""

_OPENING = (Reissue, Void, Correct, TakeBack, FileProtest, DecideProtest, WithdrawProtest)
_OPENS = {*(act.name for act in _OPENING), Change.REISSUED}
"""They open a final result again."""


def mark_of(entries: Iterable[Entry]) -> JournalMark:
    """The mark of a journal as it was read."""
    growing = GrowingMark()
    for entry in entries:
        growing.add(entry)
    return growing.mark


class GrowingMark:
    """The mark of a journal that is still written.

    Attributes:
        mark: of all lines so far.
    """

    def __init__(self) -> None:
        self._lines = 0
        self._digest = hashlib.sha256()
        self._final = False
        self.mark = JournalMark(0, self._digest.hexdigest())

    def add(self, entry: Entry) -> None:
        """One more line."""
        if entry.what in _BESIDE:
            return
        self._digest.update(f"{entry.to_json()}\n".encode())
        self._lines += 1
        if not self._final or entry.what in _OPENS:
            self.mark = JournalMark(self._lines, self._digest.hexdigest())
            self._final = entry.what == Finalise.name
