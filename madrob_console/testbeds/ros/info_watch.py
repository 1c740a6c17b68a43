"""Hears what the testbed of a ROS domain says of itself."""

from __future__ import annotations

from madrob_console.errors import MadrobError
from madrob_console.messages.codec import MessageTypes, decode_text, describe_topic
from madrob_console.testbeds.announcement import (
    INFO_TOPIC,
    INFO_TYPE,
    LARGEST_INFO,
    SILENT,
    Announcement,
    simulated_in,
)
from madrob_console.testbeds.ros.inbox import Inbox, Received
from madrob_console.testbeds.ros.loading import RosObject, load_message_class
from recorder.bag import Durability, Qos, Topic
from recorder.message import RawMessage

_DEPTH = 10
"""Messages that DDS keeps between two looks: whoever sends more says the same."""

_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL)


class InfoWatch:
    """Listens to `/madrob/testbed/info`, which a testbed says once and late joiners hear, too.

    It holds as long as somebody is there who could have said it. Where several are, one that is
    simulated is enough.

    Args:
        node: subscribes; see `Inbox`.
        types: the types known.
        direct: see `Inbox`.

    Attributes:
        heard: what it says of itself. May be read from any thread.
        topic: what a bag must know of it.
    """

    def __init__(self, node: RosObject, types: MessageTypes, *, direct: bool) -> None:
        self.heard = SILENT
        self.topic: Topic = describe_topic(types, INFO_TOPIC, INFO_TYPE, _LATCHED)
        self._types = types
        message_class = load_message_class(INFO_TYPE)
        self._inbox = Inbox(node, message_class, INFO_TOPIC, _LATCHED, direct=direct, depth=_DEPTH)

    def look(self) -> None:
        """Take what has come; call it a few times a second."""
        heard = self._inbox.take()
        publishers = self._inbox.publishers
        if not publishers and not heard:
            self.heard = SILENT
        for message in heard:
            news = self._understood(message)
            if publishers < 2 or self.heard.simulated is None:
                self.heard = news

    def close(self) -> None:
        """End the subscription."""
        self._inbox.close()

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
