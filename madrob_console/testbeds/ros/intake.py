"""Topics of a ROS domain: found, subscribed without a loss, taken as bytes, losses counted."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice, pairwise
from operator import attrgetter
from typing import TypeAlias

import msgspec

from madrob_console.common.clock import NS
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.testbeds.ros.connection import RosObject, in_namespace, load_module
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
        self.depth = depth
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
        self.depth = depth
        self.inbox = self._open(qos)
        self._former: Inbox | None = None
        self._ends = 0.0
        self._recent: deque[tuple[int, int | None]] = deque(maxlen=max(depth, QUEUE_DEPTH))
        self._seen: set[tuple[int, int | None]] | None = None

    def listen(self, qos: Qos, publishers: int) -> None:
        if self._former is not None:
            if self.inbox.publishers >= publishers:
                self._ends = min(self._ends, time.monotonic() + _OVERLAP)
        elif (self.inbox.qos, self.inbox.depth) != (qos, self.depth):
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
        return Inbox(self._node, self._class, self._name, qos, depth=self.depth)

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


_IN_ORDER = 100
"""So many messages with increasing numbers are of one publisher: 2 s of a sensor."""

DescribeTopic: TypeAlias = Callable[[str, str], tuple[RosObject, Topic]]
"""(topic, type) -> the class of the messages and what a bag says of the topic.

It raises MadrobError with the remedy where the topic cannot be taken.
"""


class Intake:
    """One topic of a ROS domain, of any type, from its discovery on.

    It subscribes when the first publisher appears, with the quality of service that all publishers
    offer: what they keep for late joiners comes, too. Without a `type_name` the topic has the type
    of the publisher that is found first. `remedy` is told of another one. A change of `depth`
    takes effect at the next discovery. After `close` a discovery subscribes again. One thread; any
    may read.

    Attributes:
        topic: what a bag says of the topic; None as long as it is not known, or unusable.
        found_type: the type of what is published; `type` where nothing is.
        publishers: those that were matched at the last take, without those that do not send.
    """

    def __init__(
        self,
        node: RosObject,
        name: str,
        describe: DescribeTopic,
        type_name: str = "",
        *,
        depth: int = QUEUE_DEPTH,
        remedy: str = "correct the settings",
    ) -> None:
        self.name = name
        self.type = type_name
        self.depth = depth
        self._remedy = remedy
        self._node = node
        self._describe = describe
        self._class: RosObject = None
        self._configured = bool(type_name)
        self._losses = LossCounter()
        self.topic: Topic | None = None
        self._switch: QosSwitch | None = None
        self.found_type = type_name
        self._unusable: str | None = None
        self._problem: str | None = None
        self.publishers = self._newest = self._in_order = 0
        self._publisher_ids: frozenset[bytes] = frozenset()
        if type_name:
            self._prepare()

    @property
    def subscribed(self) -> bool:
        return self._switch is not None

    @property
    def lost(self) -> int | None:
        """Messages lost by the sequence numbers of the publisher; None = unknown."""
        return self._losses.lost

    @property
    def reported_lost(self) -> int:
        """Messages lost according to DDS since the subscription; 0 where it does not tell."""
        return 0 if self._switch is None else self._switch.inbox.reported_lost

    @property
    def problem(self) -> str | None:
        """Why no message, or not every publisher's, can be taken."""
        return self._unusable or self._problem

    def discover(self) -> None:
        """Looks at the publishers and subscribes as they need it; call it a few times a second."""
        infos = self._node.get_publishers_info_by_topic(in_namespace(self.name))
        if infos and not self.type:
            self.type = str(infos[0].topic_type)
            self._prepare()
        usable = [i for i in infos if i.topic_type == self.type and self._same_version(i)]
        misfits = [i for i in infos if i not in usable]
        self._problem = self._misfit(misfits[0], alone=not usable) if misfits else None
        self.found_type = self.type if usable or not infos else str(infos[0].topic_type)
        ids = frozenset(bytes(i.endpoint_gid) for i in usable)
        if ids.isdisjoint(self._publisher_ids):
            self._losses.restart()
        if ids:
            self._publisher_ids = ids
        if not usable or self.topic is None:
            return
        qos = offered_by_all([i.qos_profile for i in usable])
        if self._switch is None:
            self._switch = QosSwitch(self._node, self.name, self._class, qos, self.depth)
        self._switch.depth = self.depth
        self._switch.forget_delivered()
        self._switch.listen(qos, len(usable))
        if self._switch.inbox.qos == qos != self.topic.qos:
            self.topic = replace(self.topic, qos=qos)

    def take_messages(self, most: int | None = None) -> list[Received]:
        """What has arrived, at most so many messages; DDS keeps `depth` of the others."""
        if self._switch is None:
            return []
        before = self.publishers
        received = self._switch.take_messages(most)
        self.publishers = self._senders(received, self._switch.inbox.publishers)
        self._losses.see((r.sequence for r in received), max(before, self.publishers))
        return received

    def _senders(self, received: Iterable[Received], matched: int) -> int:
        """For 20 s DDS takes a killed publisher for alive; numbers in order are one's alone."""
        for number in (one.sequence or 0 for one in received):
            self._in_order = self._in_order + 1 if number > self._newest else 0
            self._newest = number
        return min(matched, 1) if self._in_order > _IN_ORDER else matched

    def close(self) -> None:
        if self._switch is not None:
            self._switch.close()
            self._switch = None
        self._losses.restart()

    def _prepare(self) -> None:
        try:
            self._class, self.topic = self._describe(self.name, self.type)
        except MadrobError as error:
            self._unusable = str(error)

    def _same_version(self, info: RosObject) -> bool:
        """Whether publisher and console have the same fields in the type, as far as both tell."""
        ours = "" if self.topic is None else self.topic.type_hash
        theirs = str(info.topic_type_hash)
        return not ours or not theirs.startswith("RIHS") or theirs == ours

    def _misfit(self, info: RosObject, *, alone: bool) -> str:
        found = terminal_safe(str(info.topic_type))[:80]
        if not alone:
            other = "another version of it" if info.topic_type == self.type else found
            return f"another publisher sends {other}: stop that one"
        if info.topic_type == self.type:
            return (
                f"its publisher has another version of {found}: "
                "install the same version of the package on both machines"
            )
        if self._configured:
            return f"its type is {found}, not {self.type}: {self._remedy}"
        return f"its type has become {found}: not recorded before the next run"
