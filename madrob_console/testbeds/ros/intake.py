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

# One raw subscription: bytes as they came over the wire, and when.


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


# Subscriptions to one topic that follow one another without a loss in between.


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


# Counting lost messages by the publisher's own sequence numbers.


class LossCounter:
    """Gaps in the sequence numbers of a topic's only publisher.

    With several publishers the numbers of one cannot be told from those of another: the loss
    is then unknown, until one is left.
    """

    def __init__(self) -> None:
        self._lost = 0
        self._last: int | None = None
        self._several = False
        self._numbered = True

    @property
    def lost(self) -> int | None:
        """Messages lost so far; None = unknown."""
        return None if self._several or not self._numbered else self._lost

    def restart(self) -> None:
        """The publisher is another one: its numbers start anew."""
        self._last = None

    def see(self, numbers: Iterable[int | None], publishers: int) -> None:
        """Count the messages of one take.

        Args:
            numbers: sequence numbers in the order of arrival; None = the middleware has none.
            publishers: how many publishers were matched, at most, during the take.
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


class Intake:
    """A testbed topic, from its discovery on. All calls but the properties: one thread.

    Args:
        node: the node that subscribes.
        name: full topic name.
        type_name: the configured message type.
        types: the types known; the configured one is made known here.
        prefixes: where ROS packages are installed.
        direct: see `Inbox`.
    """

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
        self._handover = Handover(node, name, self._class, direct=direct)

    @property
    def topic(self) -> Topic | None:
        """What a bag must know of it; None while its type cannot be used here."""
        return self._topic

    def status(self, dropped: int) -> TopicStatus:
        """Its state; `dropped` messages were lost behind the intake."""
        lost = self._losses.lost
        return TopicStatus(
            topic=self.name,
            type=self._found_type,
            publishers=self._publishers,
            lost=None if lost is None else lost + dropped,
            problem=self._unusable or self._problem,
        )

    def discover(self) -> None:
        """Look at the publishers, and subscribe to them as they need it."""
        infos = self._node.get_publishers_info_by_topic(in_namespace(self.name))
        usable = [i for i in infos if i.topic_type == self.type and self._same_version(i)]
        misfits = [i for i in infos if i not in usable]
        self._problem = self._misfit(misfits[0], alone=not usable) if misfits else None
        self._found_type = self.type if usable or not infos else infos[0].topic_type
        ids = frozenset(bytes(i.endpoint_gid) for i in usable)
        if ids.isdisjoint(self._publisher_ids):
            self._losses.restart()
        if ids:
            self._publisher_ids = ids
        self._handover.settle()
        if usable and not self._unusable:
            self._listen(offered_by_all([i.qos_profile for i in usable]), len(usable))

    def take(self) -> list[Received]:
        """Everything that has arrived since the last call."""
        if self._handover.qos is None:
            return []
        before = self._publishers
        received = self._handover.take()
        self._publishers = self._handover.publishers
        self._losses.see((r.sequence for r in received), max(before, self._publishers))
        return received

    def close(self) -> None:
        """End the subscription."""
        self._handover.close()

    def _prepare(self, types: MessageTypes, prefixes: Sequence[Path]) -> str | None:
        """Find class and definition of the type; returns why it cannot be used."""
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

    def _same_version(self, info: RosObject) -> bool:
        """Whether a publisher's type has the fields that ours has, as far as both say so."""
        theirs = str(info.topic_type_hash)
        return not self._type_hash or not theirs.startswith("RIHS") or theirs == self._type_hash

    def _misfit(self, info: RosObject, *, alone: bool) -> str:
        if not alone:
            other = "another version of it" if info.topic_type == self.type else info.topic_type
            return f"another publisher sends {other}: stop that one"
        if info.topic_type == self.type:
            return (
                f"its publisher has another version of {self.type}: "
                "install the same version of the package on both machines"
            )
        return f"its type is {info.topic_type}, not {self.type}: correct the settings"

    def _listen(self, qos: Qos, publishers: int) -> None:
        self._handover.listen(qos, publishers)
        if self._topic is not None and self._handover.qos == qos != self._topic.qos:
            self._topic = replace(self._topic, qos=qos)
