"""Messages on their way from the take thread to the engine."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterable

from recorder.message import RawMessage

CAPACITY = 32 * 1024 * 1024
"""Bytes of each topic held for an engine that does not come; some twenty minutes of a testbed's."""

_OVERHEAD = 400
"""What a message takes in memory beside its bytes."""


class Mailbox:
    """A queue between two threads that never makes the sender wait.

    Args:
        capacity: bytes of memory for each topic; what comes beyond is dropped and counted. What
            one topic sends too much costs no other one anything.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._sizes: Counter[str] = Counter()
        self._messages: deque[RawMessage] = deque()
        self._dropped: Counter[str] = Counter()
        self._arrived = threading.Condition()

    def put(self, messages: Iterable[RawMessage]) -> None:
        """Hand messages over, oldest first."""
        with self._arrived:
            for message in messages:
                size = len(message.data) + _OVERHEAD
                if self._sizes[message.topic] + size > self._capacity:
                    self._dropped[message.topic] += 1
                    continue
                self._sizes[message.topic] += size
                self._messages.append(message)
            if self._messages:
                self._arrived.notify()

    def take(self, timeout: float) -> list[RawMessage]:
        """All messages; waits at most `timeout` s for the first."""
        with self._arrived:
            if not self._messages and timeout > 0:
                self._arrived.wait(timeout)
            messages = list(self._messages)
            self._messages.clear()
            self._sizes.clear()
            return messages

    def wake(self) -> None:
        """Let a waiting `take` return."""
        with self._arrived:
            self._arrived.notify()

    def dropped(self, topic: str) -> int:
        """How many messages of a topic found no room."""
        return self._dropped[topic]

    def __len__(self) -> int:
        """How many messages wait."""
        return len(self._messages)
