"""A queue with two lanes, between threads."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class PriorityQueue(Generic[T]):
    """A queue with two priorities, for any thread."""

    def __init__(self) -> None:
        self._first: deque[T] = deque()
        self._others: deque[T] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def put_item(self, item: T, *, first: bool) -> bool:
        with self._changed:
            if self._closed:
                return False
            (self._first if first else self._others).append(item)
            self._changed.notify()
            return True

    def next(self) -> T | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._first or self._others)
            return self._taken()

    def waiting(self) -> Iterator[T]:
        """The items that wait now; before each one, those with priority that came meanwhile."""
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
        return len(self._first if first else self._others)

    def close(self) -> list[T]:
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
