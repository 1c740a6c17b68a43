"""The console's own topics: state, event and start pose (protocol section 3)."""

from __future__ import annotations

from madrob_console.clock import Clock
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    MessageTypes,
    encode_start_pose,
    encode_text,
    referee_topics,
)
from madrob_console.testbeds.ros.inbox import qos_profile
from madrob_console.testbeds.ros.loading import RosObject, load_message_class
from recorder.message import RawMessage
from scoring.protocol import StartPose

_DEPTHS = {REFEREE_EVENT_TOPIC: 100}
"""A late joiner gets the last state and pose, but the events of a whole run."""


class Announcer:
    """Publishes what the referee decides; the last word reaches late joiners too.

    Args:
        node: the node that publishes.
        types: the types known.
        clock: stamps what is published.
    """

    def __init__(self, node: RosObject, types: MessageTypes, clock: Clock) -> None:
        self._types = types
        self._clock = clock
        self._topics = {topic.name: topic for topic in referee_topics(types)}
        self._publishers = {
            topic.name: node.create_publisher(
                load_message_class(topic.type),
                topic.name,
                qos_profile(topic.qos, _DEPTHS.get(topic.name, 1)),
            )
            for topic in self._topics.values()
        }

    def state(self, text: str) -> RawMessage:
        """Publish the state as JSON text; returns what was published."""
        return self._publish(REFEREE_STATE_TOPIC, encode_text(self._types, text))

    def event(self, text: str) -> RawMessage:
        """Publish an event as JSON text; returns what was published."""
        return self._publish(REFEREE_EVENT_TOPIC, encode_text(self._types, text))

    def start_pose(self, pose: StartPose) -> RawMessage:
        """Publish the start pose; returns what was published."""
        data = encode_start_pose(self._types, pose, self._clock.now_ns())
        return self._publish(REFEREE_START_POSE_TOPIC, data)

    def _publish(self, topic: str, data: bytes) -> RawMessage:
        now = self._clock.now_ns()
        self._publishers[topic].publish(data)
        return RawMessage(topic, self._topics[topic].type, data, now, now)
