"""What programs around a testbed may ask of the engine, and what they hear of it.

The testbed's source carries it; an engine's owner answers.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Protocol, TypeAlias

if TYPE_CHECKING:
    from madrob_console.kinds import RemoteService


class Level(IntEnum):
    """How a part is; the numbers are those of `diagnostic_msgs/msg/DiagnosticStatus`."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """How one part of the console or of its testbed is.

    Attributes:
        name: of the part.
        level: how it is.
        message: in words, as the screens say it.
        values: numbers and names behind it, as text.
    """

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CallAnswer:
    """What became of a call.

    Attributes:
        success: whether it took effect.
        message: what a referee would read.
    """

    success: bool
    message: str


LookForAnswer: TypeAlias = Callable[[], CallAnswer | None]
"""Looks whether a call is answered: None = not yet. It never waits."""


class Outside(Protocol):
    """Answers programs that are no screens. From any thread; nothing waits."""

    @property
    def services(self) -> Collection[RemoteService]:
        """What may be called."""
        ...

    def call(self, service: RemoteService) -> LookForAnswer:
        """Have something done; it is answered in time, whatever core and disk do."""
        ...

    def diagnose(self) -> Sequence[Diagnosis]:
        """How everything is now."""
        ...
