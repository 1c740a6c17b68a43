"""The types of questions, and of what a key or an answer brings about: plain data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from madrob_console.engine.playback import PlaybackCommand
from madrob_console.engine.requests import ExportDossier, ExportTeam, GiveFrames, OpenRun, TakeOver
from madrob_console.referee.acts import Act


@dataclass(frozen=True, slots=True)
class Leave:
    """Leave the console."""


@dataclass(frozen=True, slots=True)
class Copy:
    """Copies a text to the clipboard; `what` names it."""

    name: ClassVar[str] = "copy"
    what: str
    text: str


@dataclass(frozen=True, slots=True)
class OtherName:
    """The next run's team has another name than in the list of teams; `name` is cleaned."""

    subject: int
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Press:
    """Presses the key of that name (`key_table.KEYS`), as chosen in the menu."""

    name: str
    pressed: str


Intent: TypeAlias = (
    "Act | PlaybackCommand | OpenRun | TakeOver | ExportTeam | ExportDossier | GiveFrames | Leave"
    " | Copy | OtherName | Press | Ask | str"
)
"""What a key or an answer brings about, maybe one more question; a text says why nothing."""


@dataclass(frozen=True, slots=True)
class Option:
    """One answer; a `value` of None does nothing, and a `free` one asks for a text instead.

    After a `last` one nothing more is asked. The one without a label is not listed: the words
    beside the options tell of its key.
    """

    key: str
    label: str
    value: str | None
    free: bool = False
    last: bool = False


@dataclass(frozen=True, slots=True)
class Pick:
    """A choice among options; Enter takes the marked one.

    The first option is marked if it does nothing or the question is `quick`: an act that `z` takes
    back, or one more question. Else none is. `listed` stands above the options, `below` under them.

    Raises:
        ValueError: two options have the same key: the second could never be chosen.
    """

    text: str
    options: tuple[Option, ...]
    listed: tuple[str, ...] = ()
    below: tuple[str, ...] = ()
    quick: bool = False

    def __post_init__(self) -> None:
        keys = [option.key for option in self.options]
        if len(set(keys)) < len(keys):
            raise ValueError(f"{self.text!r}: two options have the same key, of {' '.join(keys)}")

    @property
    def marked(self) -> int:
        """The option that is marked at first; -1 = none."""
        first = self.options[0]
        return 0 if self.quick or (first.value is None and not first.free) else -1


@dataclass(frozen=True, slots=True)
class Write:
    """Asks for a text. `missing` is the refusal of an empty one; empty = an empty text will do."""

    text: str
    initial: str = ""
    missing: str = ""


@dataclass(frozen=True, slots=True)
class Sure:
    """Only `y` goes on; Enter, n and Escape close the dialog."""

    text: str


Question = Pick | Write | Sure


@dataclass(frozen=True, slots=True)
class Ask:
    """A dialog; `make` gets the answers of its `Pick` and `Write` questions, in order."""

    title: str
    questions: tuple[Question, ...]
    make: Callable[..., Intent]

    @property
    def shortest(self) -> Ask:
        """For a screen with one free line: a question after a reason goes without it."""
        if len(self.questions) < 2 or not isinstance(self.questions[-1], Sure):
            return self
        title = self.title.partition(":")[0]
        return Ask(title, self.questions[-1:], lambda: self.make(NO_REASON))


NO_REASON = "no reason given"
"""The reason unless the referee chooses another; it makes no claim about the robot."""


def reasons(*texts: str) -> tuple[Option, ...]:
    """A short list of reasons under digits, and free text under `o`."""
    listed = (Option(str(number), text, text) for number, text in enumerate(texts, 1))
    return (*listed, Option("o", "other: type it", None, free=True))


def ask_why(*texts: str) -> Pick:
    """The reason of an act that changes a result: Enter and `n` do nothing."""
    no = Option("n", "no", None)
    none = Option(" ", NO_REASON, NO_REASON)
    return Pick("Why?", (no, none, *reasons(*texts)))
