"""A recorded bag as a source: the same messages at the same instants, on a clock of its own."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.common.recorded_clock import LONGEST, RecordedClock
from madrob_console.messages.codec import REFEREE_EVENT_TOPIC, decode_text, referee_topics
from madrob_console.messages.mapping import TopicMapping
from madrob_console.messages.types import MessageError, MessageTypes
from madrob_console.testbeds.source import Source, TopicStatus
from recorder import RecorderError
from recorder.bag import RawMessage, Topic
from recorder.reader import Bag

MOST_KEPT = 150_000
"""Messages kept in memory, about seven minutes; a longer bag is read again at each restart."""


class RecordedBag(Source):
    """A recorded testbed; each `open` replays its messages in their order.

    The console's own messages are kept aside: the JSON lines of `/madrob/referee/event` in
    `journal_lines`.
    """

    kind = SourceKind.REPLAY

    def __init__(
        self,
        path: Path,
        types: MessageTypes,
        speed: float = 1.0,
        monotonic: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        try:
            self._bag = Bag(path)
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        self.path = path
        self._own = frozenset(topic.name for topic in referee_topics(types))
        self._topics = tuple(t for t in self._bag.topics() if t.name not in self._own)
        self._type_problems = {t.name: _register(t, types) for t in self._topics}
        self._mappings: Sequence[TopicMapping] = ()
        self._kept: list[RawMessage] | None = []
        self._problems: list[str] = []
        self.journal_lines: list[str] = []
        self.begin_ns, self.end_ns = 0, -1
        self._survey(types)
        if self.end_ns < self.begin_ns:
            more = f" ({self._bag.problem})" if self._bag.problem else ""
            raise MadrobError(f"{path} holds no messages{more}; choose another bag")
        if (duration := (self.end_ns - self.begin_ns) / 1e9) > LONGEST:
            raise MadrobError(
                f"{path}: its messages lie {duration / 86400:.0f} days apart, that is no run; "
                "choose another bag"
            )
        self.clock = RecordedClock(self.begin_ns, self.end_ns, speed, monotonic, wait)
        self._messages: Iterator[RawMessage] = iter(())
        self._next: RawMessage | None = None

    def _survey(self, types: MessageTypes) -> None:
        for message in self._bag.messages():
            at = message.receive_ns
            self.begin_ns = at if self.end_ns < 0 else min(self.begin_ns, at)
            self.end_ns = max(self.end_ns, at)
            if self._kept is not None and message.topic not in self._own:
                self._kept.append(message)
                if len(self._kept) > MOST_KEPT:
                    self._kept = None
            if message.topic == REFEREE_EVENT_TOPIC:
                try:
                    self.journal_lines.append(decode_text(types, message.data))
                except MessageError as error:
                    self._problems.append(f"{message.topic}: {error}")

    @property
    def label(self) -> str:
        return f"REPLAY {self.path.name}"

    @property
    def problems(self) -> tuple[str, ...]:
        return tuple(p for p in (*self._problems, self._bag.problem) if p)

    def expect(self, mappings: Sequence[TopicMapping]) -> None:
        self._mappings = tuple(mappings)

    def open(self) -> None:
        self._messages = iter(self._kept or _of_testbed(self._bag, self._own))
        self._next = next(self._messages, None)

    def take_messages(self, timeout: float) -> list[RawMessage]:
        self.clock.sleep(timeout)
        until_ns = self.clock.now_ns()
        messages = []
        while self._next is not None and self._next.receive_ns <= until_ns:
            messages.append(self._next)
            self._next = next(self._messages, None)
        return messages

    def topics(self) -> Sequence[Topic]:
        return self._topics

    def status(self) -> Sequence[TopicStatus]:
        present = {topic.name: topic for topic in self._topics}
        missing = (m for m in self._mappings if m.topic not in present)
        return (
            *(
                TopicStatus(name, topic.type, 1, None, self._type_problems[name])
                for name, topic in present.items()
            ),
            *(
                TopicStatus(
                    m.topic,
                    m.type,
                    0,
                    None,
                    None if m.signal.optional else "not in the recording",
                )
                for m in missing
            ),
        )

    def close(self) -> None:
        self._messages, self._next = iter(()), None


def _register(topic: Topic, types: MessageTypes) -> str | None:
    if not topic.definition:
        return None if types.knows(topic.type) else f"the bag does not define {topic.type}"
    try:
        types.register(topic.type, topic.definition)
    except MadrobError as error:
        return str(error)
    return None


def _of_testbed(bag: Bag, own: frozenset[str]) -> Iterator[RawMessage]:
    return (message for message in bag.messages() if message.topic not in own)
