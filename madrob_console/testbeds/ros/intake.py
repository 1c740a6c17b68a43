"""One configured topic on the wire: found, subscribed without a loss, emptied, losses counted."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice, pairwise
from operator import attrgetter
from pathlib import Path

import msgspec

from madrob_console.common.clock import NS
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import describe_topic
from madrob_console.messages.message_types import MessageTypes
from madrob_console.testbeds.ros.connection import (
    RosObject,
    in_namespace,
    load_message_class,
    load_module,
)
from madrob_console.testbeds.ros.types import find_definition
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import Durability, Qos, Reliability, Topic

# One raw subscription: bytes from the wire, and their times.


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


def can_take() -> bool:
    """Whether this rclpy can take messages without an executor."""
    implementation = load_module("rclpy.impl.implementation_singleton").rclpy_implementation
    return hasattr(implementation.Subscription, "take_message")


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

    A `direct` one takes from DDS (8-17 us a message) instead of by callbacks (91-231 us); its node
    is in no executor, else in one that is spun before each take. An `absolute` name was found in
    the domain; no remapping applies.
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
        if not self._direct:
            taken, self._arrived = self._arrived, []
            return [_received(*message) for message in taken]
        handle = self._subscription.handle
        with handle:
            waiting = iter(partial(handle.take_message, self._class, True), None)
            return [_received(*message) for message in islice(waiting, most)]

    def close(self) -> None:
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

    DDS knows arrivals by the system clock alone. Where that was stepped meanwhile, the messages are
    spread evenly from `since`, the arrival of the message before them, to `until`, when they were
    taken. `now` and `wall` are the same instant in steady time and on the system clock.
    """
    found = [now - (wall - each) for each in received]
    limits = pairwise((since, *found, now + _APART))
    if all(later - earlier >= _APART for earlier, later in limits):
        return found
    since = min(since, until)  # else steady time was stepped, too: no bag is open
    return [since + (until - since) * n // len(found) for n in range(1, len(found) + 1)]


# Successive subscriptions to one topic, without a loss between them.


_LONGEST_HANDOVER = 5.0
"""Seconds after which a new subscription replaces the old one at the latest."""

_OVERLAP = 0.5
"""Seconds for which both subscriptions are read once the new one is matched."""

_key: Callable[[Received], tuple[int, int | None]] = attrgetter("source_ns", "sequence")


class QosSwitch:
    """Subscribes to a topic with the quality of service that its publishers need. One thread.

    When publishers come or go and another quality is needed, a new subscription runs beside the old
    one until it is matched, so that nothing is lost in between. A change of `depth` brings a new
    one, too.
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
        return None if self._inbox is None else self._inbox.qos

    @property
    def publishers(self) -> int:
        return 0 if self._inbox is None else self._inbox.publishers

    @property
    def reported_lost(self) -> int:
        return 0 if self._inbox is None else self._inbox.reported_lost

    def listen(self, qos: Qos, publishers: int) -> None:
        if self._inbox is None:
            self._inbox = self._open(qos)
        elif self._former is not None:
            if self._inbox.publishers >= publishers:
                self._ends = min(self._ends, time.monotonic() + _OVERLAP)
        elif (self._inbox.qos, self._inbox.depth) != (qos, self.depth):
            self._former, self._inbox = self._inbox, self._open(qos)
            self._ends = time.monotonic() + _LONGEST_HANDOVER
            self._seen = set(self._recent)

    def forget_delivered(self) -> None:
        if self._former is None:
            self._seen = None

    def take_messages(self, most: int | None = None) -> list[Received]:
        if self._inbox is None:
            return []
        received = self._take_former() + self._inbox.take_messages(most)
        if self._seen is not None:
            received = [r for r in received if self._is_new(r)]
        self._recent.extend(map(_key, received))
        return received

    def close(self) -> None:
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


# Counting lost messages by the publisher's own sequence numbers.


class LossCounter:
    """Gaps in the sequence numbers of a topic's only publisher.

    With several publishers the loss is unknown, until one is left.
    """

    def __init__(self) -> None:
        self._lost = 0
        self._last: int | None = None
        self._several = False
        self._numbered = True

    @property
    def lost(self) -> int | None:
        return None if self._several or not self._numbered else self._lost

    def restart(self) -> None:
        self._last = None

    def see(self, numbers: Iterable[int | None], publishers: int) -> None:
        """Counts the messages of one take, in the order of arrival.

        `publishers` is the largest number that was matched during the take.
        """
        self._several = publishers > 1
        if not self._several:
            last = self._last
            for number in numbers:
                if number is None:
                    self._numbered = False
                elif last is None or number > last:
                    self._lost += 0 if last is None else number - last - 1
                    last = number
            self._last = last
        if publishers != 1:
            self.restart()


def same_version(info: RosObject, type_hash: str) -> bool:
    """Whether publisher and console have the same fields in the type, as far as both tell."""
    theirs = str(info.topic_type_hash)
    return not type_hash or not theirs.startswith("RIHS") or theirs == type_hash


def other_version(type_name: str) -> str:
    return (
        f"its publisher has another version of {type_name}: "
        "install the same version of the package on both machines"
    )


class Intake:
    """A testbed topic, from its discovery on. One thread, except for the properties."""

    def __init__(
        self,
        node: RosObject,
        name: str,
        type_name: str,
        *,
        types: MessageTypes,
        prefixes: Sequence[Path],
        direct: bool,
    ) -> None:
        self.name = name
        self.type = type_name
        self._node = node
        self._losses = LossCounter()
        self._class: RosObject = None
        self._type_hash = ""
        self._topic: Topic | None = None
        self._found_type = type_name
        self._problem: str | None = None
        self._publishers = 0
        self._publisher_ids: frozenset[bytes] = frozenset()
        self._unusable = self._prepare(types, prefixes)
        self._handover = QosSwitch(node, name, self._class, direct=direct)

    @property
    def topic(self) -> Topic | None:
        return self._topic

    def status(self, dropped: int) -> TopicStatus:
        lost = self._losses.lost
        return TopicStatus(
            topic=self.name,
            type=self._found_type,
            publishers=self._publishers,
            lost=None if lost is None else lost + dropped,
            problem=self._unusable or self._problem,
        )

    def discover(self) -> None:
        infos = self._node.get_publishers_info_by_topic(in_namespace(self.name))
        usable = [
            i for i in infos if i.topic_type == self.type and same_version(i, self._type_hash)
        ]
        misfits = [i for i in infos if i not in usable]
        self._problem = self._misfit(misfits[0], alone=not usable) if misfits else None
        self._found_type = self.type if usable or not infos else infos[0].topic_type
        ids = frozenset(bytes(i.endpoint_gid) for i in usable)
        if ids.isdisjoint(self._publisher_ids):
            self._losses.restart()
        if ids:
            self._publisher_ids = ids
        self._handover.forget_delivered()
        if usable and not self._unusable:
            self._listen(offered_by_all([i.qos_profile for i in usable]), len(usable))

    def take_messages(self) -> list[Received]:
        if self._handover.qos is None:
            return []
        before = self._publishers
        received = self._handover.take_messages()
        self._publishers = self._handover.publishers
        self._losses.see((r.sequence for r in received), max(before, self._publishers))
        return received

    def close(self) -> None:
        self._handover.close()

    def _prepare(self, types: MessageTypes, prefixes: Sequence[Path]) -> str | None:
        definition = find_definition(self.type, prefixes)
        try:
            self._class = load_message_class(self.type)
            if definition is not None:
                types.register(self.type, definition.text)
                self._type_hash = definition.type_hash
            self._topic = describe_topic(types, self.name, self.type)
        except MadrobError as error:
            return str(error)
        return None

    def _misfit(self, info: RosObject, *, alone: bool) -> str:
        if not alone:
            other = "another version of it" if info.topic_type == self.type else info.topic_type
            return f"another publisher sends {other}: stop that one"
        if info.topic_type == self.type:
            return other_version(self.type)
        return f"its type is {info.topic_type}, not {self.type}: correct the settings"

    def _listen(self, qos: Qos, publishers: int) -> None:
        self._handover.listen(qos, publishers)
        if self._topic is not None and self._handover.qos == qos != self._topic.qos:
            self._topic = replace(self._topic, qos=qos)
