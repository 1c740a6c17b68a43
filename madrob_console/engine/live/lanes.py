"""Two queues, one of which goes first: between the threads of screens and engine."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Lanes(Generic[T]):
    """Put into and taken from in any thread."""

    def __init__(self) -> None:
        self._first: deque[T] = deque()
        self._others: deque[T] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def put(self, item: T, *, first: bool) -> bool:
        """Let something wait for its turn; False where nobody will take it any more."""
        with self._changed:
            if self._closed:
                return False
            (self._first if first else self._others).append(item)
            self._changed.notify()
            return True

    def next(self) -> T | None:
        """The next one, once there is one; None where there will be none."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._first or self._others)
            return self._taken()

    def waiting(self) -> Iterator[T]:
        """Those that wait now; before each one, those that go first and have come meanwhile."""
        with self._changed:
            others = len(self._others)
        while True:
            with self._changed:
                others -= not self._first
                item = self._taken() if others >= 0 else None
            if item is None:
                return
            yield item

    def count(self, *, first: bool) -> int:
        """How many wait in one of the two."""
        return len(self._first if first else self._others)

    def close(self) -> list[T]:
        """Take no more; returns those that were left."""
        with self._changed:
            self._closed = True
            left = [*self._first, *self._others]
            self._first.clear()
            self._others.clear()
            self._changed.notify_all()
        return left

    def _taken(self) -> T | None:
        queue = self._first or self._others
        return queue.popleft() if queue else None
