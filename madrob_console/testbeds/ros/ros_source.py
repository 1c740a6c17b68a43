"""The testbed over ROS 2, as the engine sees it."""

from __future__ import annotations

import atexit
import os
import threading
import time
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import TypeVar

from madrob_console.common.clock import Clock
from madrob_console.common.names import SourceKind
from madrob_console.messages.codec import (
    LARGEST_WORDS,
    REFEREE_EVENT_TOPIC,
    REFEREE_STATE_TOPIC,
    ROBOT_TYPES,
    referee_topics,
)
from madrob_console.messages.mapping import TopicMapping
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.announcement import SILENT, Announcement
from madrob_console.testbeds.ros.connection import (
    Connection,
    RosObject,
    in_namespace,
    load_message_class,
)
from madrob_console.testbeds.ros.door_parameters import DoorParameters
from madrob_console.testbeds.ros.intake import Intake
from madrob_console.testbeds.ros.subscriptions import arrivals, qos_profile
from madrob_console.testbeds.ros.types import describe_registered, prefixes
from madrob_console.testbeds.ros.watches import InfoWatch, RefereeWatch, console_name
from madrob_console.testbeds.ros_domain import domain_id
from madrob_console.testbeds.source import Source, TopicStatus
from recorder.bag import RawMessage, Topic
from scoring.protocol import Condition

CAPACITY = 32 * 1024 * 1024
"""Bytes of each topic that wait for a busy engine; some twenty minutes of a testbed's."""

_OVERHEAD = 400


