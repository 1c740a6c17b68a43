"""All topics of the evidence in a ROS domain."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import TypeVar

from madrob_console.names import terminal_safe
from madrob_console.testbeds.evidence_choice import EvidenceChoice, TopicLimit, matches
from madrob_console.testbeds.evidence_flow import TopicFlow
from madrob_console.testbeds.ros.connection import Connection, in_namespace
from madrob_console.testbeds.ros.definitions import prefixes
from madrob_console.testbeds.ros.evidence_intake import EvidenceIntake, TakenEvidence
from madrob_console.testbeds.ros.inbox import can_take
from madrob_console.testbeds.ros.type_words import TypeWords
from recorder.bag import Topic
from recorder.message import RawMessage

_T = TypeVar("_T")

MOST_TOPICS = 200
"""More are not recorded: each takes memory in DDS."""


class EvidenceIntakes:
    """All topics of the evidence in a ROS domain. One thread.

    Args:
        domain: ROS domain.
        choice: which topics, and what of them.
        own_topics: those that are recorded elsewhere, as the settings name them.
        ros_args: what a launch file says of their names.
        environment: where `AMENT_PREFIX_PATH` is looked up.
        name: of the node, in `/madrob`.

    Attributes:
        left_over: topics that are not listened to, because there are too many.
        unseen: patterns of the choice that match nothing that somebody publishes, or published.
        scored: patterns that match nothing but what is recorded elsewhere.

    Raises:
        MadrobError: ROS is not installed or does not start.
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
        self._direct = can_take()
        self._node = connection.node(name, spun=not self._direct)
        asks = connection.node("types", beside=self._node)
        self._words = TypeWords(asks, prefixes(environment))
        self._intakes: dict[str, EvidenceIntake] = {}
        self.left_over: tuple[str, ...] = ()
        self.unseen: tuple[str, ...] = ()
        self.scored: tuple[str, ...] = ()

    def discover(self, *, recording: bool) -> None:
        """Look for topics and their publishers; call it a few times a second."""
        wanted = []
        names = {name for name, _ in self._node.get_topic_names_and_types()} - self._own
        for name in names:
            if not self._choice.wants(name):
                continue
            infos = self._node.get_publishers_info_by_topic(name)
            if infos or name in self._intakes:
                wanted.append((name, infos))
        for name, infos in sorted(wanted, key=lambda each: each[0]):
            if name not in self._intakes and len(self._intakes) < MOST_TOPICS:
                self._intakes[name] = EvidenceIntake(
                    self._node,
                    name,
                    self._choice.limit(name),
                    self._choice.largest,
                    self._words,
                    direct=self._direct,
                    named=name in self._choice.topics,
                )
            if name in self._intakes:
                intake = self._intakes[name]
                _named(intake, partial(intake.discover, infos, recording=recording))
        self.left_over = tuple(name for name, _ in wanted if name not in self._intakes)
        there = {name for name, _ in wanted}
        there |= {name for name in names if any(matches(p, name) for p in self._choice.excluded)}
        self.unseen = self._choice.unmatched(there | self._own)
        self.scored = tuple(p for p in self._choice.unmatched(there) if p not in self.unseen)
        if not recording:
            for name in [name for name in self._intakes if name not in there]:
                self._intakes.pop(name).close()

    def rest(self, duration: float) -> None:
        """Let time pass; who was asked for a type may answer meanwhile."""
        if self._direct and not self._words.pending:
            time.sleep(duration)
        else:
            self._connection.spin(duration)

    def take(self, now_ns: Callable[[], int]) -> Iterator[TakenEvidence]:
        """What has arrived since the last call, topic by topic.

        Args:
            now_ns: steady time.
        """
        for intake in self._intakes.values():
            taken = _named(intake, partial(intake.take, now_ns(), time.time_ns()))
            if taken is not None:
                yield taken

    def begin(self) -> list[tuple[Topic, TopicLimit, RawMessage]]:
        """A recording begins.

        Returns:
            What was said before and holds, of topics that are kept for late joiners.
        """
        for intake in self._intakes.values():
            intake.begin()
        return [
            (intake.topic, self._choice.limit(intake.name), message)
            for intake in self._intakes.values()
            if intake.topic is not None
            for message in intake.kept
        ]

    def flows(self) -> tuple[TopicFlow, ...]:
        """What comes on each topic, by name."""
        return tuple(self._intakes[name].flow for name in sorted(self._intakes))

    def close(self) -> None:
        """Leave the domain."""
        for intake in self._intakes.values():
            intake.close()
        self._connection.close()


def _named(intake: EvidenceIntake, action: Callable[[], _T]) -> _T | None:
    """Do something with a topic; what rclpy raises is named, and ends no other topic."""
    try:
        return action()
    except Exception as error:  # noqa: BLE001  # whatever it is
        first = next(iter(str(error).splitlines()), type(error).__name__)
        intake.refuse(f"ROS fails ({terminal_safe(first)[:200]})")
        return None


def _resolved(domain: int, names: Collection[str], ros_args: Sequence[str]) -> frozenset[str]:
    """Topics of the settings as they are called in the domain."""
    if not ros_args:
        return frozenset(names)
    connection = Connection(domain, ros_args)
    try:
        node = connection.node("names", spun=False)
        return frozenset(node.resolve_topic_name(in_namespace(name)) for name in names)
    finally:
        connection.close()
