"""The console's own messages where nobody listens: made only to be recorded."""

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
from recorder.message import RawMessage
from scoring.protocol import StartPose


class Announcements:
    """Makes the messages that a live console would publish.

    Args:
        types: the types known.
        clock: stamps what is announced.
    """

    def __init__(self, types: MessageTypes, clock: Clock) -> None:
        self._types = types
        self._clock = clock
        self._type_names = {topic.name: topic.type for topic in referee_topics(types)}

    def state(self, text: str) -> list[RawMessage]:
        """The state as JSON text."""
        return self._announce(REFEREE_STATE_TOPIC, encode_text(self._types, text))

    def event(self, text: str) -> list[RawMessage]:
        """An event as JSON text."""
        return self._announce(REFEREE_EVENT_TOPIC, encode_text(self._types, text))

    def start_pose(self, pose: StartPose) -> list[RawMessage]:
        """The start pose."""
        data = encode_start_pose(self._types, pose, self._clock.now_ns())
        return self._announce(REFEREE_START_POSE_TOPIC, data)

    def _announce(self, topic: str, data: bytes) -> list[RawMessage]:
        now = self._clock.now_ns()
        return [RawMessage(topic, self._type_names[topic], data, now, now)]
