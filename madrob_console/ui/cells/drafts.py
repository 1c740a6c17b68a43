"""Texts of an act that was refused: there again when the same is asked of the same run."""

from __future__ import annotations

from typing import NamedTuple


class DraftKey(NamedTuple):
    """A question for a text.

    Attributes:
        name: of what opened the dialog.
        about: which run it is about, and the title of the dialog.
        question: in words.
    """

    name: str
    about: str
    question: str


class Drafts:
    """What was typed into dialogs, until the act that it is for takes effect."""

    def __init__(self) -> None:
        self._typed: dict[DraftKey, str] = {}
        self._kept: dict[DraftKey, str] = {}

    def typed(self, asked: DraftKey, text: str) -> None:
        """A question is answered with a text."""
        self._typed[asked] = text

    def kept(self, asked: DraftKey) -> str:
        """What was answered when the act was refused; empty = nothing."""
        return self._kept.get(asked, "")

    def refused(self, name: str) -> None:
        """The act of the dialogs of that name was refused."""
        self._kept |= {asked: text for asked, text in self._typed.items() if asked.name == name}
        self.left()

    def done(self, name: str) -> None:
        """It took effect."""
        self._kept = {asked: text for asked, text in self._kept.items() if asked.name != name}
        self.left()

    def left(self) -> None:
        """The dialog was closed: nothing came of it."""
        self._typed = {}
