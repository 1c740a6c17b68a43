"""Evidence on its way to the disk: bounded in bytes, and fair where not all finds room."""

from __future__ import annotations

from collections import Counter, deque

from recorder.message import RawMessage

_OVERHEAD = 400
"""What a message takes in memory beside its bytes."""

_MOST_EMPTY = 10_000
"""Places of messages that gave way, before they are swept out."""


class _Place:
    """A message in the queue, until it is taken or gives way."""

    __slots__ = ("message", "size")

    def __init__(self, message: RawMessage, size: int) -> None:
        self.message: RawMessage | None = message
        self.size = size


class EvidenceQueue:
    """Messages in their order. Not thread-safe.

    Where there is no room the topics of the lowest priority give way; among these the one that
    takes most room, message by message, the oldest first: what is recorded of it is then what came
    last, and no topic pays for a larger one.

    Args:
        capacity: bytes of memory.

    Attributes:
        size: bytes of memory that are taken.
    """

    def __init__(self, capacity: int) -> None:
        self.size = 0
        self._empty = 0
        self._capacity = capacity
        self._places: deque[_Place] = deque()
        self._topics: dict[str, deque[_Place]] = {}
        self._sizes: Counter[str] = Counter()
        self._priorities: dict[str, int] = {}

    def __len__(self) -> int:
        return sum(map(len, self._topics.values()))

    def put(self, message: RawMessage, priority: int) -> list[RawMessage]:
        """Add a message.

        Returns:
            Those that gave way to it; itself, if it did.
        """
        topic, size = message.topic, len(message.data) + _OVERHEAD
        gone: list[RawMessage] = []
        self._priorities[topic] = priority
        while self.size + size > self._capacity:
            victim = self._victim(topic, size)
            if victim is None:
                return [*gone, message]
            gone.append(self._drop(victim))
        place = _Place(message, size)
        self._places.append(place)
        self._topics.setdefault(topic, deque()).append(place)
        self._sizes[topic] += size
        self.size += size
        return gone

    def take(self, most: int) -> list[RawMessage]:
        """The oldest messages, and take them out.

        Args:
            most: bytes, about; one message at least.
        """
        taken: list[RawMessage] = []
        size = 0
        while self._places and size < most:
            place = self._places.popleft()
            if place.message is None:
                self._empty -= 1
                continue
            taken.append(place.message)
            size += place.size
            self._leave(place.message.topic)
        return taken

    def _victim(self, comes: str, size: int) -> str | None:
        """Which topic loses its oldest message; None = that one which comes, and has none here."""
        sizes = {topic: taken for topic, taken in self._sizes.items() if taken}
        sizes[comes] = sizes.get(comes, 0) + size
        victim = min(sizes, key=lambda topic: (self._priorities[topic], -sizes[topic]))
        return victim if self._topics.get(victim) else None

    def _drop(self, topic: str) -> RawMessage:
        place = self._topics[topic][0]
        message, place.message = place.message, None
        self._leave(topic)
        assert message is not None
        self._empty += 1
        if self._empty > _MOST_EMPTY:
            self._places = deque(place for place in self._places if place.message is not None)
            self._empty = 0
        return message

    def _leave(self, topic: str) -> None:
        size = self._topics[topic].popleft().size
        self._sizes[topic] -= size
        self.size -= size
