"""A source of messages, what its testbed says of itself, and who else may ask.

All three hand over the same `RawMessage`s, so that everything behind a source is one path.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from madrob_console.common.names import SourceKind
from madrob_console.testbeds.announcement import SILENT, Announcement
from recorder.bag import RawMessage

if TYPE_CHECKING:
    from recorder.bag import Topic
    from scoring.protocol import Condition


@dataclass(frozen=True, slots=True)
class TopicStatus:
    """The state of one testbed topic; `type` is the one found, else the configured one.

    `publishers` are those matched now that send, as far as can be told. `lost` is by their sequence
    numbers; None = unknown.
    """

    topic: str
    type: str
    publishers: int
    lost: int | None = 0
    problem: str | None = None


class Source(ABC):
    """A testbed, as the engine sees it. Only the engine's thread calls it.

    What only a testbed in a ROS domain has, others leave as it is here: nobody else is there.
    """

    @property
    @abstractmethod
    def kind(self) -> SourceKind:
        """Where the messages come from."""

    @property
    @abstractmethod
    def label(self) -> str:
        """For people: `LIVE ros domain 0`, `SIMULATED over ROS domain 0`, `REPLAY <name>`."""

    @abstractmethod
    def open(self) -> None:
        """Connects; raises MadrobError with the remedy where the testbed cannot be reached."""

    @abstractmethod
    def take_messages(self, timeout: float) -> list[RawMessage]:
        """Messages by receive time; waits up to `timeout` s of clock time; never raises."""

    @abstractmethod
    def topics(self) -> Sequence[Topic]:
        """The topics of its messages."""

    @abstractmethod
    def status(self) -> Sequence[TopicStatus]:
        """Of each configured topic."""

    def configure(self, condition: Condition) -> None:  # noqa: B027  not abstract
        """Sets the testbed's parameters for a condition; returns at once, see `sides_problem`."""

    @property
    def sides_problem(self) -> str | None:
        """Why the sides must be set by hand, in words."""
        return None

    @property
    def announcement(self) -> Announcement:
        """What the testbed says of itself."""
        return SILENT

    @property
    def robot_problems(self) -> Mapping[str, str]:
        """Why what the robot says cannot be taken, in words, by topic."""
        return {}

    @property
    def other_referee(self) -> str | None:
        """Another node that publishes the run state to the testbed, in words; None = nobody."""
        return None

    def publish(self, message: RawMessage) -> None:  # noqa: B027  not abstract
        """Publishes on one of the console's own topics (protocol section 3); never waits."""

    @abstractmethod
    def close(self) -> None:
        """Disconnects."""
