"""Subscriptions to one topic that follow one another without a loss in between."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from operator import attrgetter

from madrob_console.testbeds.ros.inbox import QUEUE_DEPTH, Inbox, Received
from madrob_console.testbeds.ros.loading import RosObject
from recorder.bag import Qos

_LONGEST_HANDOVER = 5.0
"""A new subscription replaces the old one after this many seconds at the latest."""

_OVERLAP = 0.5
"""For this many seconds both are read once the new one is matched."""

_key: Callable[[Received], tuple[int, int | None]] = attrgetter("source_ns", "sequence")
"""What tells a message from all others of its topic."""


class Handover:
    """Listens to a topic with the quality of service that its publishers need. One thread.

    A subscription that must ask for something else, because publishers came or went, runs
    beside the old one until it is matched, so that nothing is lost in between.

    Args:
        node: the node that subscribes.
        name: full topic name.
        message_class: of its messages.
        direct: see `Inbox`.
        depth: messages that DDS keeps for it.
        absolute: see `Inbox`.

    Attributes:
        depth: what the next subscription shall have; another one than now brings one.
    """

    def __init__(
        self,
        node: RosObject,
        name: str,
        message_class: RosObject,
        *,
        direct: bool,
        depth: int = QUEUE_DEPTH,
        absolute: bool = False,
    ) -> None:
        self._node = node
        self._name = name
        self._class = message_class
        self._direct = direct
        self.depth = depth
        self._absolute = absolute
        self._inbox: Inbox | None = None
        self._former: Inbox | None = None
        self._ends = 0.0
        self._recent: deque[tuple[int, int | None]] = deque(maxlen=max(depth, QUEUE_DEPTH))
        self._seen: set[tuple[int, int | None]] | None = None

    @property
    def qos(self) -> Qos | None:
        """What it asks for; None = it does not listen."""
        return None if self._inbox is None else self._inbox.qos

    @property
    def publishers(self) -> int:
        """How many publishers are matched now."""
        return 0 if self._inbox is None else self._inbox.publishers

    @property
    def reported_lost(self) -> int:
        """Messages that DDS says were lost since it listens."""
        return 0 if self._inbox is None else self._inbox.reported_lost

    def listen(self, qos: Qos, publishers: int) -> None:
        """Listen, or go on listening.

        Args:
            qos: the best that all publishers offer.
            publishers: how many there are.
        """
        if self._inbox is None:
            self._inbox = self._open(qos)
        elif self._former is not None:
            if self._inbox.publishers >= publishers:
                self._ends = min(self._ends, time.monotonic() + _OVERLAP)
        elif (self._inbox.qos, self._inbox.depth) != (qos, self.depth):
            self._former, self._inbox = self._inbox, self._open(qos)
            self._ends = time.monotonic() + _LONGEST_HANDOVER
            self._seen = set(self._recent)

    def settle(self) -> None:
        """Forget what a subscription before has delivered, once it is gone."""
        if self._former is None:
            self._seen = None

    def take(self, most: int | None = None) -> list[Received]:
        """What has arrived since the last call, each message once.

        Args:
            most: more are left where they are; None = all.
        """
        if self._inbox is None:
            return []
        received = self._take_former() + self._inbox.take(most)
        if self._seen is not None:
            received = [r for r in received if self._is_new(r)]
        self._recent.extend(map(_key, received))
        return received

    def close(self) -> None:
        """Listen no more."""
        for inbox in (self._former, self._inbox):
            if inbox is not None:
                inbox.close()
        self._former = self._inbox = None

    def _open(self, qos: Qos) -> Inbox:
        return Inbox(
            self._node,
            self._class,
            self._name,
            qos,
            direct=self._direct,
            depth=self.depth,
            absolute=self._absolute,
        )

    def _take_former(self) -> list[Received]:
        if self._former is None:
            return []
        received = self._former.take()
        if time.monotonic() > self._ends:
            self._former.close()
            self._former = None
        return received

    def _is_new(self, received: Received) -> bool:
        """Whether neither the old nor the new subscription has delivered it yet."""
        if self._seen is None or _key(received) in self._seen:
            return False
        self._seen.add(_key(received))
        return True
