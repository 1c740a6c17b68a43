"""Hears what the testbed of a ROS domain says of itself."""

from __future__ import annotations

import time
from dataclasses import replace

from madrob_console.clock import Clock, SimulationClock, nanoseconds, seconds
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import MessageTypes, decode_text, describe_topic
from madrob_console.messages.header_stamp import header_stamp
from madrob_console.testbeds.announcement import (
    INFO_TOPIC,
    INFO_TYPE,
    LARGEST_INFO,
    SILENT,
    Announcement,
    simulated_in,
)
from madrob_console.testbeds.ros.inbox import Inbox, Received, arrival
from madrob_console.testbeds.ros.loading import RosObject, load_message_class
from recorder.bag import Durability, Qos, Reliability, Topic
from recorder.message import RawMessage

_DEPTH = 10
"""Messages that DDS keeps between two looks: whoever sends more says the same."""

_CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL)


class InfoWatch:
    """Listens to `/madrob/testbed/info`, which a testbed says once and late joiners hear, too.

    It holds as long as somebody is there who could have said it. Where several are, one that is
    simulated is enough. A simulation says what time it is on `/clock`; that sets the engine's
    clock where this is a `SimulationClock`, and makes every run practice then.

    Args:
        node: subscribes; see `Inbox`.
        types: the types known.
        clock: the engine's.
        direct: see `Inbox`.

    Attributes:
        topic: what a bag must know of it.
        clock_problem: why the engine's clock cannot follow `/clock`; None = it does, or need not.
    """

    def __init__(self, node: RosObject, types: MessageTypes, clock: Clock, *, direct: bool) -> None:
        self.clock_problem: str | None = None
        self._said = SILENT
        self._clock = clock
        self._simulated_time: float | None = None
        self.topic: Topic = describe_topic(types, INFO_TOPIC, INFO_TYPE, _LATCHED)
        self._types = types
        message_class = load_message_class(INFO_TYPE)
        self._inbox = Inbox(node, message_class, INFO_TOPIC, _LATCHED, direct=direct, depth=_DEPTH)
        message_class, qos = load_message_class(_CLOCK_TYPE), Qos(Reliability.BEST_EFFORT)
        self._clock_inbox = Inbox(node, message_class, "/clock", qos, direct=direct, depth=1)

    @property
    def heard(self) -> Announcement:
        """What it says of itself. May be read from any thread."""
        simulated = self._said.simulated or (
            "time of /clock" if isinstance(self._clock, SimulationClock) else None
        )
        return replace(self._said, simulated=simulated, simulated_time=self._simulated_time)

    def look(self) -> None:
        """Take what has come; call it a few times a second."""
        heard = self._inbox.take()
        publishers = self._inbox.publishers
        if not publishers and not heard:
            self._said = SILENT
        for message in heard:
            news = self._understood(message)
            if publishers < 2 or self._said.simulated is None:
                self._said = news

    def hear_clock(self) -> None:
        """Take what `/clock` has said; call it as often as messages are taken."""
        heard, clock = self._clock_inbox.take(), self._clock
        if not self._clock_inbox.publishers:
            self._simulated_time = None
        elif heard and (told := header_stamp(heard[-1].data)) is not None:
            now = clock.now_ns()
            age = now - arrival(heard[-1].received_ns, now, time.time_ns())
            if isinstance(clock, SimulationClock):
                clock.hear(nanoseconds(told), age)
            self._simulated_time = told - seconds(clock.now_ns() - age)
        self.clock_problem = (
            "/clock is silent: start the simulation"
            if isinstance(clock, SimulationClock) and clock.silent
            else None
        )

    def close(self) -> None:
        """End the subscriptions."""
        self._inbox.close()
        self._clock_inbox.close()

    def _understood(self, received: Received) -> Announcement:
        size = len(received.data)
        if size > LARGEST_INFO:
            return Announcement(problem=f"{size} bytes are no announcement: stop what sends that")
        raw = RawMessage(
            INFO_TOPIC, INFO_TYPE, received.data, received.source_ns, received.received_ns
        )
        try:
            return Announcement(simulated_in(decode_text(self._types, received.data)), None, (raw,))
        except MadrobError as error:
            return Announcement(None, str(error), (raw,))
