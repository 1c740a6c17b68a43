"""What a console says on its own topics, as messages."""

from __future__ import annotations

import json

from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    encode_start_pose,
    encode_text,
    referee_topics,
)
from madrob_console.messages.types import MessageTypes
from recorder.bag import RawMessage
from scoring.protocol import Condition, StartPose

_TYPES = MessageTypes()
_TYPE_NAMES = {topic.name: topic.type for topic in referee_topics(_TYPES)}


def state_text(phase: str, start: float | None, condition: Condition | None) -> str:
    number = condition.number if condition else None
    return json.dumps({"phase": phase, "start_time": start, "condition_number": number})


def state(
    phase: str, start: float | None = None, condition: Condition | None = None, at_ns: int = 0
) -> RawMessage:
    data = encode_text(_TYPES, state_text(phase, start, condition))
    return _message(REFEREE_STATE_TOPIC, data, at_ns)


def event(text: str, at_ns: int = 0) -> RawMessage:
    return _message(REFEREE_EVENT_TOPIC, encode_text(_TYPES, text), at_ns)


def start_pose(pose: StartPose, at_ns: int = 0) -> RawMessage:
    return _message(REFEREE_START_POSE_TOPIC, encode_start_pose(_TYPES, pose, at_ns), at_ns)


def _message(topic: str, data: bytes, at_ns: int) -> RawMessage:
    return RawMessage(topic, _TYPE_NAMES[topic], data, at_ns, at_ns)
