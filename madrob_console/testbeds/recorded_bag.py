"""A recorded bag as a source: the same messages at the same instants, on a clock of its own."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from madrob_console.common.clock import LONGEST, RecordedClock
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    TopicMapping,
    decode_text,
    referee_topics,
)
from madrob_console.messages.message_types import MessageError, MessageTypes
from madrob_console.testbeds.source import OfflineSource, TopicStatus
from recorder.bag import RawMessage, Topic
from recorder.errors import RecorderError
from recorder.reader import Bag, read_bag

MOST_KEPT = 150_000
"""Messages kept in memory, about seven minutes; a longer bag is read again at each restart."""


class RecordedBag(OfflineSource):
    """A recorded testbed; each `open` replays its messages in stored order.

    The console's own messages are kept aside: the JSON lines of `/madrob/referee/event` in
    `journal_lines`, the metadata in `records`.
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
            self._bag = read_bag(path)
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        self.path = path
        self.records = self._bag.records
        self._own = frozenset(topic.name for topic in referee_topics(types))
        self._topics = tuple(t for t in self._bag.topics() if t.name not in self._own)
        self._type_problems = {t.name: _register(t, types) for t in self._topics}
        self._mappings: Sequence[TopicMapping] = ()
        survey = _survey(self._bag, self._own, types)
        if survey is None:
            more = f" ({self._bag.problem})" if self._bag.problem else ""
            raise MadrobError(f"{path} holds no messages{more}; choose another bag")
        self.begin_ns, self.end_ns = survey.begin_ns, survey.end_ns
        self.journal_lines = survey.journal_lines
        if (duration := (self.end_ns - self.begin_ns) / 1e9) > LONGEST:
            raise MadrobError(
                f"{path}: its messages lie {duration / 86400:.0f} days apart, that is no run; "
                "choose another bag"
            )
        self.clock = RecordedClock(self.begin_ns, self.end_ns, speed, monotonic, wait)
        self._problems = survey.problems
        self._kept = survey.messages
        self._messages: Iterator[RawMessage] = iter(())
        self._next: RawMessage | None = None

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


@dataclass(frozen=True, slots=True)
class _Survey:
    messages: list[RawMessage] | None
    begin_ns: int
    end_ns: int
    journal_lines: tuple[str, ...]
    problems: tuple[str, ...]


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


def _survey(bag: Bag, own: frozenset[str], types: MessageTypes) -> _Survey | None:
    messages: list[RawMessage] | None = []
    begin_ns: int | None = None
    end_ns = 0
    lines: list[str] = []
    problems: list[str] = []
    for message in bag.messages():
        at = message.receive_ns
        begin_ns = at if begin_ns is None else min(begin_ns, at)
        end_ns = max(end_ns, at)
        if messages is not None and message.topic not in own:
            messages.append(message)
            if len(messages) > MOST_KEPT:
                messages = None
        if message.topic == REFEREE_EVENT_TOPIC:
            try:
                lines.append(decode_text(types, message.data))
            except MessageError as error:
                problems.append(f"{message.topic}: {error}")
    if begin_ns is None:
        return None
    return _Survey(messages, begin_ns, end_ns, tuple(lines), tuple(problems))
