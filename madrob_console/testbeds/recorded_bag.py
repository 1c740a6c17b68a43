"""A recorded bag as a source: the same messages at the same instants."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    MessageError,
    MessageTypes,
    TopicMapping,
    decode_text,
    referee_topics,
)
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import Topic
from recorder.errors import RecorderError
from recorder.message import RawMessage
from recorder.reader import Bag, read_bag
from scoring.protocol import Signal

LONGEST = 200_000
"""No run takes longer, s: the longest timeout is a day."""


class ReplaySource:
    """Plays a bag, as often as it is opened.

    What the testbed sent comes again, in the order in which it is stored. What the console
    itself said is kept aside: the journal in `journal_lines`, the rest in the bag's `records`.

    Args:
        path: a bag folder or an `.mcap` file.
        types: the types known; those of the bag are registered.

    Attributes:
        path: the bag.
        begin_ns, end_ns: its first and its last instant, ns since the epoch.
        journal_lines: the lines of `/madrob/referee/event`, JSON, in order.
        records: the bag's metadata records by name.

    Raises:
        MadrobError: the bag cannot be read or holds nothing, or its times make no sense.
    """

    def __init__(self, path: Path, types: MessageTypes) -> None:
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
        survey = _survey(self._bag, types)
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
        self._problems = survey.problems
        self._messages: Iterator[RawMessage] = iter(())
        self._next: RawMessage | None = None

    @property
    def kind(self) -> SourceKind:
        """Where the messages come from."""
        return SourceKind.REPLAY

    @property
    def label(self) -> str:
        """For people: `REPLAY <name>`."""
        return f"REPLAY {self.path.name}"

    @property
    def problems(self) -> tuple[str, ...]:
        """What of the bag cannot be used, in words."""
        return tuple(p for p in (*self._problems, self._bag.problem) if p)

    @property
    def ended(self) -> bool:
        """Whether the last message has been taken."""
        return self._next is None

    def expect(self, mappings: Sequence[TopicMapping]) -> None:
        """These are the configured topics; without that, whatever the bag holds."""
        self._mappings = tuple(mappings)

    def open(self) -> None:
        """Go to the first message."""
        self._messages = (m for m in self._bag.messages() if m.topic not in self._own)
        self._next = next(self._messages, None)

    def take(self, until_ns: int) -> list[RawMessage]:
        """The next messages up to an instant, ns since the epoch, in the order of the bag."""
        messages = []
        while self._next is not None and self._next.receive_ns <= until_ns:
            messages.append(self._next)
            self._next = next(self._messages, None)
        return messages

    def status(self) -> Sequence[TopicStatus]:
        """The topics of the bag and those that it lacks; what was lost on its way is not known."""
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
                    None if m.signal is Signal.LATCH else "not in the recording",
                )
                for m in missing
            ),
        )

    def close(self) -> None:
        """Let go of the bag; safe to call twice."""
        self._messages, self._next = iter(()), None


@dataclass(frozen=True, slots=True)
class _Survey:
    begin_ns: int
    end_ns: int
    journal_lines: tuple[str, ...]
    problems: tuple[str, ...]


def _register(topic: Topic, types: MessageTypes) -> str | None:
    """Make a recorded topic's type known; returns why that is not possible."""
    if not topic.definition:
        return None if types.knows(topic.type) else f"the bag does not define {topic.type}"
    try:
        types.register(topic.type, topic.definition)
    except MadrobError as error:
        return str(error)
    return None


def _survey(bag: Bag, types: MessageTypes) -> _Survey | None:
    """Read a bag once: its instants, its journal, lines that cannot be read; None if empty."""
    begin_ns: int | None = None
    end_ns = 0
    lines: list[str] = []
    problems: list[str] = []
    for message in bag.messages():
        at = message.receive_ns
        begin_ns = at if begin_ns is None else min(begin_ns, at)
        end_ns = max(end_ns, at)
        if message.topic == REFEREE_EVENT_TOPIC:
            try:
                lines.append(decode_text(types, message.data))
            except MessageError as error:
                problems.append(f"{message.topic}: {error}")
    if begin_ns is None:
        return None
    return _Survey(begin_ns, end_ns, tuple(lines), tuple(problems))
