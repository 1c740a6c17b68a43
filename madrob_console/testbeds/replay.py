"""A recorded bag as a source: the same messages at the same instants."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from madrob_console.clock import NS, VirtualClock, nanoseconds
from madrob_console.errors import MadrobError
from madrob_console.testbeds.announcements import Announcements
from madrob_console.testbeds.messages import (
    REFEREE_EVENT_TOPIC,
    MessageError,
    MessageTypes,
    TopicMapping,
    decode_text,
    referee_topics,
)
from madrob_console.testbeds.source import RefereeState, SourceKind, TopicStatus
from recorder.bag import Topic
from recorder.errors import RecorderError
from recorder.message import RawMessage
from recorder.reader import Bag, read_bag
from scoring.protocol import Condition, StartPose


class ReplayClock(VirtualClock):
    """Recorded time: it moves only to where a replay takes it.

    Args:
        start_ns: where it begins, ns since the epoch.
        speed: how many times as fast as real time it passes; 0 = as fast as possible.
        monotonic: real time, s.
        wait: lets real time pass, s.
    """

    def __init__(
        self,
        start_ns: int,
        speed: float = 1.0,
        monotonic: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(start_ns)
        self.speed = speed
        self._monotonic = monotonic
        self._wait = wait
        self._start_ns = start_ns
        self._began: float | None = None

    def sleep(self, duration: float) -> None:
        """Move on by `duration` seconds, not before its share of real time has passed."""
        target = self.now_ns() + nanoseconds(max(0.0, duration))
        if self.speed > 0:
            if self._began is None:
                self._began = self._monotonic()
            due = self._began + (target - self._start_ns) / NS / self.speed
            self._wait(max(0.0, due - self._monotonic()))
        self.advance_to(target)


@dataclass(frozen=True, slots=True)
class JournalLine:
    """One line of the recorded run's journal.

    Attributes:
        time_ns: when it was recorded, ns since the epoch.
        text: JSON.
    """

    time_ns: int
    text: str


class ReplaySource:
    """Plays a bag.

    What the testbed sent comes again, in the order in which it is stored. What the console
    itself said is kept aside: the journal in `journal_lines`, the rest in the bag's `records`.

    Args:
        path: a bag folder or an `.mcap` file.
        types: the types known; those of the bag are registered.
        speed: how many times as fast as it was; 0 = as fast as possible.
        mappings: the configured topics; None = whatever the bag holds.

    Attributes:
        path: the bag.
        clock: recorded time; the engine must use this clock.
        journal_lines: the lines of `/madrob/referee/event`, in order.
        records: the bag's metadata records by name.
        problems: what of the bag cannot be used, in words.

    Raises:
        MadrobError: the bag cannot be read or holds nothing, or the speed is negative.
    """

    def __init__(
        self,
        path: Path,
        types: MessageTypes,
        speed: float = 1.0,
        mappings: Sequence[TopicMapping] | None = None,
    ) -> None:
        if not 0 <= speed < float("inf"):
            raise MadrobError(f"replay speed {speed:g} is impossible: use 0 or more")
        try:
            self._bag = read_bag(path)
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        self.path = path
        self.records = self._bag.records
        self._own = {topic.name: topic for topic in referee_topics(types)}
        self._topics = tuple(t for t in self._bag.topics() if t.name not in self._own)
        self._type_problems = {t.name: _register(t, types) for t in self._topics}
        self._mappings = mappings
        start_ns, self.journal_lines, problems = _survey(self._bag, types)
        self.problems = tuple(p for p in (*problems, self._bag.problem) if p)
        if start_ns is None:
            raise MadrobError(f"{path} holds no messages; choose another bag")
        self.clock = ReplayClock(start_ns, speed)
        self._announcements = Announcements(types, self.clock)
        self._messages: Iterator[RawMessage] = iter(())
        self._next: RawMessage | None = None
        self._opened = self._closed = False

    @property
    def kind(self) -> SourceKind:
        """Where the messages come from."""
        return SourceKind.REPLAY

    @property
    def label(self) -> str:
        """For people: `REPLAY <name>`."""
        return f"REPLAY {self.path.name}"

    @property
    def ended(self) -> bool:
        """Whether the last message has been taken."""
        return self._closed or (self._opened and self._next is None)

    def open(self) -> None:
        """Go to the first message."""
        if not self._opened:
            self._opened = True
            self._messages = (m for m in self._bag.messages() if m.topic not in self._own)
            self._next = next(self._messages, None)

    def take(self, timeout: float) -> list[RawMessage]:
        """The messages recorded within the next `timeout` s, in the order of the bag."""
        self.clock.sleep(timeout)
        now, messages = self.clock.now_ns(), []
        while self._next is not None and self._next.receive_ns <= now and not self._closed:
            messages.append(self._next)
            self._next = next(self._messages, None)
        return messages

    def topics(self) -> Sequence[Topic]:
        """The testbed's topics as recorded, and the console's own."""
        return (*self._topics, *self._own.values())

    def status(self) -> Sequence[TopicStatus]:
        """The state of every configured topic; losses during the recording are not known."""
        present = {topic.name: topic for topic in self._topics}
        names = {name: topic.type for name, topic in present.items()}
        if self._mappings is not None:
            names = {m.topic: m.type for m in self._mappings}
        publishers = int(self._opened and not self.ended)
        return tuple(
            TopicStatus(name, present[name].type, publishers, None, self._type_problems[name])
            if name in present
            else TopicStatus(name, type_name, 0, None, "not in the recording")
            for name, type_name in names.items()
        )

    def configure(self, condition: Condition) -> None:
        """Nothing to set: the testbed was set when the bag was recorded."""

    @property
    def sides_problem(self) -> str | None:
        """Nothing has to be set by hand."""
        return None

    def announce_state(self, state: RefereeState) -> list[RawMessage]:
        """Nobody listens; returns what would be published, to be recorded."""
        return self._announcements.state(state.text)

    def announce_event(self, text: str) -> list[RawMessage]:
        """Nobody listens; returns what would be published, to be recorded."""
        return self._announcements.event(text)

    def announce_start_pose(self, pose: StartPose) -> list[RawMessage]:
        """Nobody listens; returns what would be published, to be recorded."""
        return self._announcements.start_pose(pose)

    def close(self) -> None:
        """Let go of the bag; safe to call twice."""
        self._closed = True
        self._messages, self._next = iter(()), None


def _register(topic: Topic, types: MessageTypes) -> str | None:
    """Make a recorded topic's type known; returns why that is not possible."""
    if not topic.definition:
        return None if types.knows(topic.type) else f"the bag does not define {topic.type}"
    try:
        types.register(topic.type, topic.definition)
    except MadrobError as error:
        return str(error)
    return None


def _survey(
    bag: Bag, types: MessageTypes
) -> tuple[int | None, tuple[JournalLine, ...], tuple[str, ...]]:
    """Read a bag once: its first instant, its journal, and lines that cannot be read."""
    start_ns: int | None = None
    lines: list[JournalLine] = []
    problems: list[str] = []
    for message in bag.messages():
        start_ns = message.receive_ns if start_ns is None else min(start_ns, message.receive_ns)
        if message.topic == REFEREE_EVENT_TOPIC:
            try:
                lines.append(JournalLine(message.receive_ns, decode_text(types, message.data)))
            except MessageError as error:
                problems.append(f"{message.topic}: {error}")
    return start_ns, tuple(lines), tuple(problems)
