"""Raw subscriptions: bytes and their times, without a loss when one replaces another."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice, pairwise
from operator import attrgetter

import msgspec

from madrob_console.common.clock import NS
from madrob_console.testbeds.ros.connection import RosObject, in_namespace, load_module
from recorder.bag import Durability, Qos, Reliability

QUEUE_DEPTH = 2000
"""Messages that DDS keeps for the console; 10 loses silently under load, 2000 costs little."""

_APART = 1000
"""ns; closer times may be equal as float seconds."""


class Received(msgspec.Struct, frozen=True, gc=False):
    """A CDR message with the system times of sending and arrival, ns since the epoch.

    `sequence` is the publisher's count of its messages; None where the middleware has none.
    """

    data: bytes
    source_ns: int
    received_ns: int
    sequence: int | None


def qos_profile(qos: Qos, depth: int) -> RosObject:
    rclpy_qos = load_module("rclpy.qos")
    return rclpy_qos.QoSProfile(
        depth=depth,
        reliability=rclpy_qos.ReliabilityPolicy[qos.reliability.name],
        durability=rclpy_qos.DurabilityPolicy[qos.durability.name],
    )


def offered_by_all(profiles: list[RosObject]) -> Qos:
    rclpy_qos = load_module("rclpy.qos")
    reliable = all(p.reliability == rclpy_qos.ReliabilityPolicy.RELIABLE for p in profiles)
    kept = all(p.durability == rclpy_qos.DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return Qos(
        Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
        Durability.TRANSIENT_LOCAL if kept else Durability.VOLATILE,
    )


class Inbox:
    """A raw subscription that is emptied by `take_messages`.

    It takes from DDS itself (8-17 us a message) instead of by callbacks (91-231 us): its node is
    in no executor.
    """

    def __init__(
        self,
        node: RosObject,
        message_class: RosObject,
        topic: str,
        qos: Qos,
        *,
        depth: int = QUEUE_DEPTH,
    ) -> None:
        self.qos = qos
        self._reported = 0
        self._node = node
        self._class = message_class
        # rclpy's default event callbacks print warnings into the terminal
        quiet = load_module("rclpy.event_handler").SubscriptionEventCallbacks(
            use_default_callbacks=False
        )
        self._subscription = node.create_subscription(
            message_class,
            in_namespace(topic),
            _never_spun,
            qos_profile(qos, depth),
            raw=True,
            event_callbacks=quiet,
        )
        self._losses: RosObject = None
        self._tells_losses = True

    @property
    def publishers(self) -> int:
        return int(self._subscription.get_publisher_count())

    @property
    def reported_lost(self) -> int:
        """Messages lost according to DDS; 0 where it does not tell."""
        if self._losses is None and self._tells_losses:
            self._losses = _loss_event(self._subscription)
            self._tells_losses = self._losses is not None
        if self._losses is not None:
            with self._losses:
                self._reported = int(self._losses.take_event().total_count)
        return self._reported

    def take_messages(self, most: int | None = None) -> list[Received]:
        """At most so many messages; DDS keeps the newest of the others."""
        handle = self._subscription.handle
        with handle:
            waiting = iter(partial(handle.take_message, self._class, True), None)
            return [_received(*message) for message in islice(waiting, most)]

    def close(self) -> None:
        if self._losses is not None:
            self._losses.destroy_when_not_in_use()
        self._node.destroy_subscription(self._subscription)


def _never_spun(_message: RosObject) -> None:
    """The callback that a subscription has to have."""


def _received(data: bytes, info: dict[str, int]) -> Received:
    return Received(
        data,
        info["source_timestamp"],
        info["received_timestamp"],
        info["publication_sequence_number"],
    )


def _loss_event(subscription: RosObject) -> RosObject:
    rclpy = load_module("rclpy.impl.implementation_singleton").rclpy_implementation
    kind = rclpy.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_MESSAGE_LOST
    try:
        with subscription.handle:
            return rclpy.EventHandle(subscription.handle, kind)
    except (AttributeError, RuntimeError):
        return None


def arrival(received_ns: int, now: int, wall: int) -> int:
    """Steady arrival, ns; `now` and `wall` are one instant, steady and on the system clock."""
    age = wall - received_ns
    if not 0 <= age <= NS:
        age = 0  # the system's clock was stepped
    return now - age


def arrivals(received: Sequence[int], since: int, until: int, now: int, wall: int) -> list[int]:
    """The arrivals of one topic's messages in steady time, ns, strictly increasing.

    DDS knows arrivals by the system clock alone. Where that was stepped meanwhile, arrivals are out
    of order: the messages are spread evenly from `since`, the arrival of the message before them,
    to `until`, when they were taken. Messages that waited in the network while this process stood
    still arrive all at once. `now` and `wall` are the same instant in steady time and on the system
    clock.
    """
    found = [now - (wall - each) for each in received]
    steady = [since]
    for at in found:
        steady.append(max(at, steady[-1] + _APART))
    limits = pairwise((since, *found, now))
    if steady[-1] <= now and all(earlier <= later for earlier, later in limits):
        return steady[1:]
    since = min(since, until)  # else steady time was stepped, too: no bag is open
    return [since + (until - since) * n // len(found) for n in range(1, len(found) + 1)]


_LONGEST_HANDOVER = 5.0
"""Seconds after which a new subscription replaces the old one at the latest."""

_OVERLAP = 0.5
"""Seconds for which both subscriptions are read once the new one is matched."""

_key: Callable[[Received], tuple[int, int | None]] = attrgetter("source_ns", "sequence")


class QosSwitch:
    """Subscribes to a topic with the quality of service that its publishers need. One thread.

    When publishers come or go and another quality is needed, a new subscription runs beside the old
    one until it is matched, so that nothing is lost in between.

    Attributes:
        inbox: the newest subscription.
    """

    def __init__(
        self,
        node: RosObject,
        name: str,
        message_class: RosObject,
        qos: Qos,
        depth: int,
    ) -> None:
        self._node = node
        self._name = name
        self._class = message_class
        self._depth = depth
        self.inbox = self._open(qos)
        self._former: Inbox | None = None
        self._ends = 0.0
        self._recent: deque[tuple[int, int | None]] = deque(maxlen=max(depth, QUEUE_DEPTH))
        self._seen: set[tuple[int, int | None]] | None = None

    def listen(self, qos: Qos, publishers: int) -> None:
        if self._former is not None:
            if self.inbox.publishers >= publishers:
                self._ends = min(self._ends, time.monotonic() + _OVERLAP)
        elif self.inbox.qos != qos:
            self._former, self.inbox = self.inbox, self._open(qos)
            self._ends = time.monotonic() + _LONGEST_HANDOVER
            self._seen = set(self._recent)

    def forget_delivered(self) -> None:
        if self._former is None:
            self._seen = None

    def take_messages(self, most: int | None = None) -> list[Received]:
        received = self._take_former() + self.inbox.take_messages(most)
        if self._seen is not None:
            received = [r for r in received if self._is_new(r)]
        self._recent.extend(map(_key, received))
        return received

    def close(self) -> None:
        if self._former is not None:
            self._former.close()
        self.inbox.close()

    def _open(self, qos: Qos) -> Inbox:
        return Inbox(self._node, self._class, self._name, qos, depth=self._depth)

    def _take_former(self) -> list[Received]:
        if self._former is None:
            return []
        received = self._former.take_messages()
        if time.monotonic() > self._ends:
            self._former.close()
            self._former = None
        return received

    def _is_new(self, received: Received) -> bool:
        if self._seen is None or _key(received) in self._seen:
            return False
        self._seen.add(_key(received))
        return True
