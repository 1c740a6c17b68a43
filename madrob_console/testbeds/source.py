"""A source of messages, what its testbed says of itself, and who else may ask."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Protocol, TypeAlias

import msgspec

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from recorder.bag import RawMessage

if TYPE_CHECKING:
    from madrob_console.common.names import RemoteService
    from recorder.bag import Topic
    from scoring.protocol import Condition

# All three hand over the same `RawMessage`s, so that everything behind a source is one path.


@dataclass(frozen=True, slots=True)
class TopicStatus:
    """What a source knows of one testbed topic.

    Attributes:
        topic: full topic name.
        type: the message type found on it, or the configured one while nothing is found.
        publishers: how many publishers are matched now.
        lost: messages lost on the way, by the publisher's sequence numbers; None = unknown.
        problem: why nothing can come from it (an unknown type, say), in words; else None.
    """

    topic: str
    type: str
    publishers: int
    lost: int | None = 0
    problem: str | None = None


class Source(Protocol):
    """A testbed, as the engine sees it. All calls come from the engine's thread."""

    @property
    def kind(self) -> SourceKind:
        """Where the messages come from."""
        ...

    @property
    def label(self) -> str:
        """For people: `LIVE ros domain 0`, `SIMULATED nominal`, `REPLAY <name>`.

        A simulated testbed over ROS: `SIMULATED over ROS domain 0`.
        """
        ...

    def open(self) -> None:
        """Connect.

        Raises:
            MadrobError: it cannot be reached; the message names the remedy.
        """
        ...

    def take(self, timeout: float) -> list[RawMessage]:
        """Messages since the last call, by receive time; waits at most `timeout` s of clock time.

        Never raises for what a topic sends.
        """
        ...

    def topics(self) -> Sequence[Topic]:
        """The testbed's topics known by now and the console's own, as a bag needs them."""
        ...

    def status(self) -> Sequence[TopicStatus]:
        """The state of every configured topic."""
        ...

    def configure(self, condition: Condition) -> None:
        """Set the testbed's parameters for a condition; returns at once, see `sides_problem`."""
        ...

    @property
    def sides_problem(self) -> str | None:
        """Why the sides must be set by hand, in words; None when the testbed confirmed them."""
        ...

    @property
    def announcement(self) -> Announcement:
        """What the testbed says of itself."""
        ...

    @property
    def other_referee(self) -> str | None:
        """Who else tells the testbed where the run stands, in words; None = nobody."""
        ...

    def publish(self, message: RawMessage) -> None:
        """Publish on one of the console's own topics (protocol section 3); never waits.

        What is published while the source is closed reaches nobody.
        """
        ...

    def attend(self, outside: Outside) -> None:
        """Let other programs of the testbed ask and hear; nobody does where there are none."""
        ...

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        ...


# What a testbed says of itself, once for all: `/madrob/testbed/info` (protocol section 2).


INFO_TOPIC = "/madrob/testbed/info"
INFO_TYPE = "std_msgs/msg/String"

LARGEST_INFO = 4096
"""A longer message is no announcement, bytes."""

_LONGEST_SCENARIO = 40
_UNNAMED = "it does not say what"


@dataclass(frozen=True, slots=True)
class Announcement:
    """What a testbed says of itself.

    Attributes:
        simulated: what a simulated one plays, in words: every run on it is practice; None = it is
            a real one, or says nothing.
        problem: why what it says cannot be understood, in words; None = it can.
        messages: what it said once for all, as it came, for recordings.
        simulated_time: `/clock` less the engine's clock, s; None = nobody publishes `/clock`.
    """

    simulated: str | None = None
    problem: str | None = None
    messages: tuple[RawMessage, ...] = ()
    simulated_time: float | None = None


SILENT = Announcement()
"""It says nothing of itself."""


class _Info(msgspec.Struct):
    kind: str
    scenario: str = ""


_infos = msgspec.json.Decoder(_Info)


def info_text(scenario: str) -> str:
    """What a simulated testbed announces."""
    return msgspec.json.encode(_Info(SourceKind.SIMULATED, scenario)).decode()


def simulated_in(text: str) -> str | None:
    """What a simulated testbed plays, by its announcement; None: it is of another kind.

    Raises:
        MadrobError: it is no announcement.
    """
    try:
        info = _infos.decode(text)
    except (msgspec.MsgspecError, RecursionError, UnicodeEncodeError):
        shown = terminal_safe(text[:_LONGEST_SCENARIO])
        raise MadrobError(
            f"not understood: '{shown}'; it tells a simulated testbed from a real one: stop what "
            "sends that"
        ) from None
    if info.kind != SourceKind.SIMULATED:
        return None
    return terminal_safe(info.scenario[:_LONGEST_SCENARIO]).strip() or _UNNAMED


# What programs around a testbed may ask of the engine, and what they hear of it.
#
# The testbed's source carries it; an engine's owner answers.


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
