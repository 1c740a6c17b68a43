"""One raw subscription: bytes as they came over the wire, and when."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import islice, pairwise

import msgspec

from madrob_console.clock import NS
from madrob_console.testbeds.ros.connection import in_namespace
from madrob_console.testbeds.ros.loading import RosObject, load_module
from recorder.bag import Durability, Qos, Reliability

QUEUE_DEPTH = 2000
"""Messages that DDS keeps for us; 10 loses silently under load, 2000 costs little."""

_APART = 1000
"""Times that are closer may be the same as seconds in a float, ns."""


class Received(msgspec.Struct, frozen=True, gc=False):
    """A message and what DDS says about it.

    Attributes:
        data: the CDR bytes.
        source_ns, received_ns: sent and arrived, the machines' system clocks, ns since the epoch.
        sequence: the publisher's count of its messages; None where the middleware has none.
    """

    data: bytes
    source_ns: int
    received_ns: int
    sequence: int | None


def can_take() -> bool:
    """Whether this rclpy lets us take messages without an executor."""
    implementation = load_module("rclpy.impl.implementation_singleton").rclpy_implementation
    return hasattr(implementation.Subscription, "take_message")


def qos_profile(qos: Qos, depth: int) -> RosObject:
    """The rclpy form of a quality of service."""
    rclpy_qos = load_module("rclpy.qos")
    return rclpy_qos.QoSProfile(
        depth=depth,
        reliability=rclpy_qos.ReliabilityPolicy[qos.reliability.name],
        durability=rclpy_qos.DurabilityPolicy[qos.durability.name],
    )


def offered_by_all(profiles: list[RosObject]) -> Qos:
    """The best quality of service that every one of these publishers offers."""
    rclpy_qos = load_module("rclpy.qos")
    reliable = all(p.reliability == rclpy_qos.ReliabilityPolicy.RELIABLE for p in profiles)
    kept = all(p.durability == rclpy_qos.DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return Qos(
        Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
        Durability.TRANSIENT_LOCAL if kept else Durability.VOLATILE,
    )


class Inbox:
    """A raw subscription that is emptied by `take`.

    Args:
        node: in no executor if `direct`, else in one that is spun before each `take`.
        message_class: the topic's message class.
        topic: full topic name.
        qos: what to ask of the publishers.
        direct: take from DDS (8-17 us a message) instead of by callbacks (91-231 us).
        depth: messages that DDS keeps for it.
        absolute: the topic's name is one that was found, not one of the settings.
    """

    def __init__(
        self,
        node: RosObject,
        message_class: RosObject,
        topic: str,
        qos: Qos,
        *,
        direct: bool,
        depth: int = QUEUE_DEPTH,
        absolute: bool = False,
    ) -> None:
        self.qos = qos
        self.depth = depth
        self._reported = 0
        self._node = node
        self._class = message_class
        self._direct = direct
        self._arrived: list[tuple[bytes, dict[str, int]]] = []
        # rclpy's default event callbacks print warnings into the terminal
        quiet = load_module("rclpy.event_handler").SubscriptionEventCallbacks(
            use_default_callbacks=False
        )
        self._subscription = node.create_subscription(
            message_class,
            topic if absolute else in_namespace(topic),
            self._on_message,
            qos_profile(qos, depth),
            raw=True,
            event_callbacks=quiet,
        )
        self._losses: RosObject = None
        self._tells_losses = True

    @property
    def publishers(self) -> int:
        """How many publishers are matched now."""
        return int(self._subscription.get_publisher_count())

    @property
    def reported_lost(self) -> int:
        """Messages that DDS says were lost; 0 where it does not tell."""
        if self._losses is None and self._tells_losses:
            self._losses = _loss_event(self._subscription)
            self._tells_losses = self._losses is not None
        if self._losses is not None:
            with self._losses:
                self._reported = int(self._losses.take_event().total_count)
        return self._reported

    def take(self, most: int | None = None) -> list[Received]:
        """What has arrived since the last call.

        Args:
            most: more are left in DDS, which keeps the newest; None = all.
        """
        if not self._direct:
            taken, self._arrived = self._arrived, []
            return [_received(*message) for message in taken]
        handle = self._subscription.handle
        with handle:
            waiting = iter(partial(handle.take_message, self._class, True), None)
            return [_received(*message) for message in islice(waiting, most)]

    def close(self) -> None:
        """End the subscription."""
        if self._losses is not None:
            self._losses.destroy_when_not_in_use()
        self._node.destroy_subscription(self._subscription)

    def _on_message(self, data: bytes, info: dict[str, int]) -> None:
        self._arrived.append((data, info))


def _received(data: bytes, info: dict[str, int]) -> Received:
    return Received(
        data,
        info["source_timestamp"],
        info["received_timestamp"],
        info["publication_sequence_number"],
    )


def _loss_event(subscription: RosObject) -> RosObject:
    """Counts what DDS has lost of a subscription; None where the middleware does not."""
    rclpy = load_module("rclpy.impl.implementation_singleton").rclpy_implementation
    kind = rclpy.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_MESSAGE_LOST
    try:
        with subscription.handle:
            return rclpy.EventHandle(subscription.handle, kind)
    except (AttributeError, RuntimeError):
        return None


def arrival(received_ns: int, now: int, wall: int) -> int:
    """When a message arrived, in steady time, ns.

    Args:
        received_ns: as the system's clock had it.
        now: steady time.
        wall: the same, as the system's clock has it.
    """
    age = wall - received_ns
    if not 0 <= age <= NS:
        age = 0  # the system's clock was stepped
    return now - age


def arrivals(received: Sequence[int], since: int, until: int, now: int, wall: int) -> list[int]:
    """When the messages of one topic arrived, in steady time, ns: each later than the one before.

    DDS knows the time of reception by the system's clock alone. Where that was stepped between
    reception and now, the messages are spread evenly over the time in which they came.

    Args:
        received: as the system's clock had it, in the order in which they came.
        since: when the one before them arrived, in steady time.
        until: they were taken then or later.
        now: steady time.
        wall: the same, as the system's clock has it.
    """
    found = [now - (wall - each) for each in received]
    limits = pairwise((since, *found, now + _APART))
    if all(later - earlier >= _APART for earlier, later in limits):
        return found
    since = min(since, until)  # else steady time was stepped, too: no bag is open
    return [since + (until - since) * n // len(found) for n in range(1, len(found) + 1)]
