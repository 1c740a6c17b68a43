"""What the engine asks of a testbed: live over ROS, simulated, or recorded in a bag.

All three hand over the same `RawMessage`s, so that everything behind a source is one path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from madrob_console.kinds import SourceKind
    from madrob_console.testbeds.announcement import Announcement
    from madrob_console.testbeds.outside import Outside
    from recorder.bag import Topic
    from recorder.message import RawMessage
    from scoring.protocol import Condition


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
