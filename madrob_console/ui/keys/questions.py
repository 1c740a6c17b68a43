"""What a dialog asks before an act: plain data, no terminal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from madrob_console.engine.shown.playback import AnyCommand
from madrob_console.referee.acts import Act


@dataclass(frozen=True, slots=True)
class Option:
    """One answer to a question.

    Attributes:
        key: the key that chooses it.
        label: in words.
        value: what is handed on; None = close the dialog, nothing happens.
        free: ask for a text instead of handing on `value`.
    """

    key: str
    label: str
    value: str | None
    free: bool = False


@dataclass(frozen=True, slots=True)
class Pick:
    """Choose one; Enter takes the marked one, which is the first to begin with."""

    text: str
    options: tuple[Option, ...]


@dataclass(frozen=True, slots=True)
class Write:
    """Type a text. `missing` refuses an empty one in words; empty = an empty text will do."""

    text: str
    initial: str = ""
    missing: str = ""


@dataclass(frozen=True, slots=True)
class Sure:
    """Only `y` goes on; Enter, n and Escape close the dialog."""

    text: str


Question = Pick | Write | Sure


@dataclass(frozen=True, slots=True)
class Leave:
    """Leave the console."""


@dataclass(frozen=True, slots=True)
class Open:
    """Open an earlier run; `invalid`: one that was cut off does not count."""

    folder: str
    invalid: bool = False


Deed = Act | AnyCommand | Leave | Open | str
"""What the answers bring about; a text says why nothing."""


@dataclass(frozen=True, slots=True)
class Ask:
    """A dialog.

    Attributes:
        title: what it is about.
        questions: asked one after the other.
        deed: makes it out of the answers of `Pick` and `Write`, in order.
    """

    title: str
    questions: tuple[Question, ...]
    deed: Callable[..., Deed]

    @property
    def shortest(self) -> Ask:
        """For a screen with room for one line: a question after a reason goes without it."""
        if len(self.questions) < 2 or not isinstance(self.questions[-1], Sure):
            return self
        title = self.title.partition(":")[0]
        return Ask(title, self.questions[-1:], lambda: self.deed("none given"))


def reasons(*texts: str) -> tuple[Option, ...]:
    """A short list of reasons under digits, and free text under `o`."""
    listed = (Option(str(number), text, text) for number, text in enumerate(texts, 1))
    return (*listed, Option("o", "other: type it", None, free=True))