class Mailbox:
    """A queue between two threads that never makes the sender wait.

    Each topic has `capacity` bytes of its own. Messages beyond it are dropped and counted.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._sizes: Counter[str] = Counter()
        self._messages: deque[RawMessage] = deque()
        self._dropped: Counter[str] = Counter()
        self._arrived = threading.Condition()

    def put_messages(self, messages: Iterable[RawMessage]) -> None:
        with self._arrived:
            for message in messages:
                size = len(message.data) + _OVERHEAD
                if self._sizes[message.topic] + size > self._capacity:
                    self._dropped[message.topic] += 1
                    continue
                self._sizes[message.topic] += size
                self._messages.append(message)
            if self._messages:
                self._arrived.notify()

    def take_messages(self, timeout: float) -> list[RawMessage]:
        """All messages; waits at most `timeout` s for the first."""
        with self._arrived:
            if not self._messages and timeout > 0:
                self._arrived.wait(timeout)
            messages = list(self._messages)
            self._messages.clear()
            self._sizes.clear()
            return messages

    def wake(self) -> None:
        with self._arrived:
            self._arrived.notify()

    def dropped(self, topic: str) -> int:
        return self._dropped[topic]


_T = TypeVar("_T")
_receive_ns = attrgetter("receive_ns")

_PERIOD = 0.02
"""Seconds between two takes; DDS itself notes the arrivals."""

_DISCOVERY = 0.25
"""Seconds between two looks at the publishers."""

_DEPTHS = {REFEREE_EVENT_TOPIC: 100}
"""A late joiner gets the last state and pose, but the events of a whole run."""

_ROBOT_DEPTH = 10
"""Messages of a robot that are taken at once: a flood of them costs the run nothing."""


class RosSource(Source):
    """The testbed over ROS 2.

    A thread of its own empties the subscriptions at 50 Hz; the engine's calls never wait for ROS.
    Discovery range and middleware are the user's environment. A source that does not speak only
    listens, and other referees do not see it.
    A domain that does not exist raises MadrobError.
    """

    def __init__(
        self,
        mappings: Sequence[TopicMapping],
        types: MessageTypes,
        clock: Clock,
        domain: int | None = None,
        *,
        speaks: bool = True,
        ros_args: Sequence[str] = (),
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        self._configured = {mapping.topic: mapping.type for mapping in mappings}
        self._types = types
        self._own_topics = referee_topics(types)
        self._clock = clock
        self._domain = domain_id(domain, environment)
        self._speaks = speaks
        self._ros_args = ros_args
        self._environment = environment
        self._mailbox = Mailbox()
        self._connection: Connection | None = None
        self._console: RosObject = None
        self._publishers: dict[str, RosObject] = {}
        self._door: DoorParameters | None = None
        self._referees: RefereeWatch | None = None
        self._info: InfoWatch | None = None
        self._intakes: tuple[Intake, ...] = ()
        self._late: list[RawMessage] = []
        self._robot: tuple[Intake, ...] = ()
        self._newest = dict.fromkeys((*self._configured, *ROBOT_TYPES), clock.now_ns())
        self._failing: str | None = None
        self._failure: str | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def kind(self) -> SourceKind:
        return SourceKind.ROS

    @property
    def label(self) -> str:
        if self.announcement.simulated is not None:
            return f"SIMULATED over ROS domain {self._domain}"
        return f"LIVE ros domain {self._domain}"

    def open(self) -> None:
        if self._thread is not None or self._stop.is_set():
            return
        connection = Connection(self._domain, self._ros_args)
        try:
            door, referees, info = self._join(connection)
        except BaseException:
            connection.close()
            raise
        self._connection = connection
        self._thread = threading.Thread(
            target=self._run, args=(connection, door, referees, info), name="ros take", daemon=True
        )
        # A thread that is in ROS when the interpreter ends aborts the process.
        atexit.register(self.close)
        self._thread.start()

    def _join(self, connection: Connection) -> tuple[DoorParameters, RefereeWatch, InfoWatch]:
        self._console = console = connection.node(console_name(), spun=False)
        listener = connection.node("intake", beside=console, spun=False)
        self._publishers = {
            topic.name: console.create_publisher(
                load_message_class(topic.type),
                in_namespace(topic.name),
                qos_profile(topic.qos, _DEPTHS.get(topic.name, 1)),
            )
            for topic in self._own_topics
            if self._speaks
        }
        self._door = DoorParameters(connection.node("parameters", beside=console))
        self._referees = RefereeWatch(console, listener, speaks=self._speaks)
        self._info = InfoWatch(listener, self._types)
        describe = partial(describe_registered, self._types, prefixes(self._environment))
        remedy = "correct the robot's program"
        self._robot = tuple(
            Intake(listener, name, describe, kind, depth=_ROBOT_DEPTH, remedy=remedy)
            for name, kind in ROBOT_TYPES.items()
        )
        scored = (Intake(listener, name, describe, t) for name, t in self._configured.items())
        self._intakes = (*scored, *self._robot)
        return self._door, self._referees, self._info

    def take_messages(self, timeout: float) -> list[RawMessage]:
        return self._mailbox.take_messages(timeout)

    def topics(self) -> Sequence[Topic]:
        found = [i.topic for i in self._intakes if i.topic is not None]
        if self._info is not None and self._info.heard.messages:
            found.append(self._info.topic)
        return (*found, *self._own_topics)

    def status(self) -> Sequence[TopicStatus]:
        if not self._intakes:
            return tuple(
                TopicStatus(name, type_name, 0) for name, type_name in self._configured.items()
            )
        scored = (intake for intake in self._intakes if intake.name in self._configured)
        return tuple(map(self._intake_status, scored))

    def _intake_status(self, intake: Intake) -> TopicStatus:
        lost = intake.lost
        return TopicStatus(
            topic=intake.name,
            type=intake.found_type,
            publishers=intake.publishers,
            lost=None if lost is None else lost + self._mailbox.dropped(intake.name),
            problem=intake.problem or self._failure,
        )

    def configure(self, condition: Condition) -> None:
        if self._door is not None:
            self._door.request(condition)

    @property
    def sides_problem(self) -> str | None:
        return self._door.problem if self._door is not None else "ROS is not connected"

    @property
    def announcement(self) -> Announcement:
        return SILENT if self._info is None else self._info.heard

    @property
    def robot_problems(self) -> Mapping[str, str]:
        return {one.name: words for one in self._robot if (words := one.problem) is not None}

    @property
    def other_referee(self) -> str | None:
        return None if self._referees is None else self._referees.other

    def publish(self, message: RawMessage) -> None:
        if publisher := self._publishers.get(message.topic):
            if self._referees is not None and message.topic == REFEREE_STATE_TOPIC:
                self._referees.said.append(message.data)
            publisher.publish(message.data)

    def close(self) -> None:
        """Leaves the ROS domain; messages that arrived before can still be taken."""
        self._stop.set()
        thread, connection = self._thread, self._connection
        if thread is None or connection is None:
            return
        self._thread = self._connection = None
        self._publishers = {}
        thread.join()
        for intake in self._intakes:
            intake.close()
        for watch in (self._info, self._referees):
            if watch is not None:
                watch.close()
        connection.close()
        atexit.unregister(self.close)
        self._mailbox.wake()

    def _run(
        self,
        connection: Connection,
        door: DoorParameters,
        referees: RefereeWatch,
        info: InfoWatch,
    ) -> None:
        discover_at = 0.0
        while not self._stop.is_set():
            self._failing = None
            if time.monotonic() >= discover_at:
                discover_at = time.monotonic() + _DISCOVERY
                for intake in self._intakes:
                    self._try(intake.discover)
                self._try(door.poll)
                self._try(referees.look_at_graph)
                self._try(info.take_info)
            self._mailbox.put_messages(self._try(self._take) or [])
            self._failure = self._failing
            if not door.pending:
                self._stop.wait(_PERIOD)
            else:
                self._try(partial(connection.spin, _PERIOD))
        self._mailbox.put_messages(self._try(self._take) or [])
        self._mailbox.put_messages(self._late)

    def _try(self, action: Callable[[], _T]) -> _T | None:
        try:
            return action()
        except Exception as error:  # noqa: BLE001  # whatever rclpy raises is shown
            first = next(iter(str(error).splitlines()), type(error).__name__)
            self._failing = f"ROS fails ({first}): start the console again"
            return None

    def _take(self) -> list[RawMessage]:
        """The messages that arrived by the beginning of this call, by receive time.

        Later ones wait for the next call: a topic that was emptied early may have an older message.
        """
        begin = self._clock.now_ns()
        taken = [
            (intake, received)
            for intake in self._intakes
            if (received := self._try(intake.take_messages))
        ]
        now, wall = self._clock.now_ns(), time.time_ns()
        messages = [*self._late]
        for intake, received in taken:
            times = arrivals(
                [r.received_ns for r in received], self._newest[intake.name], begin, now, wall
            )
            self._newest[intake.name] = times[-1]
            messages += [
                RawMessage(intake.name, intake.type, r.data, r.source_ns, at, r.sequence or 0)
                for r, at in zip(received, times, strict=True)
                if intake not in self._robot or len(r.data) <= LARGEST_WORDS
            ]
        messages.sort(key=_receive_ns)
        ready = bisect_right(messages, begin, key=_receive_ns)
        self._late = messages[ready:]
        return messages[:ready]
