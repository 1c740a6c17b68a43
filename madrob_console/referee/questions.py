"""What a dialog asks before an act: plain data, no terminal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

T_co = TypeVar("T_co", covariant=True)


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

    @property
    def harmless(self) -> bool:
        """Whether nothing happens by it."""
        return self.value is None and not self.free


NOTHING = Option("n", "nothing: close this", None)
"""The first option of every question that has no other by which nothing happens."""


@dataclass(frozen=True, slots=True)
class Pick:
    """Choose one; Enter takes the marked one.

    To begin with that is the first, by which nothing happens, whatever the question.

    Attributes:
        text: the question.
        options: the answers.
        listed: what has to be seen before it is answered, a row each.

    Raises:
        ValueError: two options have the same key: the second could never be chosen.
    """

    text: str
    options: tuple[Option, ...]
    listed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not any(option.harmless for option in self.options):
            object.__setattr__(self, "options", (NOTHING, *self.options))
        keys = [option.key for option in self.options]
        if len(set(keys)) < len(keys):
            raise ValueError(f"{self.text!r}: two options have the same key, of {' '.join(keys)}")
        if not self.options[0].harmless:
            raise ValueError(f"{self.text!r}: the option by which nothing happens comes first")


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
class Ask(Generic[T_co]):
    """A dialog.

    Attributes:
        title: what it is about.
        questions: asked one after the other.
        make: makes what is wanted out of the answers of `Pick` and `Write`, in order.
    """

    title: str
    questions: tuple[Question, ...]
    make: Callable[..., T_co]

    @property
    def shortest(self) -> Ask[T_co]:
        """For a screen with room for one line: a question after a reason goes without it."""
        if len(self.questions) < 2 or not isinstance(self.questions[-1], Sure):
            return self
        title = self.title.partition(":")[0]
        return Ask(title, self.questions[-1:], lambda: self.make("none given"))


def reasons(*texts: str) -> tuple[Option, ...]:
    """A short list of reasons under digits, and free text under `o`."""
    listed = (Option(str(number), text, text) for number, text in enumerate(texts, 1))
    return (*listed, Option("o", "other: type it", None, free=True))


def meanwhile(*texts: str) -> Pick:
    """Why a run is to end; who takes the first answer ends nothing."""
    no = Option("n", "no, the run goes on", None)
    return Pick("Why? The run and its clock go on meanwhile.", (no, *reasons(*texts)))
