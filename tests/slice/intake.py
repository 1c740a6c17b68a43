"""Messages on their way from the testbed: recorded first, then judged by the loop."""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import suppress
from threading import Event

from madrob_console.common.clock import Clock, seconds
from madrob_console.testbeds.source import Source
from recorder import BagWriter, RawMessage

BACKLOG = 20_000
"""Messages that wait to be judged.

What comes beyond is recorded, counted, and not judged live.
"""

TAKE_PERIOD = 0.02
"""Longest wait for messages, s."""


class Intake:
    """Takes messages, hands them to the recorder and keeps them for the loop.

    Attributes:
        waiting: messages to be judged, the oldest first, each with whether it is recorded.
        taken_until: all messages up to then were taken, s since the epoch.
        unjudged: recorded messages that are not judged live, because too many waited.
    """

    def __init__(self, source: Source, clock: Clock) -> None:
        self._source = source
        self._clock = clock
        self._bag: BagWriter | None = None
        self._known: set[str] = set()
        self._loop = asyncio.get_running_loop()
        self._arrived = asyncio.Event()
        self._ended = Event()
        self.waiting: deque[tuple[bool, RawMessage]] = deque()
        self.taken_until = seconds(clock.now_ns())
        self.unjudged = 0

    @property
    def judged_until(self) -> float:
        """All messages up to then were judged, s since the epoch."""
        if self.waiting:
            return seconds(self.waiting[0][1].receive_ns)
        return self.taken_until

    def record(self, bag: BagWriter | None) -> None:
        """Record what comes from now on.

        None ends it.
        """
        self._known = {topic.name for topic in self._source.topics()}
        self._bag = bag

    def record_own(self, message: RawMessage) -> None:
        """Record a message of our own."""
        if (bag := self._bag) is not None:
            bag.put_message(message)

    def run(self) -> None:
        """Take messages in a thread of its own, until `close`."""
        while not self._ended.is_set():
            self.take(TAKE_PERIOD)

    def take(self, timeout: float) -> None:
        """Take what has arrived, waiting at most `timeout` s for the first message."""
        until = seconds(self._clock.now_ns())
        messages = self._source.take_messages(timeout)
        bag = self._bag
        if bag is not None and messages:
            self._add_topics(bag)
            bag.put_all(messages)
        for message in messages:
            if len(self.waiting) < BACKLOG:
                self.waiting.append((bag is not None, message))
            else:
                self.unjudged += bag is not None
        self.taken_until = until
        self._loop.call_soon_threadsafe(self._arrived.set)

    def _add_topics(self, bag: BagWriter) -> None:
        for topic in self._source.topics():
            if topic.name not in self._known:
                self._known.add(topic.name)
                bag.add_topic(topic)

    async def arrival(self, patience: float) -> None:
        """Give way to the rest of the program, or wait for messages, at most `patience` s."""
        if self.waiting:
            await asyncio.sleep(0)
            return
        with suppress(TimeoutError):
            await asyncio.wait_for(self._arrived.wait(), patience)
        self._arrived.clear()

    def close(self) -> None:
        self._ended.set()
