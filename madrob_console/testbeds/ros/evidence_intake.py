"""The topics of the evidence in a ROS domain, from discovery to their messages.

Messages stay bytes. A topic keeps its type as long as it is recorded.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from typing import TypeVar

from madrob_console.common.names import terminal_safe
from madrob_console.referee.evidence_account import EvidenceLoss
from madrob_console.referee.evidence_state import EvidenceTopic
from madrob_console.testbeds.evidence_choice import EvidenceChoice, TopicLimit, matches
from madrob_console.testbeds.message_rates import FlowMeter, RateLimit, SilenceWatch
from madrob_console.testbeds.ros.connection import (
    Connection,
    RosObject,
    in_namespace,
    node_of_arguments,
)
from madrob_console.testbeds.ros.intake import DescribeTopic, Intake
from madrob_console.testbeds.ros.subscriptions import Received, arrival
from madrob_console.testbeds.ros.types import describe_installed, prefixes
from recorder.bag import Durability, RawMessage, Topic

FIRST_DEPTH, LEAST_DEPTH, MOST_DEPTH = 32, 4, 512
"""Messages that DDS keeps between two takes: before their size is known, and the bounds after."""

DEPTH_BYTES = 16_000_000
"""Bytes of memory that DDS may use for the messages of a topic, about."""

MOST_TOO_LARGE = 3
"""A topic is left alone until the next run after so many oversized messages in a row."""

MOST_AT_ONCE = 64
"""Messages of one topic in one take: a flood delays no other topic."""

_HISTORY, _HISTORY_BYTES = 100, 4_000_000
"""Messages and bytes remembered of a durable topic; a recording begins with them."""

_TAKE_BYTES = 8_000_000
"""Bytes of one topic in one take, about: large messages are taken one by one."""


@dataclass(slots=True)
class TakenEvidence:
    """The messages of one take of a topic; `left_out` counts those over the rate limit."""

    topic: Topic
    messages: list[RawMessage] = field(default_factory=list)
    left_out: int = 0
    too_large: int = 0


class EvidenceIntake:
    """One evidence topic, from its discovery on; messages over `largest` bytes are not recorded."""

    def __init__(
        self,
        node: RosObject,
        name: str,
        limit: TopicLimit,
        largest: int,
        describe: DescribeTopic,
        *,
        named: bool = False,
    ) -> None:
        self.name = name
        self._node = node
        self._largest = largest
        self._describe = describe
        self._intake = self._new_intake()
        self._rate_limit = RateLimit(limit.most_rate)
        self._refusal = ""
        self._largest_seen = self._too_large = self._lost_before = 0
        self._history: deque[RawMessage] = deque(maxlen=_HISTORY)
        self._size: int | None = None
        self._meter = FlowMeter(time.monotonic())
        self._silence = SilenceWatch(named=named)
        self._now = 0  # steady time, ns

    @property
    def topic(self) -> Topic | None:
        return self._intake.topic

    @property
    def history(self) -> list[RawMessage]:
        """Earlier messages that its publishers keep for late joiners."""
        return list(self._history) if self._durable else []

    @property
    def _durable(self) -> bool:
        topic = self.topic
        return topic is not None and topic.qos.durability is Durability.TRANSIENT_LOCAL

    def discover(self, *, recording: bool) -> None:
        """Subscribes as the publishers need it; while `recording` the type must stay the same."""
        self._refusal = ""
        if self._intake.found_type != self._intake.type and not recording:
            self.close()
            self._intake = self._new_intake()
        if not self.left_alone:
            self._intake.discover()

    def _new_intake(self) -> Intake:
        return Intake(self._node, self.name, self._describe, depth=FIRST_DEPTH)

    def take_messages(self, now: int, wall: int) -> TakenEvidence | None:
        """What has arrived; `now` is steady time, ns, and `wall` the same on the system clock."""
        self._now = now
        self._silence.listen(now)
        topic, intake = self.topic, self._intake
        if topic is None or not intake.subscribed:
            return None
        received = intake.take_messages(self._most)
        if received:
            self._size = max(len(each.data) for each in received)
            intake.depth = _depth(self._size, intake.depth)
        taken = TakenEvidence(topic)
        for each in received:
            self._sort(each, arrival(each.received_ns, now, wall), taken)
        self._count(taken.messages)
        if self.left_alone:
            intake.close()
        return taken

    @property
    def left_alone(self) -> bool:
        return self._too_large >= MOST_TOO_LARGE

    def begin_recording(self) -> None:
        """Begins a recording: a topic that was left alone gets another chance."""
        self._too_large = self._largest_seen = 0
        self._lost_before = self._lost

    @property
    def _most(self) -> int:
        size = _TAKE_BYTES if self._size is None else max(1, self._size)
        return max(1, min(MOST_AT_ONCE, _TAKE_BYTES // size))

    def _sort(self, received: Received, at: int, taken: TakenEvidence) -> None:
        self._silence.came(at)
        too_large = len(received.data) > self._largest
        self._too_large = self._too_large + 1 if too_large else 0
        if too_large:
            taken.too_large += 1
            self._largest_seen = max(self._largest_seen, len(received.data))
        elif not self._rate_limit.passes(at):
            taken.left_out += 1
        else:
            message = RawMessage(
                self.name, self._intake.type, received.data, received.source_ns, at
            )
            taken.messages.append(message)

    def _count(self, messages: Sequence[RawMessage]) -> None:
        self._meter.count(messages, time.monotonic())
        if messages and self._durable:
            self._history.extend(m for m in messages if len(m.data) <= _HISTORY_BYTES)
            while sum(len(m.data) for m in self._history) > _HISTORY_BYTES:
                self._history.popleft()

    @property
    def _lost(self) -> int:
        """Messages lost on the way here, as far as sequence numbers or DDS tell."""
        counted = self._intake.lost
        return self._intake.reported_lost if counted is None else counted

    @property
    def state(self) -> EvidenceTopic:
        """The topic, with what was lost on the way since the recording began."""
        problem = self._refusal or self._intake.problem or ""
        if problem and not self._refusal and not self._intake.subscribed:
            problem = f"not recorded: {problem}"
        if self._largest_seen and not problem:
            size, most = self._largest_seen / 1e6, self._largest / 1e6
            problem = f"messages of {size:.1f} MB are not recorded, the limit is {most:g} MB"
            if self.left_alone:
                problem += ": it is left alone until the next run"
        rate, byte_rate = self._meter.rates(time.monotonic())
        lost = self._lost - self._lost_before
        return EvidenceTopic(
            self.name,
            self._intake.type,
            lost={EvidenceLoss.ON_THE_WAY: lost} if lost > 0 else {},
            problem=problem or self._silence.problem(self._now),
            rate=rate,
            byte_rate=byte_rate,
            publishers=self._intake.publishers,
            durable=self._durable,
            silent_since=self._silence.silent_since(self._now),
        )

    def refuse(self, why: str) -> None:
        with suppress(Exception):  # the same may be wrong with its end
            self.close()
        self._intake = self._new_intake()
        self._refusal = why

    def close(self) -> None:
        self._intake.close()
        self._history.clear()


def _depth(size: int, depth: int) -> int:
    fits = max(LEAST_DEPTH, min(MOST_DEPTH, DEPTH_BYTES // max(1, size)))
    return fits if not depth / 4 < fits < depth * 4 else depth


_T = TypeVar("_T")

MOST_TOPICS = 200
"""Further topics are not recorded: each takes memory in DDS."""


class EvidenceIntakes:
    """All evidence topics in a ROS domain. One thread.

    Attributes:
        left_over: topics without a subscription, because there are too many.
        unseen: patterns of the choice that match no topic that is or was published.
    """

    def __init__(
        self,
        domain: int,
        choice: EvidenceChoice,
        own_topics: Collection[str],
        *,
        ros_args: Sequence[str] = (),
        environment: Mapping[str, str],
        name: str,
    ) -> None:
        self._choice = choice
        self._own = _resolved(domain, own_topics, ros_args)
        self._connection = connection = Connection(domain)
        self._node = connection.node(name, spun=False)
        self._describe = cache(partial(describe_installed, prefixes(environment)))
        self._intakes: dict[str, EvidenceIntake] = {}
        self.left_over: tuple[str, ...] = ()
        self.unseen: tuple[str, ...] = ()

    def discover(self, *, recording: bool) -> None:
        """Looks for topics and their publishers; call it a few times a second."""
        names = {name for name, _ in self._node.get_topic_names_and_types()} - self._own
        wanted = sorted(
            name
            for name in names
            if self._choice.wants(name)
            and (name in self._intakes or self._node.count_publishers(name))
        )
        for name in wanted:
            if name not in self._intakes and len(self._intakes) < MOST_TOPICS:
                self._intakes[name] = EvidenceIntake(
                    self._node,
                    name,
                    self._choice.limit(name),
                    self._choice.largest,
                    self._describe,
                    named=name in self._choice.topics,
                )
            if name in self._intakes:
                intake = self._intakes[name]
                _named(intake, partial(intake.discover, recording=recording))
        self.left_over = tuple(name for name in wanted if name not in self._intakes)
        there = set(wanted)
        there |= {name for name in names if any(matches(p, name) for p in self._choice.excluded)}
        self.unseen = self._choice.unmatched(there | self._own)
        if not recording:
            for name in [name for name in self._intakes if name not in there]:
                self._intakes.pop(name).close()

    def take_messages(self, now_ns: Callable[[], int]) -> Iterator[TakenEvidence]:
        for intake in self._intakes.values():
            taken = _named(intake, partial(intake.take_messages, now_ns(), time.time_ns()))
            if taken is not None:
                yield taken

    def begin_recording(self) -> list[TakenEvidence]:
        """Begins a recording; returns the earlier messages of durable topics."""
        for intake in self._intakes.values():
            intake.begin_recording()
        return [
            TakenEvidence(intake.topic, intake.history)
            for intake in self._intakes.values()
            if intake.topic is not None
        ]

    def topics(self) -> tuple[EvidenceTopic, ...]:
        return tuple(self._intakes[name].state for name in sorted(self._intakes))

    def close(self) -> None:
        for intake in self._intakes.values():
            intake.close()
        self._connection.close()


def _named(intake: EvidenceIntake, action: Callable[[], _T]) -> _T | None:
    """Refuses a topic on which rclpy raises, so that no other topic ends."""
    try:
        return action()
    except Exception as error:  # noqa: BLE001  # whatever it is
        first = next(iter(str(error).splitlines()), type(error).__name__)
        intake.refuse(f"ROS fails ({terminal_safe(first)[:200]})")
        return None


def _resolved(domain: int, names: Collection[str], ros_args: Sequence[str]) -> frozenset[str]:
    if not ros_args:
        return frozenset(names)
    with node_of_arguments(domain, ros_args) as node:
        return frozenset(node.resolve_topic_name(in_namespace(name)) for name in names)
